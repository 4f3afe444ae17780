"""The command ``play``: show a motion that was written to a file."""

from __future__ import annotations

from pathlib import Path

from tominpmp.cli.options import PlayOptions
from tominpmp.cli.output_files import PAGE_ENDINGS, check_target
from tominpmp.cli.problem import load_scene
from tominpmp.files.export import load_motion
from tominpmp.goals import JointGoal
from tominpmp.motion.joining import recorded_motion
from tominpmp.problem import Problem
from tominpmp.viz.playback import play


def run_play(motion: Path, args: PlayOptions) -> Path:
    """Show the motion in a file.

    Raises:
        TominpmpError: If anything given is wrong or does not fit together.
    """
    if args.output is not None:
        check_target(args.output, "--output", PAGE_ENDINGS)
    samples = load_motion(motion)
    arm, scene = load_scene(args)
    trajectory = recorded_motion(samples, arm, motion)
    problem = Problem(
        arm,
        trajectory.q[0],
        JointGoal(trajectory.q[-1], trajectory.v[-1]),
        scene=scene,
        v_start=trajectory.v[0],
    )
    return Path(play(problem, trajectory, path=args.output))
