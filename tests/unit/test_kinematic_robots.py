"""Kinematic robots: limits of speeds, accelerations and jerks, and no torques."""

from __future__ import annotations

import pickle
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.description.files import find_robot, robot_names

REPORT = Path(__file__).parents[1] / "reports" / "kinematic_no_effort_no_inertia"
URDF = REPORT / "robot.urdf"
LIMITS = tm.MotionLimits(acceleration=4.0)
START, GOAL = [0.0, 0.1], tm.JointGoal([0.5, 0.6])


def arm(limits: tm.MotionLimits | None = LIMITS, **changes: Any) -> tm.Robot:
    robot = tm.load_robot(URDF, kinematic=True, **changes)
    return replace(robot, motion_limits=limits)


def planned(robot: tm.Robot, *, options: dict[str, Any] | None = None, **task: Any):
    task = {"q_start": START, "goal": GOAL} | task
    found = tm.plan(tm.Problem(robot=robot, **task), **(options or {}))
    assert found.success and found.verification.ok, found.message
    assert np.isnan(found.trajectory.u).all()
    assert found.certificate.ok, found.certificate.message
    assert found.lower_bound.T <= found.T * (1.0 + 1e-6)
    return found


@pytest.fixture(scope="module")
def solution() -> tm.Solution:
    return planned(arm())


def test_rest_to_rest_motion_is_bang_bang_without_torques(
    solution: tm.Solution,
) -> None:
    assert solution.T == pytest.approx(np.sqrt(0.5), rel=1e-5)
    assert solution.lower_bound.T == pytest.approx(np.sqrt(0.5), rel=1e-6)
    motion = solution.trajectory
    assert np.isnan(motion([0.0, 0.3, 0.7]).u).all()
    assert np.isnan(motion(1.0, hold=True).u).all()
    assert np.isnan(motion.sample(0.01).u).all()
    assert np.isnan(solution.initial.u).all()
    assert np.isfinite(motion.a).all()
    copy = pickle.loads(pickle.dumps(motion))
    assert copy == motion and hash(copy) == hash(motion)  # torques are undefined


def test_speed_limits_make_trapezoidal_velocities() -> None:
    # T of a single motion depends on where its switches are in the grid.
    speeds = [0.9, 1.0, 1.3]
    excess = [planned(arm(velocity=v)).T / (0.5 / v + v / 4.0) - 1.0 for v in speeds]
    assert excess == pytest.approx(np.zeros(3), abs=2e-4)
    assert np.mean(excess) < 1e-4


def test_jerk_limit_takes_the_time_of_the_closed_form() -> None:
    robot = arm(tm.MotionLimits(acceleration=4.0, jerk=40.0))
    exact = 0.1 + np.sqrt(0.1**2 + 4.0 * 0.5 / 4.0)
    assert planned(robot).T == pytest.approx(exact, rel=1e-3)


def test_limits_of_a_problem_replace_limits_of_the_robot() -> None:
    limits = tm.MotionLimits(acceleration={"j1": 1.0})
    found = planned(arm(), motion_limits=limits)
    assert found.T == pytest.approx(np.sqrt(2.0), rel=1e-5)


def test_motion_avoids_obstacles() -> None:
    box = tm.Box("box", size=[0.06, 0.06, 0.06], position=[0.16, 0.16, 0.5])
    ends = {"q_start": [0.0, 1.2], "goal": tm.JointGoal([1.5, 1.2])}
    free = planned(arm(), **ends)
    round_it = planned(arm(), scene=[box], **ends)
    assert round_it.verification.min_clearance >= -1e-5
    assert not tm.verify(round_it.problem, free.trajectory).ok


def test_segments_keep_their_own_acceleration_limits() -> None:
    back = tm.Segment(
        tm.JointGoal(START), motion_limits=tm.MotionLimits(acceleration=2.0)
    )
    segments = [tm.Segment(GOAL, stop=True), back]
    found = planned(arm(), goal=None, segments=segments)
    assert found.T == pytest.approx(np.sqrt(0.5) + 1.0, rel=1e-5)
    assert all(np.isnan(part.trajectory.u).all() for part in found.segments)


def test_motion_time_is_a_multiple_of_the_control_period() -> None:
    found = planned(arm(), options={"control_period": 0.008})
    assert found.T == pytest.approx(0.712)


