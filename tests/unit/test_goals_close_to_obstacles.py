"""Plans to goals closer to an obstacle than the padding, as of a gripper at a part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import tominpmp as tm
from tominpmp.robot.robot import Robot
from tominpmp.transcription.problem_functions import PADDING, ProblemFunctions

START, CLOSE = (0.5, 1.7, -1.7), np.array((0.5, 1.0, 1.0))
# A cube with edges of 10 cm and a mass of 1 kg on a rail.
RAIL = """<robot name="rail"><link name="base"/><link name="cube"><inertial>
<mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="cube"/>
<axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="10" velocity="5"/></joint>
</robot>"""
# Clearance at the goal [m].
GAPS = (3e-4, 1e-3)
# The tests check that a goal is reached; the motion time does not matter.
QUICK = {"effort": "quick", "refine": None, "max_planning_time": 300.0}


def tip_of(robot: Robot) -> pin.SE3:
    """Pose of the tip at the close configuration."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.expand(CLOSE))
    return data.oMf[robot.frame_id("tip")].copy()


def ball_near(robot: Robot, gap: float) -> tm.Scene:
    """A ball ahead of the tip, with a clearance of `gap` at the close configuration."""
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
    """Goals that the arm reaches only where it is as close to the ball."""
    tip = tip_of(robot)
    return {
        "joints": tm.JointGoal(CLOSE),
        "position": tm.PositionGoal("tip", tip.translation),
        "pose": tm.PoseGoal("tip", tip),
    }


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("kind", ["joints", "position", "pose"])
def test_goal_closer_than_the_padding_is_reached(
    planar3r: Robot, kind: str, gap: float
) -> None:
    problem = tm.Problem(
        planar3r, START, goals(planar3r)[kind], ball_near(planar3r, gap)
    )
    assert gap < PADDING
    solution = tm.plan(problem, **QUICK)
    assert solution.success, solution.message


@pytest.mark.parametrize("kind", ["joints", "pose"])
def test_goal_exactly_at_the_margin_is_reached(planar3r: Robot, kind: str) -> None:
    """Regression: a pose goal was refused for a lack of -5.56e-16 m of clearance."""
    scene, margin = ball_near(planar3r, 0.01), 0.01
    goal = goals(planar3r)[kind]
    problem = tm.Problem(planar3r, START, goal, scene, margin=margin)
    solution = tm.plan(problem, **QUICK)
    assert solution.success, solution.message


@pytest.mark.parametrize("room", [1.5e-3, 1e-4])
def test_passage_narrower_than_the_padding_costs_no_motion_time(room: float) -> None:
    """Start and goal are far from the walls: T is that of a plan without walls."""
    arm = tm.load_robot(RAIL)
    walls = [
        tm.Box(name, size=(0.1, 0.2, 1.0), position=(0.0, side * (0.15 + room), 0.0))
        for name, side in (("left", 1.0), ("right", -1.0))
    ]
    problem = tm.Problem(arm, [-0.5], tm.JointGoal([0.5]), tm.Scene(walls))
    assert problem.checker.distances(np.zeros((1, 1)), 1.0).min() < PADDING
    few = {"effort": "quick", "intervals": 20, "max_planning_time": 60.0}
    solution = tm.plan(problem, **few)
    assert solution.success, solution.message
    assert solution.T < 1.001 * tm.plan(replace(problem, scene=tm.Scene()), **few).T


def test_plan_interrupted_in_a_narrow_passage_returns_its_motion() -> None:
    """Regression: a motion within all limits was not replayed, as it lacked padding."""
    arm = tm.load_robot(RAIL)
    walls = [
        tm.Box(name, size=(0.1, 0.2, 1.0), position=(0.0, side * 0.1505, 0.0))
        for name, side in (("left", 1.0), ("right", -1.0))
    ]
    problem = tm.Problem(arm, [-0.5], tm.JointGoal([0.5]), tm.Scene(walls))
    few = {"intervals": 20, "callback": lambda record: record.iteration >= 4}
    solution = tm.plan(problem, **few)
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.success and solution.verification.ok


def test_start_with_a_velocity_towards_a_wall_is_planned() -> None:
    """The cube can just stop, a millimetre before the wall."""
    arm = tm.load_robot(RAIL)
    ahead, v = 0.05, np.sqrt(2.0 * 10.0 * (0.05 - 1e-3))
    wall = tm.Box("wall", size=(0.1, 1.0, 1.0), position=(0.1 + ahead, 0.0, 0.0))
    problem = tm.Problem(
        arm, [0.0], tm.JointGoal([-0.5]), tm.Scene([wall]), v_start=[v]
    )
    solution = tm.plan(problem, **QUICK)
    assert solution.success, solution.message
    free = replace(problem, scene=tm.Scene())
    assert solution.T < 1.01 * tm.plan(free, effort="quick").T


@pytest.mark.parametrize("kind", ["joints", "pose"])
@pytest.mark.parametrize("stop", [True, False])
def test_intermediate_goal_closer_than_the_padding_is_reached(
    planar3r: Robot, kind: str, stop: bool
) -> None:
    scene, goal = ball_near(planar3r, 1e-3), goals(planar3r)[kind]
    segments = [tm.Segment(goal, stop=stop), tm.Segment(tm.JointGoal(START))]
    problem = tm.Problem(planar3r, START, segments=segments, scene=scene)
    solution = tm.plan(problem, **QUICK)
    assert solution.success, solution.message


def test_padding_is_half_the_clearance_at_the_end_of_a_guess(planar3r: Robot) -> None:
    problem = tm.Problem(
        planar3r, START, goals(planar3r)["pose"], ball_near(planar3r, 1e-3)
    )
    system = ProblemFunctions.of(problem)
    full = system.clearance_rows
    close = system.passing(CLOSE[None]).clearance_rows
    assert full is not None and close is not None
    assert full.padding.max() == PADDING
    assert close.padding.min() == pytest.approx(0.5e-3, rel=1e-3)
    # The start changes no padding, nor does a configuration in collision.
    assert full.passing(np.array([START])) is full
    inside = CLOSE + np.array([0.1, 0.0, 0.0])
    room = problem.checker.distances(inside[None], 10.0)[0]
    assert (room < 0.0).any()
    np.testing.assert_array_equal(
        system.passing(inside[None]).clearance_rows.padding[room < 0.0],
        full.padding[room < 0.0],
    )
