"""Infeasible segments are reported before planning, with the segment and the cause."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from command_line import invoke

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tominpmp.cli.report import report_data, report_text

UR5 = """
[robot]
name = "ur5"
[start]
q = [0.0, -1.2, 1.4, -1.8, -1.57, 0.0]
"""
LEVEL = """
[[segments]]
goal = {type = "joint", q = [0.4, -1.2, 1.4, -1.8, -1.57, 0.0]}
"""
TILTED = """
[[segments]]
goal = {type = "joint", q = [0.4, -1.2, 1.4, -1.8, 0.0, 0.0]}
"""
PLACE = """
[[segments]]
goal = {type = "position", frame = "tool0", position = [0.4, 0.3, 0.5]}
"""
UPRIGHT = 'type = "keep_upright"\nframe = "tool0"\naxis = [0, 0, -1]\ntolerance = 0.3'
UPSIDE_DOWN = UPRIGHT.replace("[0, 0, -1]", "[0, 0, 1]")
FIXED = 'type = "axis_fixed"\nframe = "tool0"\naxis = [0, 0, -1]\ndirection = '
LOW = (
    'type = "within_region"\nframe = "tool0"\nlower = [-1, -1, 0]\nupper = [1, 1, 0.4]'
)
LOAD = (
    'type = "stable_contact"\nframe = "tool0"\ncenter = [0, 0, 0.05]\nfriction = 0.3\n'
    "support = [[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1]]\nmass = 1.0"
)
GRASP = 'type = "firm_grasp"\nframe = "tool0"\nforce = 1.0\nfriction = 0.3\nmass = 5.0'
SLOW = 'type = "tool_speed"\nframe = "tool0"\nlimit = 0.5\nduring = [0.0, 1.0]'


def constraint_tables(*constraints: str) -> str:
    return "".join(f"[[segments.constraints]]\n{item}\n" for item in constraints)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            LEVEL + constraint_tables(UPSIDE_DOWN),
            ("start: the tilt of frame tool0 is 3.1", "0.3 rad"),
        ),
        (
            LEVEL + TILTED + constraint_tables(UPRIGHT),
            ("segments[1].goal: the tilt", "1.571 rad"),
        ),
        # The configuration between two segments is known before planning.
        (
            TILTED + LEVEL + constraint_tables(UPRIGHT),
            ("segments[1]: start: the tilt", "1.571 rad"),
        ),
        (
            PLACE + constraint_tables(LOW),
            ("segment 1 of 1: goal: no configuration was found", "region", "0.1 m"),
        ),
        (
            LEVEL + constraint_tables(FIXED + "[0, 0, 1]", FIXED + "[1, 0, 0]"),
            ("start: the deviation", "number 2 of the constraints", "contradict"),
        ),
        (
            LEVEL + constraint_tables(LOAD),
            ("at rest: the load slips or tips, as", "friction 0.3"),
        ),
        (LEVEL + constraint_tables(GRASP), ("49 N at rest", "no more than 0.6 N")),
        (
            LEVEL + LEVEL + constraint_tables(SLOW),
            ("segments[1].constraints[0].during: ", "(0.0, 1.0)", "has segments: "),
        ),
        (
            LEVEL + "[[constraints]]\n" + SLOW,
            ("constraints[0].during: ", "expected None"),
        ),
        (
            LEVEL + 'may_touch = [["tool0", "tool0"]]',
            ("segments[0].may_touch: ", "the same name twice"),
        ),
        (
            LEVEL + 'payload = {mass = 1.0, frame = "tool0", geometry = [{type = '
            '"sphere", name = "ball", radius = 0.1, motion = {type = '
            '"constant_velocity", velocity = [1, 0, 0]}}]}',
            ("segments[0].payload: ", "without a motion of their own"),
        ),
    ],
)
def test_message_about_an_infeasible_segment_has_place_and_cause(
    tmp_path: Path, text, words
):
    path = tmp_path / "cell.toml"
    path.write_text(UR5 + text)
    outcome = invoke(["plan", str(path)])
    assert outcome.exit_code == 2, outcome.output
    output = " ".join(outcome.output.split())
    assert "Traceback" not in output
    for word in words:
        assert word in output


def rail_problem(*segments: tm.Segment, **fields) -> tm.Problem:
    arm = make_arm(slide(1.0), effort=np.array([10.0]))
    return tm.Problem(arm, [0.0], segments=segments, **fields)


def test_constraint_is_not_checked_at_an_unknown_begin_of_a_segment():
    coupled = tm.JointCoupling(["joint1"], [1.0], upper=2.0, lower=0.5)
    # The goal of the first segment, 0.2, would violate the constraint of the third.
    problem = rail_problem(
        tm.Segment(tm.JointGoal([0.2])),
        tm.Segment(tm.JointRegionGoal([0.9], [1.1])),
        tm.Segment(tm.JointGoal([1.5]), constraints=(coupled,)),
    )
    assert len(problem.phases) == 3


@pytest.mark.parametrize("moves", [False, True])
def test_obstacle_of_a_segment_is_ignored_before_its_begin(moves):
    robot = tm.load_robot("planar3r")
    first, last = [0.6, 1.6, -1.6], [2.0, -1.0, 0.5]
    elbow = np.array([np.cos(0.6), np.sin(0.6), 0.0]) * 2.0
    path = tm.ConstantVelocity((0.0, 0.0, 5.0)) if moves else None
    ball = tm.Sphere("ball", radius=0.2, position=elbow, motion=path)
    with_ball = tm.Segment(tm.JointGoal(last), scene=[ball])
    if moves:
        # The ball is there only at the start of the motion.
        segments = [tm.Segment(tm.JointGoal(first)), with_ball]
    else:
        between = tm.Segment(tm.JointRegionGoal([1.5, 0.0, 0.0], 0.1))
        segments = [tm.Segment(tm.JointGoal(first)), between, with_ball]
    problem = tm.Problem(robot, [0.5, 1.7, -1.7], segments=segments)
    assert len(problem.phases) == len(segments)


def test_incomplete_replay_is_reported():
    slow = tm.MotionLimits(acceleration=1e-12)
    # No lower bound is known for a segment that begins anywhere in a region.
    region = tm.Segment(tm.JointRegionGoal([0.9], [0.2]))
    solution = tm.plan(
        rail_problem(region, tm.Segment(tm.JointGoal([2.0]), motion_limits=slow)),
        intervals=8,
        starts=1,
        max_iterations=3,
    )
    assert not solution.success
    text = report_text(report_data(solution, {}))
    assert "was not completed" in text


@pytest.mark.parametrize("given", [[3], ["keep_upright"], 3])
def test_wrong_constraints_of_a_segment_are_rejected(given: object) -> None:
    robot = make_arm(slide(1.0), effort=np.array([10.0]))
    segment = tm.Segment(tm.JointGoal([0.5]), constraints=given)  # type: ignore[arg-type]
    with pytest.raises(tm.ProblemError, match=r"segment 1 of 1: constraints") as found:
        tm.Problem(robot, [0.0], segments=[segment])
    assert str(found.value.field).startswith("segments[0].constraints")


def test_incomplete_goal_after_a_free_configuration_names_its_segment() -> None:
    robot = make_arm(slide(1.0), slide(1.0), effort=np.array([10.0, 10.0]))
    there = tm.RegionGoal("tip", (-1.0,) * 3, (1.0,) * 3)
    then = tm.JointGoal({robot.joint_names[0]: 0.5})
    segments = [tm.Segment(there), tm.Segment(then)]
    with pytest.raises(
        tm.ProblemError, match=r"segment 2 of 2: goal\.q has no value"
    ) as found:
        tm.Problem(robot, [0.0, 0.0], segments=segments)
    assert found.value.field == "segments[1].goal.q"


@pytest.mark.parametrize("count", [1, 2])
def test_segments_of_a_joint_without_a_motor_are_refused(count: int) -> None:
    """Only collocation plans without motors, and it knows no segments."""
    robot = make_arm(slide(1.0), slide(1.0), effort=np.array([10.0, 0.0]))
    segments = [tm.Segment(tm.JointGoal([0.5 / k, 0.5])) for k in range(count, 0, -1)]
    problem = tm.Problem(robot, [0.0, 0.0], segments=segments)
    joint = robot.passive_joints[0]
    with pytest.raises(
        tm.ProblemError, match=f"{joint} has no motor: expected"
    ) as found:
        tm.plan(problem)
    assert found.value.field == "segments"


def test_segment_copies_the_list_of_constraints() -> None:
    """Regression: after a scenario was saved and loaded, its problem was unequal."""
    given = [tm.ToolSpeed("tip", 1.0)]
    segment = tm.Segment(tm.JointGoal([0.5]), constraints=given)
    assert segment == tm.Segment(tm.JointGoal([0.5]), constraints=tuple(given))
    given.clear()
    assert segment.constraints


def test_start_is_checked_in_the_scene_of_the_first_segment() -> None:
    """Regression: the start was checked in the scene of the problem: a retreat was
    rejected, and a collision was not.
    """
    robot = tm.load_robot("planar3r")
    start, away = (0.5, 1.0, 1.0), tm.JointGoal((0.5, 1.7, -1.7))
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, np.array(start))
    tip = data.oMf[robot.frame_id("tip")].translation.copy()
    part = tm.Scene([tm.Sphere("part", radius=0.3, position=tip)])
    touching = [("link3", "part")]
    retreats = [
        tm.Segment(away, may_touch=touching),
        tm.Segment(away, scene=tm.Scene()),
    ]
    for retreat in retreats:
        problem = tm.Problem(robot, start, segments=[retreat], scene=part)
        assert problem.segments
    with pytest.raises(tm.ProblemError, match=r"start in collision.*'part'") as raised:
        tm.Problem(robot, start, segments=[tm.Segment(away, scene=part)])
    assert raised.value.field == "segments[0].q_start"