def test_tour_takes_the_sum_of_its_motion_times() -> None:
    stations = [tm.JointGoal([0.5, 0.6]), tm.JointGoal([-0.5, 0.3])]
    tour = tm.plan_tour(arm(), START, stations)
    assert np.isnan(tour.trajectory.u).all()
    ways = np.sqrt(0.5) + 1.0 + np.sqrt(0.5)  # 0.5, 1.0 and 0.5 rad
    assert tour.trajectory.duration == pytest.approx(ways, rel=1e-3)


@pytest.mark.parametrize("ending", ["csv", "npz", "json"])
def test_motion_files_have_no_torques_and_pass_the_replay(
    solution: tm.Solution, tmp_path: Path, ending: str
) -> None:
    path = solution.export(tmp_path / f"motion.{ending}")
    samples = tm.load_motion(path)
    assert np.isnan(samples.u).all()
    assert tm.verify(solution.problem, samples).ok
    if ending == "csv":
        assert "u_" not in path.read_text().splitlines()[0]


def test_replay_names_the_excess_over_an_acceleration_limit(
    solution: tm.Solution,
) -> None:
    strict = tm.Problem(
        robot=arm(), q_start=START, goal=GOAL, motion_limits=tm.MotionLimits(3.0)
    )
    found = tm.verify(strict, solution.trajectory)
    assert not found.ok
    assert found.worst["acceleration"].amount == pytest.approx(1.0, rel=1e-3)
    assert "rad/s^2 beyond its acceleration limit" in found.message
    assert "effort" not in found.worst


def test_former_motion_is_a_warm_start(solution: tm.Solution) -> None:
    near = tm.Problem(robot=arm(), q_start=START, goal=tm.JointGoal([0.55, 0.6]))
    found = tm.plan(near, start=solution)
    assert found.T == pytest.approx(np.sqrt(0.55), rel=1e-4)


def test_kinematic_motion_is_replayed_and_used_for_a_dynamic_robot() -> None:
    """Regression: `start` without torques was refused: "values that are no numbers"."""
    limits = tm.MotionLimits(acceleration=15.0)
    task = {"q_start": [0.5, 1.7, -1.7], "goal": tm.JointGoal([0.9, -1.2, -0.9])}
    bare, robot = (tm.load_robot("planar3r", kinematic=k) for k in (True, False))
    quick = {"effort": "quick", "refine": None}
    kinematic = tm.plan(tm.Problem(robot=bare, motion_limits=limits, **task), **quick)
    problem = tm.Problem(robot=robot, motion_limits=limits, **task)
    judged = tm.verify(problem, kinematic.trajectory)
    assert judged.worst["effort"].amount > 10.0
    assert judged.worst["acceleration"].amount < 0.1
    found = tm.plan(problem, start=kinematic, **quick)
    assert found.verification.ok and found.T > kinematic.T
    assert found.T <= 1.002 * tm.plan(problem, **quick).T


def test_sensitivities_to_accelerations_sum_to_minus_one_half(
    solution: tm.Solution,
) -> None:
    found = {(item.kind, item.joint): item for item in solution.sensitivities}
    both = [found["acceleration", joint] for joint in ("j1", "j2")]
    # T is proportional to the square root of distance over acceleration.
    assert sum(item.value for item in both) == pytest.approx(-0.5, abs=1e-3)
    assert both[0].limit == 4.0 and both[0].limit_unit == "rad/s^2"
    assert not any(kind == "effort" for kind, _ in found)
    assert found["gravity", None].value == 0.0


def test_certificate_messages_name_accelerations_not_torques(
    solution: tm.Solution,
) -> None:
    assert "accelerations obey" in solution.certificate.message
    assert "orque" not in solution.certificate.message
    fast, slow = (tm.Problem(arm(velocity=v), START, GOAL) for v in (1.0, 0.9))
    moving = tm.certify(fast, tm.plan(slow, effort="quick").trajectory)
    assert "the worst is the acceleration of joint" in moving.message
    assert "orque" not in moving.message
    assert "torque" not in solution._repr_html_()
    assert "acceleration over its limit" in solution._repr_html_()


def test_robots_derived_from_a_kinematic_robot_are_kinematic() -> None:
    robot = arm()
    derived = [
        robot.with_locked({"j2": 0.1}),
        robot.with_payload(tm.Payload(5.0, "l2")),
        robot.with_changes(velocity=1.0),
        pickle.loads(pickle.dumps(robot)),
        tm.combine_robots([("a", robot, [0, 0, 0]), ("b", robot, [2, 0, 0])]),
    ]
    assert all(one.kinematic for one in derived)
    assert not tm.load_robot("planar3r").kinematic
    assert "Kinematic" in repr(robot)


