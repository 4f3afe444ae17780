"""The command ``play``: show a motion that was written to a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tominpmp.cli.files import PAGE_ENDINGS, check_target, need_package
from tominpmp.cli.request import RobotRequest
from tominpmp.cli.values import obstacle
from tominpmp.exceptions import ScenarioError
from tominpmp.goals import JointGoal
from tominpmp.output.export import load_motion
from tominpmp.output.playback import play
from tominpmp.problem import Problem
from tominpmp.scene import Scene
from tominpmp.trajectory import Trajectory


def run_play(
    motion: Path, robot: RobotRequest, obstacles: Sequence[str], page: Path | None
) -> Path:
    """Show a motion.

    Args:
        motion: File that holds it.
        robot: Whose motion it is.
        obstacles: Obstacles to show, as text.
        page: File for the page; None opens it in the browser.

    Returns:
        The page.

    Raises:
        TominpmpError: If anything given is wrong or does not fit together.
    """
    need_package("meshcat", "viz", "tominpmp play")
    if page is not None:
        check_target(page, "--output", PAGE_ENDINGS)
    samples = load_motion(motion)
    if samples.t[0] != 0.0:
        raise ScenarioError(
            f"{motion}: the time begins at {samples.t[0]}, not 0", motion
        )
    arm = robot.load()
    if samples.joint_names != arm.joint_names:
        raise ScenarioError(
            f"{motion} holds a motion of {', '.join(samples.joint_names)}; the joints "
            f"of {arm.name!r} are {', '.join(arm.joint_names)}",
            motion,
        )
    trajectory = Trajectory(
        samples.joint_names, samples.t, samples.q, samples.v, samples.u
    )
    problem = Problem(
        arm,
        samples.q[0],
        JointGoal(samples.q[-1], samples.v[-1]),
        scene=Scene([obstacle(text) for text in obstacles]),
        v_start=samples.v[0],
    )
    return Path(play(problem, trajectory, path=page))
