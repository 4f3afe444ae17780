"""Goals on long rails and of tiny arms: inverse kinematics has the robot's scale.

Regressions: steps of at most half a metre did not get farther than 30 m, and an error
of a micrometre counted as zero, also for arms no longer than a micrometre.
"""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.kinematics import RobotKinematics

QUICK = tm.Options(effort="quick")
AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
INERTIAL = """<inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>"""
FAR = np.array([0.45, 0.53, 1.05, 0.09])


def machine(axes: str, travel: float, length: float = 1.0) -> tm.Robot:
    """A robot with a joint per letter: x slides along the x axis, X turns about it."""
    parts = ['<link name="l0"/>']
    for number, axis in enumerate(axes, 1):
        kind, most, offset = "prismatic", travel, 0.0
        if axis.isupper():
            kind, most, offset = "revolute", 3.0, length
        parts.append(
            f'<link name="l{number}">{INERTIAL}</link>'
            f'<joint name="j{number}" type="{kind}"><parent link="l{number - 1}"/>'
            f'<child link="l{number}"/><origin xyz="{offset} 0 0"/>'
            f'<axis xyz="{AXES[axis.lower()]}"/><limit lower="{-min(most, 1e9)}" '
            f'upper="{min(most, 1e9)}" velocity="2" effort="500"/></joint>'
        )
    text = f'<robot name="machine">{"".join(parts)}</robot>'
    ends = {}
    if np.isinf(travel):
        slides = [f"j{k}" for k, axis in enumerate(axes, 1) if axis.islower()]
        ends = {
            "position_lower": dict.fromkeys(slides, -np.inf),
            "position_upper": dict.fromkeys(slides, np.inf),
        }
    return tm.load_robot(text, gravity=(0, 0, 0), **ends)


@pytest.mark.parametrize("distance", [1.0, 30.0, 1000.0])
@pytest.mark.parametrize("travel", [5000.0, np.inf])
def test_joint_ranges_far_along_an_axis_are_reached_at_full_speed(
    distance: float, travel: float
) -> None:
    robot, there = machine("xyzx", travel), distance * FAR
    goal = tm.JointRegionGoal(there, 0.05 * there)
    solution = tm.plan(tm.Problem(robot, np.zeros(4), goal), QUICK)
    assert solution.success
    # The slowest axis reaches the near end of its range at full speed.
    least = 0.95 * float(there.max()) / 2.0
    assert least <= solution.T < 1.02 * least + 0.3
    assert np.all(np.abs(solution.trajectory.q[-1] - there) <= 0.05 * there + 1e-6)


POSE = (np.array([60.0, -50.0, 20.0]), np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]))


@pytest.mark.parametrize(
    ("axes", "goal"),
    [
        ("xyzx", tm.PositionGoal("l4", (60, 40, 10))),
        ("xyzx", tm.PoseGoal("l4", ((60, 40, 10), np.eye(3)))),
        ("xyzx", tm.RegionGoal("l4", (59, 39, 9), (61, 41, 11))),
        ("xZZ", tm.PositionGoal("l3", (-60, 0.5, 0))),
        ("xyzZYX", tm.PoseGoal("l6", POSE)),
        ("xZYZY", tm.AxisGoal("l5", (1, 0, 0), (0, 0, 1), (60, 0.5, 0.5))),
        (
            "xyzZ",
            tm.AllGoals(
                [
                    tm.PositionGoal("l4", (60, 40, 10)),
                    tm.JointRegionGoal({"j4": 0.7}, 0.1),
                ]
            ),
        ),
    ],
)
def test_frame_goals_on_rails_and_gantries_are_reached(
    axes: str, goal: tm.Goal
) -> None:
    robot = machine(axes, 100.0)
    solution = tm.plan(tm.Problem(robot, np.zeros(robot.n), goal), QUICK)
    assert solution.success
    lack, _ = goal.place_residual(RobotKinematics(robot), solution.trajectory.q[-1])
    assert np.abs(lack).max() < 1e-5
    # The rails do most of the way, at 2 m/s each.
    assert solution.T < 35.0


def test_plan_on_endless_rails_avoids_obstacles() -> None:
    """Regression: paths were not sampled, as the scale was the infinite rail length."""
    robot = machine("xyz", np.inf)
    load = tm.Payload(1.0, "l3", geometry=[tm.Sphere("ball", radius=0.1)])
    wall = tm.Box("wall", size=(0.2, 3.0, 1.0), position=(1.5, 0.05, 0.02))
    problem = tm.Problem(
        robot.with_payload(load),
        np.zeros(3),
        tm.PositionGoal("l3", (3.0, 0, 0)),
        scene=[wall],
        margin=0.01,
    )
    solution = tm.plan(problem, QUICK)
    assert solution.success
    assert solution.verification.min_clearance >= 0.01 - 1e-6


@pytest.mark.parametrize("length", [1e-6, 1e-4])
def test_tiny_arms_reach_goals_to_a_hundredth_of_their_length(length: float) -> None:
    robot = machine("ZYxYXY", 0.5 * length, length)
    robot = robot.with_changes(velocity={"j3": 2.0 * length})
    kinematics = RobotKinematics(robot)
    there = np.array([0.5, -0.4, 0.2 * length, 0.6, -0.3, 0.4])
    pose = kinematics.placement(there, "l6")
    edge = np.full(3, 0.01 * length)
    for goal in (
        tm.PositionGoal("l6", pose.translation),
        tm.RegionGoal("l6", -edge, edge, pose, 0.02),
    ):
        problem = tm.Problem(robot, np.zeros(6), goal, self_collision=False)
        solution = tm.plan(problem, QUICK)
        assert solution.success
        q = solution.trajectory.q[-1]
        place = goal.place(kinematics, q)
        lack = np.where(place.lengths, place.excess / length, place.excess)
        assert np.abs(lack).max() < 1e-2


def test_tour_of_a_gantry_reaches_its_stations() -> None:
    robot = machine("xyzx", 100.0)
    places = {"a": (60, 40, 10), "b": (-40, 20, 5), "c": (5, 1, 0)}
    stations = {key: tm.PositionGoal("l4", place) for key, place in places.items()}
    tour = tm.plan_tour(robot, np.zeros(4), stations)
    kinematics = RobotKinematics(robot)
    for visit in tour.visits:
        there = kinematics.placement(visit.q, "l4").translation
        near = min(np.abs(there - place).max() for place in places.values())
        assert near < 1e-5