def test_payload_does_not_slow_a_kinematic_robot() -> None:
    heavy = arm().with_payload(tm.Payload(500.0, "l2", com=[0.0, 0.0, 0.3]))
    assert planned(heavy).T == pytest.approx(np.sqrt(0.5), rel=1e-5)


def test_scenario_file_keeps_the_kinematic_flag(tmp_path: Path) -> None:
    problem = tm.Problem(robot=arm(), q_start=START, goal=GOAL)
    tm.save_scenario(tmp_path / "task.toml", problem)
    again = tm.load_scenario(tmp_path / "task.toml").problem
    assert again.robot == problem.robot
    assert "kinematic = true" in (tmp_path / "task.toml").read_text()


def test_scenario_file_keeps_a_robot_without_effort_attributes(tmp_path: Path) -> None:
    text = URDF.read_text().replace(' effort="0"', "")
    (tmp_path / "arm.urdf").write_text(text)
    robot = tm.load_robot(tmp_path / "arm.urdf", kinematic=True)
    assert pickle.loads(pickle.dumps(robot)) == robot
    task = tm.Problem(robot, q_start=START, goal=GOAL, motion_limits=LIMITS)
    tm.save_scenario(tmp_path / "task.toml", task)
    assert tm.load_scenario(tmp_path / "task.toml").problem.robot == robot


SCENE = "world: {collision_objects: []}"
REQUEST = """
group_name: arm
max_acceleration_scaling_factor: 0.5
start_state: {joint_state: {name: [j1, j2], position: [0.0, 0.1]}}
goal_constraints:
- joint_constraints:
  - {joint_name: j1, position: 0.5}
  - {joint_name: j2, position: 0.6}
"""


def test_moveit_requests_need_acceleration_limits(tmp_path: Path) -> None:
    files = tmp_path / "scene.yaml", tmp_path / "request.yaml"
    for path, text in zip(files, (SCENE, REQUEST), strict=True):
        path.write_text(text)
    problem = tm.load_moveit(arm(), *files, kinematic=True)
    assert tm.plan(problem).T == pytest.approx(1.0, rel=1e-5)  # half of 4 rad/s^2
    files[1].write_text(REQUEST.replace("max_acceleration_scaling_factor: 0.5", ""))
    with pytest.raises(tm.ProblemError, match="no acceleration limit for j1, j2"):
        tm.load_moveit(URDF, *files, kinematic=True)
    more = tm.MotionLimits(acceleration=3.0)
    problem = tm.load_moveit(URDF, *files, kinematic=True, motion_limits=more)
    assert problem.motion_limits == more
    limits = tmp_path / "joint_limits.yaml"
    limits.write_text("joint_limits: {j1: {max_acceleration: 4}, j2: {max_jerk: 9}}")
    with pytest.raises(tm.TominpmpError, match="no acceleration limit for j2,"):
        tm.load_moveit(URDF, *files, kinematic=True, joint_limits=limits)
    limits.write_text(
        "joint_limits: {j1: {max_acceleration: 4}, j2: {max_acceleration: 4}}"
    )
    problem = tm.load_moveit(URDF, *files, kinematic=True, joint_limits=limits)
    assert tm.plan(problem).T == pytest.approx(0.5**0.5, rel=1e-5)
    with pytest.raises(tm.ProblemError, match=r"joint_limits is .*load_joint_limits"):
        tm.load_moveit(arm(), *files, joint_limits=limits)
    with pytest.raises(tm.ProblemError, match="kinematic is True"):
        tm.load_moveit(tm.load_robot("planar3r"), *files, kinematic=True)


def test_plots_and_pages_show_accelerations(
    solution: tm.Solution, tmp_path: Path
) -> None:
    figure = solution.plot()
    assert "acceleration" in figure.axes[2].get_title(loc="left")
    (line, *_) = figure.axes[2].lines
    assert np.isfinite(line.get_ydata()).all()
    solution.play(tmp_path / "motion.html")
    page = (tmp_path / "motion.html").read_text(encoding="utf-8")
    assert ">acceleration</b>" in page
    assert "effort" not in solution.problem.robot._repr_html_()


