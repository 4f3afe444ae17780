"""Exported motions as a joint trajectory controller of ROS 2 interpolates them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from motion_samples import END, START, quintic, speed_up_and_brake

from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError, ScenarioError, TominpmpWarning
from tominpmp.files.export import export, load_motion
from tominpmp.motion.joining import join
from tominpmp.motion.measures import accelerations_continue
from tominpmp.motion.samples import Samples, clock
from tominpmp.motion.trajectory import Trajectory
from tominpmp.robot.robot import Robot

ROS_ENDINGS = ("yaml", "json", "mcap")
BETWEEN = np.linspace(0.0, 0.95, 173)


@pytest.fixture
def jumping(planar3r: Robot) -> Trajectory:
    """Accelerations constant on 12 intervals, from rest to rest in 0.95 s."""
    return speed_up_and_brake(planar3r, START, END, 0.95, 12)


def smooth(robot: Robot, nodes: int = 21) -> Trajectory:
    """From rest to rest with accelerations that do not jump."""
    held = quintic(robot, START, END, 1.0, nodes - 1)
    way, s = np.subtract(END, START), held.t[:, None]
    a = (60 * s - 180 * s**2 + 120 * s**3) * way
    return replace(held, a=a, inverse_dynamics=RobotDynamics(robot).inverse)


def controller(message: dict[str, Any], time: float) -> np.ndarray:
    """Position and velocity that the joint trajectory controller commands.

    By its documentation, a polynomial passes through positions, and velocities, and
    accelerations, of the points before and after; here the equations are solved.
    """
    points = message["points"]
    times = [
        p["time_from_start"]["sec"] + p["time_from_start"]["nanosec"] * 1e-9
        for p in points
    ]
    k = min(int(np.searchsorted(times, time, side="right")) - 1, len(points) - 2)
    h, s = times[k + 1] - times[k], time - times[k]
    kinds = [
        kind
        for kind in ("positions", "velocities", "accelerations")
        if points[k][kind] and points[k + 1][kind]
    ]
    size = 2 * len(kinds)
    rows, values = [], []
    for at, point in ((0.0, points[k]), (h, points[k + 1])):
        for order, kind in enumerate(kinds):
            rows.append(derivatives(at, order, size))
            values.append(point[kind])
    c = np.linalg.solve(np.array(rows), np.array(values))
    return np.array([derivatives(s, order, size) @ c for order in (0, 1)])


def derivatives(s: float, order: int, size: int) -> list[float]:
    return [
        float(np.prod(range(p - order + 1, p + 1))) * s ** (p - order)
        if p >= order
        else 0.0
        for p in range(size)
    ]


@pytest.mark.parametrize("ending", ROS_ENDINGS)
@pytest.mark.parametrize("dt", [None, 0.05, 0.013])
def test_motion_file_is_joined_as_the_controller_interpolates_it(
    planar3r: Robot, ending: str, dt: float | None, tmp_path: Path
) -> None:
    for motion in (
        speed_up_and_brake(planar3r, START, END, 0.95, 12),
        smooth(planar3r),
    ):
        path = export(motion, tmp_path / f"m.{ending}", dt=dt)
        message = json.loads(export(motion, tmp_path / "m2.json", dt=dt).read_text())
        found = join(load_motion(path), planar3r, path).trajectory
        for time in np.linspace(0.0, 0.9499, 40):
            state = found(time)
            q, v = controller(message, time)
            np.testing.assert_allclose(state.q, q, atol=1e-9)
            np.testing.assert_allclose(state.v, v, atol=1e-7)


def test_jumping_accelerations_are_not_exported_to_messages(
    planar3r: Robot, jumping: Trajectory, tmp_path: Path
) -> None:
    assert not accelerations_continue(jumping)
    path = export(jumping, tmp_path / "m.yaml")
    samples = load_motion(path)
    assert np.isnan(samples.a).all()
    assert join(samples, planar3r, path).manner == "cubic"
    found = join(samples, planar3r, path).trajectory
    np.testing.assert_allclose(found(BETWEEN).q, jumping(BETWEEN).q, atol=1e-9)
    np.testing.assert_allclose(found(BETWEEN).v, jumping(BETWEEN).v, atol=1e-7)
    np.testing.assert_allclose(found(BETWEEN).u, jumping(BETWEEN).u, atol=1e-3)
    # With these accelerations, the controller would overshoot by far.
    wrong = replace(samples, a=jumping(samples.t).a)
    overshoot = join(wrong, planar3r, path).trajectory(BETWEEN).a - jumping(BETWEEN).a
    assert np.abs(overshoot).max() > 0.5 * np.abs(jumping(BETWEEN).a).max()


def test_continuous_accelerations_are_exported_to_messages(
    planar3r: Robot, tmp_path: Path
) -> None:
    motion = smooth(planar3r)
    assert accelerations_continue(motion)
    path = export(motion, tmp_path / "m.yaml", dt=0.1)
    samples = load_motion(path)
    assert join(samples, planar3r, path).manner == "quintic"
    found = join(samples, planar3r, path).trajectory
    between = np.linspace(0.0, 1.0, 211)
    # The motion is of degree 5, so that any of its points determine it.
    np.testing.assert_allclose(found(between).q, motion(between).q, atol=1e-9)
    np.testing.assert_allclose(found(between).a, motion(between).a, atol=1e-5)


def test_cubic_motion_with_continuous_accelerations_exports_them(
    planar3r: Robot, tmp_path: Path
) -> None:
    t = np.array([0.0, 0.2, 0.5, 1.0])
    a = np.array([[0.0, 0, 0], [3.0, -2, 1], [-1.0, 1, 0], [0.5, 0, 2]])
    h = np.diff(t)[:, None]
    v = np.vstack([np.zeros(3), np.cumsum(0.5 * h * (a[1:] + a[:-1]), axis=0)])
    steps = h * v[:-1] + h**2 * (2 * a[:-1] + a[1:]) / 6
    q = np.vstack([START, START + np.cumsum(steps, axis=0)])
    inverse = RobotDynamics(planar3r).inverse
    motion = Trajectory(planar3r.joint_names, t, q, v, inverse(q, v, a), None, inverse)
    assert accelerations_continue(motion)
    samples = load_motion(export(motion, tmp_path / "m.json"))
    np.testing.assert_allclose(samples.a, a, atol=1e-9)
    assert not accelerations_continue(replace(motion, v=1.01 * v))


@pytest.mark.parametrize("ending", ROS_ENDINGS)
def test_effort_is_exported_on_request_only(
    jumping: Trajectory, ending: str, tmp_path: Path
) -> None:
    path = tmp_path / f"m.{ending}"
    assert np.isnan(load_motion(export(jumping, path)).u).all()
    with_effort = load_motion(export(jumping, path, with_effort=True))
    np.testing.assert_array_equal(with_effort.u[0], jumping.u[0])


def test_joined_trajectory_does_not_depend_on_the_effort(
    planar3r: Robot, jumping: Trajectory, tmp_path: Path
) -> None:
    without = load_motion(export(jumping, tmp_path / "m.json"))
    wrong = replace(without, u=np.full(without.q.shape, 1e3))
    assert join(wrong, planar3r).trajectory == join(without, planar3r).trajectory


def test_positions_without_velocities_are_joined_by_lines(planar3r: Robot) -> None:
    t = np.array([0.0, 0.5, 1.0])
    q = np.array([START, [0.6, 1.7, -1.7], [0.6, 1.5, -1.7]])
    unknown = np.full(q.shape, np.nan)
    samples = Samples(planar3r.joint_names, t, q, unknown, unknown, unknown)
    joined = join(replace(samples, interpolation="controller"), planar3r)
    assert joined.manner == "linear"
    assert "0.4 rad/s of joint joint2 at 0.5 s" in str(joined)
    state = joined.trajectory([0.25, 0.75])
    np.testing.assert_allclose(state.q, [[0.55, 1.7, -1.7], [0.6, 1.6, -1.7]])
    np.testing.assert_allclose(state.v, [[0.2, 0.0, 0.0], [0.0, -0.4, 0.0]])
    # A table is interpolated as the record of a smooth motion.
    assert join(samples, planar3r).manner == "spline"


def test_interpolation_of_a_motion_file_can_be_chosen(
    planar3r: Robot, jumping: Trajectory, tmp_path: Path
) -> None:
    path = export(jumping, tmp_path / "m.csv")
    manners = {"auto": "steps", "controller": "quintic", "cubic": "cubic"}
    for interpolation, manner in manners.items():
        samples = load_motion(path, interpolation=interpolation)  # type: ignore[arg-type]
        assert join(samples, planar3r, path).manner == manner
    for wrong in ("quadratic", 5, None, ["auto"]):
        if wrong is not None:
            with pytest.raises(ProblemError, match="expected one of: auto, controller"):
                load_motion(path, interpolation=wrong)  # type: ignore[arg-type]
    lacking = replace(load_motion(path), v=np.full(jumping.q.shape, np.nan))
    for interpolation in ("controller", "cubic"):
        with pytest.raises(ScenarioError, match=r"csv: velocities: are missing, which"):
            join(replace(lacking, interpolation=interpolation), planar3r, path)


def test_first_point_after_time_zero_is_joined_to_the_start(planar3r: Robot) -> None:
    t = np.array([0.4, 1.0])
    q = np.array([[0.6, 1.7, -1.7], END])
    v = np.array([[0.3, 0.0, 0.0], [0.0, 0.0, 0.0]])
    unknown = np.full(q.shape, np.nan)
    samples = Samples(planar3r.joint_names, t, q, v, unknown, unknown, "controller")
    speed = np.array([0.1, 0.0, 0.0])
    start = np.array(START)
    found = join(samples, planar3r, start=(start, speed)).trajectory
    np.testing.assert_array_equal(found.q[0], start)
    np.testing.assert_array_equal(found.v, [speed, *v])
    at_rest = join(samples, planar3r, start=(start, 0.0 * start)).trajectory
    np.testing.assert_array_equal(at_rest.v[0], np.zeros(3))


# Times


@pytest.mark.parametrize("dt", [0.001, 0.002, 0.004, 0.008, 0.01, 1 / 240])
def test_clock_times_are_shortest_decimals_of_the_period(dt: float) -> None:
    times = clock(10.0 * dt * 997, dt)
    k = np.arange(9971)
    assert times.size == 9971
    if dt == 1 / 240:
        np.testing.assert_array_equal(times[:-1], k[:-1] * dt)
    else:
        # The number as typed: 0.003, not 0.0030000000000000005.
        typed = [float(f"{i * round(dt * 1000)}e-3") for i in k]
        np.testing.assert_array_equal(times[:-1], typed[:-1])


def test_last_sample_is_at_the_end_of_the_motion(
    jumping: Trajectory, tmp_path: Path
) -> None:
    for ending in ("csv", "yaml"):
        samples = load_motion(export(jumping, tmp_path / f"m.{ending}", dt=0.3))
        np.testing.assert_array_equal(samples.t, [0.0, 0.3, 0.6, 0.9, 0.95])
        np.testing.assert_allclose(samples.q[-1], jumping.q[-1], atol=1e-15)


def test_samples_at_knots_have_the_acceleration_after_the_jump(planar3r: Robot) -> None:
    motion = speed_up_and_brake(planar3r, START, END, 1.2, 12)
    # Knots of a planner may be sums of periods, which differ from the multiples.
    summed = np.concatenate([[0.0], np.cumsum(np.full(12, 0.1))])
    assert np.any(summed != clock(1.2, 0.1))
    motion = replace(motion, t=summed)
    samples = motion.sample(0.1)
    np.testing.assert_array_equal(samples.a[:-1], motion.a)


@pytest.mark.parametrize("gap", [1e-10, 3e-9, 2e-8])
def test_nodes_within_nanoseconds_are_merged_in_messages(
    planar3r: Robot, jumping: Trajectory, gap: float, tmp_path: Path
) -> None:
    """Points a few nanoseconds apart would need accelerations beyond all bounds."""
    close = jumping.t[4] + gap
    state = jumping(close)
    assert jumping.a is not None
    motion = Trajectory(
        jumping.joint_names,
        np.insert(jumping.t, 5, close),
        np.insert(jumping.q, 5, state.q, axis=0),
        np.insert(jumping.v, 5, state.v, axis=0),
        np.insert(jumping.u, 5, state.u, axis=0),
        np.insert(jumping.a, 5, jumping.a[4], axis=0),
        jumping.inverse_dynamics,
    )
    samples = load_motion(export(motion, tmp_path / "m.yaml"))
    assert samples.t.size == jumping.t.size
    found = join(samples, planar3r).trajectory
    assert np.abs(found(BETWEEN).a - jumping(BETWEEN).a).max() < 1e-3


@pytest.mark.parametrize("duration", [0.95, 0.1 + 0.2, 1 / 3, 2 / 7, np.pi])
def test_last_point_is_at_rest_and_not_before_the_end(
    planar3r: Robot, duration: float, tmp_path: Path
) -> None:
    motion = speed_up_and_brake(planar3r, START, END, duration, 8)
    samples = load_motion(export(motion, tmp_path / "m.yaml"))
    # Half a nanosecond before its end the arm still moves.
    np.testing.assert_array_equal(samples.v[-1], np.zeros(3))
    np.testing.assert_array_equal(samples.q[-1], motion.q[-1])
    np.testing.assert_array_equal(samples.q[0], motion.q[0])
    assert samples.t[0] == 0.0
    assert samples.t[-1] == pytest.approx(duration, abs=1.1e-9)


# Messages


@pytest.mark.parametrize("ending", ["yaml", "json"])
@pytest.mark.parametrize(
    ("message", "keys"),
    [
        ("JointTrajectory", []),
        ("FollowJointTrajectory", ["trajectory"]),
        ("RobotTrajectory", ["joint_trajectory"]),
    ],
)
def test_trajectory_is_wrapped_in_the_chosen_message(
    jumping: Trajectory, ending: str, message: str, keys: list[str], tmp_path: Path
) -> None:
    path = export(jumping, tmp_path / f"m.{ending}", message=message)
    found = yaml.safe_load(path.read_text(encoding="utf-8"))
    for key in keys:
        assert list(found) == [key]
        found = found[key]
    assert list(found) == ["header", "joint_names", "points"]
    samples = load_motion(path)
    assert samples.interpolation == "controller"
    np.testing.assert_array_equal(samples.q, load_motion(path).q)
    assert samples.t.size == jumping.t.size


@pytest.mark.parametrize("ending", ["yaml", "json"])
def test_numbers_and_names_are_readable_by_yaml_1_1(
    ending: str, tmp_path: Path
) -> None:
    """YAML 1.1 reads ``1e-05`` as a text, and a surrogate pair as two characters; the
    library's reader, as YAML 1.2, reads 1e5 as a number.
    """
    names = ('a,"b"', "on", "ü 🤖", "line\nbreak", "1e5")
    q = np.array([[1e-5, -2e-300, 1e100, 0.0, 1.0], [1.5e-7, 2.0, 1e22, -0.0, 1.0]])
    motion = Trajectory(names, np.array([0.0, 1.0]), q, 0 * q, 0 * q)
    path = export(motion, tmp_path / f"m.{ending}")
    points = yaml.safe_load(path.read_text(encoding="utf-8"))["points"]
    assert [point["positions"] for point in points] == q.tolist()
    assert load_motion(path).joint_names == names
    if ending == "yaml":
        assert yaml.safe_load(path.read_text("utf-8"))["joint_names"] == list(names)


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("m.yaml", {"message": "JointState"}, "message is 'JointState', expected one"),
        ("m.yaml", {"message": 5}, "message is 5, expected one of: None, Joint"),
        ("m.csv", {"with_effort": True}, r"with_effort is for ROS messages \(.yaml"),
        ("m.npz", {"message": "JointTrajectory"}, "message is for ROS messages"),
        ("m.yaml", {"with_effort": "yes"}, "with_effort is 'yes', expected True"),
        (
            "m.mcap",
            {"message": "FollowJointTrajectory"},
            "expected JointTraj",
        ),
        ("m.yaml", {"dt": 5e-8}, "expected 100 ns at least"),
    ],
)
def test_invalid_export_option_is_named_in_the_error(
    jumping: Trajectory, name: str, options: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(ProblemError, match=words):
        export(jumping, tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ending", ["csv", "npz", "yaml", "json", "mcap"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_export_rejects_values_that_are_not_finite(
    jumping: Trajectory, ending: str, value: float, tmp_path: Path
) -> None:
    q = jumping.q.copy()
    q[3, 1] = value
    with pytest.raises(
        ProblemError, match=r"q of the motion is (nan|inf) .* joint 'joint2'"
    ):
        export(replace(jumping, q=q), tmp_path / f"m.{ending}")
    assert list(tmp_path.iterdir()) == []


def point(**changes: Any) -> dict[str, Any]:
    return {"positions": [0.0], "time_from_start": {"sec": 0}} | changes


def load(folder: Path, **around: Any) -> Samples:
    points = [point(), point(time_from_start={"sec": 1})]
    path = folder / "m.json"
    message = {"joint_names": ["a"], "points": points}
    path.write_text(json.dumps({"trajectory": message} | around))
    return load_motion(path)


@pytest.mark.parametrize(
    ("around", "words"),
    [
        ({"path_tolerance": [{"name": "a", "position": 0.1}]}, "path_tolerance is ign"),
        (
            {"goal_time_tolerance": {"sec": 1, "nanosec": 0}},
            "goal_time_tolerance is ign",
        ),
        ({"speed_scaling": 0.5}, "speed_scaling is ign"),
    ],
)
def test_ignored_fields_of_a_message_are_named_in_a_warning(
    around: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.warns(TominpmpWarning, match=words):
        assert load(tmp_path, **around).t.size == 2


def test_empty_fields_of_a_message_give_no_warning(tmp_path: Path) -> None:
    multiple = {"header": {"stamp": {"sec": 0}}, "joint_names": [], "points": []}
    found = load(
        tmp_path,
        path_tolerance=[],
        goal_time_tolerance={"sec": 0, "nanosec": 0},
        multi_dof_trajectory=multiple,
    )
    assert found.t.size == 2


@pytest.mark.parametrize("name", ["multi_dof_trajectory", "multi_dof_joint_trajectory"])
def test_multi_dof_trajectory_is_rejected(name: str, tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="several degrees of freedom"):
        load(tmp_path, **{name: {"joint_names": ["base"], "points": [{}]}})


def test_unknown_key_of_a_message_is_named_in_the_error(tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    points = [point(velocity=[0.0]), point(time_from_start={"sec": 1})]
    path.write_text(json.dumps({"joint_names": ["a"], "points": points}))
    with pytest.raises(ScenarioError, match=r"points\[0\]\.velocity: there is no such"):
        load_motion(path)
    points[0].pop("velocity")
    path.write_text(json.dumps({"joint_names": ["a"], "points": points, "rate": 1}))
    with pytest.raises(ScenarioError, match="rate: there is no such key"):
        load_motion(path)
