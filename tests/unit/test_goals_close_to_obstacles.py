"""Goals closer to an obstacle than the padding: a gripper at a part, a tool at work."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import tominpmp as tm
from tominpmp.robot.robot import Robot
from tominpmp.transcription.problem_functions import PADDING, ProblemFunctions

START, CLOSE = (0.5, 1.7, -1.7), np.array((0.5, 1.0, 1.0))
# Room that is left at the goal [m].
GAPS = (3e-4, 1e-3)


def tip_of(robot: Robot) -> pin.SE3:
    """Pose of the tip at the close configuration."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.expand(CLOSE))
    return data.oMf[robot.frame_id("tip")].copy()


def ball_near(robot: Robot, gap: float) -> tm.Scene:
    """A ball so far from the tip of the arm at the close configuration."""
    tip = tip_of(robot)
    ahead = np.array(tip.rotation)[:, 0]

    def scene(distance: float) -> tm.Scene:
        position = tip.translation + distance * ahead
        return tm.Scene([tm.Sphere("part", radius=0.3, position=position)])

    near, far = 0.0, 3.0
    for _ in range(50):
        middle = 0.5 * (near + far)
        checker = tm.Problem(robot, START, tm.JointGoal(START), scene(middle)).checker
        room = checker.distances(CLOSE[None], 10.0)[0].min()
        near, far = (middle, far) if room < gap else (near, middle)
    return scene(far)


def goals(robot: Robot) -> dict[str, tm.Goal]:
    """Goals that are only met at places as close to the ball."""
    tip = tip_of(robot)
    return {
        "joints": tm.JointGoal(CLOSE),
        "position": tm.PositionGoal("tip", tip.translation),
        "pose": tm.PoseGoal("tip", tip),
    }


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("kind", ["joints", "position", "pose"])
def test_goal_is_reached(planar3r: Robot, kind: str, gap: float) -> None:
    problem = tm.Problem(
        planar3r, START, goals(planar3r)[kind], ball_near(planar3r, gap)
    )
    assert gap < PADDING
    solution = tm.plan(problem, effort="quick", max_planning_time=60.0)
    assert solution.success, solution.message


@pytest.mark.parametrize("kind", ["joints", "pose"])
@pytest.mark.parametrize("stop", [True, False])
def test_goal_on_the_way_is_reached(planar3r: Robot, kind: str, stop: bool) -> None:
    scene, goal = ball_near(planar3r, 1e-3), goals(planar3r)[kind]
    segments = [tm.Segment(goal, stop=stop), tm.Segment(tm.JointGoal(START))]
    problem = tm.Problem(planar3r, START, segments=segments, scene=scene)
    solution = tm.plan(problem, effort="quick", max_planning_time=60.0)
    assert solution.success, solution.message


def test_padding_is_half_the_room_where_a_guess_ends(planar3r: Robot) -> None:
    problem = tm.Problem(
        planar3r, START, goals(planar3r)["pose"], ball_near(planar3r, 1e-3)
    )
    system = ProblemFunctions.of(problem)
    full = system.clearance_rows
    close = system.passing(CLOSE[None]).clearance_rows
    assert full is not None and close is not None
    assert full.padding.max() == PADDING
    assert close.padding.min() == pytest.approx(0.5e-3, rel=1e-3)
    # Known configurations change nothing, and no goal lies in an obstacle.
    assert full.passing(np.array([START])) is full
    inside = CLOSE + np.array([0.1, 0.0, 0.0])
    room = problem.checker.distances(inside[None], 10.0)[0]
    assert (room < 0.0).any()
    np.testing.assert_array_equal(
        system.passing(inside[None]).clearance_rows.padding[room < 0.0],
        full.padding[room < 0.0],
    )