@pytest.mark.parametrize(
    ("make", "error", "says"),
    [
        (lambda: tm.load_robot(URDF), tm.RobotLoadError, "j1, j2.*kinematic=True"),
        (
            lambda: tm.load_robot(URDF, effort=10.0),
            tm.RobotLoadError,
            "j1 and j2 can move without any inertia.*kinematic=True",
        ),
        (
            lambda: tm.load_robot(URDF, kinematic=True, effort=10.0),
            tm.OptionsError,
            "effort is 10",
        ),
        (lambda: tm.load_robot(URDF, kinematic=1), tm.OptionsError, "kinematic is 1"),
        (lambda: arm().with_changes(friction=1.0), tm.OptionsError, "friction is 1"),
        (
            lambda: planned(arm(None)),
            tm.ProblemError,
            "no acceleration limit for j1, j2.*without kinematic=True",
        ),
        (
            lambda: planned(arm(tm.MotionLimits(acceleration={"j1": 1.0}))),
            tm.ProblemError,
            "no acceleration limit for j2,",
        ),
        (
            lambda: planned(arm(), motion_limits=tm.MotionLimits(effort_rate=9.0)),
            tm.ProblemError,
            "effort_rate is given",
        ),
        (
            lambda: planned(arm(), motion_limits=tm.MotionLimits(effort_scale=0.9)),
            tm.ProblemError,
            "effort_scale is given",
        ),
        *(
            (
                lambda options=options: planned(arm(), options=options),
                tm.OptionsError,
                f"{next(iter(options))} is .*no torques",
            )
            for options in (
                {"method": "collocation"},
                {"energy_weight": 0.1},
                {"slack": 0.1},
                {"refine": "switching"},
            )
        ),
        (
            lambda: tm.smooth(planned(arm())),
            tm.ProblemError,
            "kinematic robot: no torques",
        ),
        (
            lambda: tm.combine_robots(
                [("a", arm(), [0, 0, 0]), ("b", tm.load_robot("planar3r"), [9, 0, 0])],
                gravity=[0.0, 0.0, -9.81],
            ),
            tm.ProblemError,
            "a of a, b are kinematic",
        ),
    ],
)
def test_calls_that_need_torques_or_acceleration_limits_are_refused(
    make: Any, error: type[Exception], says: str
) -> None:
    with pytest.raises(error, match=says):
        make()


@pytest.mark.skipif("panda" not in robot_names(), reason="no example-robot-data")
def test_panda_with_moveit_limits_takes_the_time_of_its_slowest_joint(
    tmp_path: Path,
) -> None:
    files = find_robot("panda")
    text = re.sub(r"(?s)<inertial>.*?</inertial>", "", files.urdf.read_text())
    text = re.sub(r'effort="[^"]*"', 'effort="0"', text)
    (tmp_path / "panda.urdf").write_text(text)
    arm_joints = [f"panda_joint{i}" for i in range(1, 8)]
    speeds = [2.175] * 4 + [2.61] * 3
    accelerations = [3.75, 1.875, 2.5, 3.125, 3.75, 5.0, 5.0]
    rows = [
        f"  {joint}: {{has_velocity_limits: true, max_velocity: {v}, "
        f"has_acceleration_limits: true, max_acceleration: {a}}}\n"
        for joint, v, a in zip(arm_joints, speeds, accelerations, strict=True)
    ]
    (tmp_path / "joint_limits.yaml").write_text("joint_limits:\n" + "".join(rows))
    limits = tm.load_joint_limits(tmp_path / "joint_limits.yaml")
    robot = tm.load_robot(
        tmp_path / "panda.urdf",
        package_dirs=[files.urdf.parents[3]],
        locked_joints={"panda_finger_joint1": 0.0},
        kinematic=True,
        **limits.overrides(),
    )
    robot = replace(robot, motion_limits=limits.motion_limits(robot.joint_names))
    start = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
    goal = start + np.array([1.0, 0.5, 0.3, 0.6, 0.2, 0.4, 0.5])
    found = planned(robot, q_start=start, goal=tm.JointGoal(goal))
    # Times of single joints, with or without a phase at the speed limit.
    way, v, a = goal - start, np.array(speeds), np.array(accelerations)
    alone = np.where(way > v**2 / a, way / v + v / a, 2.0 * np.sqrt(way / a))
    assert found.T == pytest.approx(alone.max(), rel=1e-3)


def test_samples_have_no_last_interval_of_nanoseconds(tmp_path: Path) -> None:
    """Regression: a last interval of 87 ns gave accelerations from rounded speeds."""
    found = planned(arm())
    file = found.export(tmp_path / "motion.csv", dt=found.T / (70.0 + 1e-5))
    times = tm.load_motion(file).t
    assert times.size == 71 and times[-1] == found.T
