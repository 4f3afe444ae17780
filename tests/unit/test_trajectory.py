"""Trajectories: interpolation, sampling, checks of fields, equality."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError
from tominpmp.motion.samples import SHORTEST, Samples
from tominpmp.motion.trajectory import MAX_SAMPLES, Trajectory
from tominpmp.robot.robot import Robot

JOINTS = ("j1", "j2")
TIMES = np.array([0.0, 0.25, 0.4, 1.0])
ACCELERATION = np.array([[4.0, -1.0], [0.0, 2.0], [-1.5, 0.5]])


def with_acceleration(**changes: object) -> Trajectory:
    """Accelerations that jump, and torques that are a function of the state."""
    q, v = [np.array([0.3, -0.2])], [np.array([0.1, 0.4])]
    for h, a in zip(np.diff(TIMES), ACCELERATION, strict=True):
        q.append(q[-1] + h * v[-1] + 0.5 * h**2 * a)
        v.append(v[-1] + h * a)
    held = np.vstack([ACCELERATION, ACCELERATION[-1:]])
    values = {
        "joint_names": JOINTS,
        "t": TIMES,
        "q": q,
        "v": v,
        "u": torque(np.array(q), np.array(v), held),
        "a": ACCELERATION,
        "inverse_dynamics": torque,
    }
    return Trajectory(**(values | changes))  # type: ignore[arg-type]


def torque(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    return 2.0 * a + 0.5 * v + np.sin(q)


def cubic(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and accelerations that Hermite polynomials reproduce."""
    t = np.asarray(t)[:, None]
    c = np.array([[0.3, -0.2], [1.0, 0.5], [-2.0, 0.7], [1.1, -0.4]])
    return (
        c[0] + t * (c[1] + t * (c[2] + t * c[3])),
        c[1] + t * (2 * c[2] + 3 * t * c[3]),
        2 * c[2] + 6 * t * c[3],
    )


def with_torque(**changes: object) -> Trajectory:
    """Piecewise constant torques; positions on a cubic."""
    q, v, _ = cubic(TIMES)
    u = np.array([[1.0, -1.0], [2.0, -2.0], [3.0, -3.0], [4.0, -4.0]])
    values = {"joint_names": JOINTS, "t": TIMES, "q": q, "v": v, "u": u}
    return Trajectory(**(values | changes))  # type: ignore[arg-type]


MAKERS = {"acceleration": with_acceleration, "torque": with_torque}
either = pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS.keys())


@either
def test_trajectory_interpolates_its_nodes(make: Callable[[], Trajectory]) -> None:
    motion = make()
    q, v, _, u = motion(motion.t)
    np.testing.assert_allclose(q, motion.q, atol=1e-15)
    np.testing.assert_allclose(v, motion.v, atol=1e-14)
    np.testing.assert_allclose(u, motion.u, atol=1e-14)
    assert motion.duration == 1.0
    assert motion.n == 2


@either
def test_times_outside_the_motion_are_rejected_or_held(
    make: Callable[[], Trajectory],
) -> None:
    motion = make()
    for outside, inside in ((-1.0, 0.0), (-np.inf, 0.0), (1.5, 1.0), (np.inf, 1.0)):
        with pytest.raises(ProblemError, match="outside of the motion"):
            motion(outside)
        held = motion(outside, hold=True)
        np.testing.assert_array_equal(held.q, motion(inside).q)
        assert not held.v.any()
        assert not held.a.any()


@either
def test_single_times_match_arrays_of_times(make: Callable[[], Trajectory]) -> None:
    motion = make()
    times = [0.9, 0.0, 0.25, 0.3, 1.0]  # in any order
    rows = motion(times)
    for name in ("q", "v", "a", "u"):
        assert getattr(rows, name).shape == (5, 2)
        for i, time in enumerate(times):
            single = getattr(motion(time), name)
            assert single.shape == (2,)
            np.testing.assert_array_equal(single, getattr(rows, name)[i])
    assert motion(np.float32(0.5)).q.shape == (2,)
    assert motion([]).u.shape == (0, 2)


@either
def test_velocity_and_acceleration_are_derivatives(
    make: Callable[[], Trajectory],
) -> None:
    motion = make()
    h = 1e-5
    times = np.array([0.05, 0.2, 0.3, 0.39, 0.5, 0.97])
    ahead, here, behind = motion(times + h), motion(times), motion(times - h)
    np.testing.assert_allclose((ahead.q - behind.q) / (2 * h), here.v, atol=1e-9)
    np.testing.assert_allclose((ahead.v - behind.v) / (2 * h), here.a, atol=1e-9)


@either
def test_position_and_velocity_are_continuous(make: Callable[[], Trajectory]) -> None:
    motion = make()
    before = motion(np.nextafter(TIMES[1:3], 0.0))
    after = motion(TIMES[1:3])
    np.testing.assert_allclose(before.q, after.q, atol=1e-14)
    np.testing.assert_allclose(before.v, after.v, atol=1e-14)


def test_accelerations_are_constant_until_the_next_node() -> None:
    motion = with_acceleration()
    np.testing.assert_array_equal(motion(TIMES[:-1]).a, ACCELERATION)
    before = motion(np.nextafter(TIMES[1:], 0.0))
    np.testing.assert_array_equal(before.a, ACCELERATION)
    np.testing.assert_array_equal(motion(1.0).a, ACCELERATION[-1])
    np.testing.assert_array_equal(before.u, torque(before.q, before.v, ACCELERATION))


def test_torques_are_constant_until_the_next_node() -> None:
    motion = with_torque()
    before = motion(np.nextafter(TIMES[1:], 0.0))
    np.testing.assert_array_equal(before.u, motion.u[:-1])
    np.testing.assert_array_equal(motion(1.0).u, motion.u[-1])


def test_hermite_polynomials_reproduce_a_cubic() -> None:
    times = np.linspace(0.0, 1.0, 57)
    q, v, a = cubic(times)
    found = with_torque()(times)
    np.testing.assert_allclose(found.q, q, atol=1e-14)
    np.testing.assert_allclose(found.v, v, atol=1e-13)
    np.testing.assert_allclose(found.a, a, atol=1e-12)


# Sampling


@pytest.mark.parametrize(
    ("dt", "times"),
    [
        (
            0.25,
            [0.0, 0.25, 0.5, 0.75, 1.0],
        ),  # the end is a multiple of dt, and there only once
        (0.1, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]),
        (0.4, [0.0, 0.4, 0.8, 1.0]),
        (1.0, [0.0, 1.0]),
        (5.0, [0.0, 1.0]),  # longer than the motion
        (1 / 3, [0.0, 1 / 3, 2 / 3, 1.0]),
        (np.float32(0.5), [0.0, 0.5, 1.0]),
        (1, [0.0, 1.0]),
    ],
)
def test_sample_times_are_multiples_of_dt_and_the_end(
    dt: float, times: list[float]
) -> None:
    motion = with_acceleration()
    samples = motion.sample(dt)
    assert samples.joint_names == JOINTS
    np.testing.assert_allclose(samples.t, times, atol=1e-15)
    assert samples.t[-1] == motion.duration
    for name, values in motion(samples.t)._asdict().items():
        np.testing.assert_array_equal(getattr(samples, name), values)


@given(
    duration=st.floats(1e-3, 1e3),
    count=st.floats(0.1, 500.0),
)
def test_samples_are_evenly_spaced_except_the_last(
    duration: float, count: float
) -> None:
    motion = Trajectory(
        ("j",), [0.0, duration], [[0.0], [1.0]], [[0.0]] * 2, [[0.0]] * 2
    )
    dt = duration / count
    t = motion.sample(dt).t
    assert t[0] == 0.0
    assert t[-1] == duration
    steps = np.diff(t)
    assert np.all(steps > 0.0)
    np.testing.assert_allclose(steps[:-1], dt, rtol=1e-6)
    assert steps[-1] <= dt * (1.0 + SHORTEST + 1e-6)


@pytest.mark.parametrize(
    "dt", [0.0, -0.1, np.nan, np.inf, None, "0.1", [0.1], True, 0.5 / MAX_SAMPLES]
)
def test_wrong_sampling_time_is_rejected(dt: object) -> None:
    with pytest.raises(
        ProblemError, match=r"^dt is .*(expected a positive time|small)"
    ) as e:
        with_torque().sample(dt)  # type: ignore[arg-type]
    assert e.value.field == "dt"


@pytest.mark.parametrize("time", [np.nan, [0.1, np.nan], None, "0.1", [[0.1]], {}])
def test_wrong_time_is_rejected(time: object) -> None:
    with pytest.raises(ProblemError, match=r"^time is .*expected") as caught:
        with_torque()(time)  # type: ignore[arg-type]
    assert caught.value.field == "time"


# Bad fields


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("q", np.zeros((3, 2)), r"q has shape \(3, 2\), expected \(4, 2\)"),
        ("v", np.zeros((4, 1)), r"v has shape \(4, 1\), expected \(4, 2\)"),
        ("u", np.zeros(4), r"u has shape \(4,\), expected \(4, 2\)"),
        ("a", np.zeros((5, 2)), r"a has shape \(5, 2\), expected \(3, 2\)"),
        ("t", np.zeros((4, 1)), r"t has shape \(4, 1\), expected \(m,\)"),
        ("t", [0.0, 0.25, 0.25, 1.0], "increase from 0"),
        ("t", [0.0, 0.4, 0.25, 1.0], "increase from 0"),
        ("t", [0.1, 0.25, 0.4, 1.0], "increase from 0"),
        ("t", [0.0, np.nan, 0.4, 1.0], "finite"),
        ("t", [0.0, 0.25, 0.4, np.inf], "finite"),
        ("q", "abc", "expected 2 numbers, one for each joint"),
        ("q", [[1.0, 2.0], [1.0]], "expected 2 numbers"),
        ("u", None, "expected 2 numbers"),
        ("segment_dynamics", (torque, torque), "expected for each segment"),
    ],
)
def test_wrong_field_of_a_trajectory_is_named(
    field: str, value: object, message: str
) -> None:
    with pytest.raises(ProblemError, match=message) as caught:
        with_acceleration(**{field: value})
    assert caught.value.field == field


def test_trajectory_without_nodes_is_rejected() -> None:
    none = np.zeros((0, 1))
    with pytest.raises(ProblemError, match="increase from 0"):
        Trajectory(("j",), [], none, none, none)


@pytest.mark.parametrize("a", [None, np.zeros((0, 1)), [[0.25]]])
def test_trajectory_of_one_node_has_no_duration(a: Any) -> None:
    motion = Trajectory(("j",), [0.0], [[1.0]], [[0.5]], [[2.0]], a)
    assert motion.duration == 0.0
    state = motion(0.0)
    assert (state.q[0], state.v[0], state.u[0]) == (1.0, 0.5, 2.0)
    acceleration = 0.0 if a is None or not len(a) else 0.25
    assert state.a[0] == acceleration
    derivatives = [motion(0.0, nu=k)[0] for k in range(4)]
    assert derivatives == [1.0, 0.5, acceleration, 0.0]
    held = motion([0.0, 3.0], hold=True)
    assert held.q.tolist() == [[1.0], [1.0]]
    assert held.v.tolist() == [[0.5], [0.0]]
    with pytest.raises(ProblemError, match="outside of the motion"):
        motion(1e-6)
    samples = motion.sample(0.01)
    assert samples.t.tolist() == [0.0]
    assert samples.q.tolist() == [[1.0]]
    with_end = replace(motion, segment_ends=[0.0, 0.0])
    assert with_end.segment_at(np.zeros(1)).tolist() == [1]


# Immutability and equality


def test_arrays_of_a_trajectory_are_read_only_copies() -> None:
    q = np.zeros((4, 2))
    motion = with_torque(q=q)
    q[:] = 7.0
    assert not np.any(motion.q)
    samples = motion.sample(0.5)
    for record in (
        motion,
        samples,
        pickle.loads(pickle.dumps(motion)),
        copy.copy(motion),
    ):
        for name in ("t", "q", "v", "u"):
            with pytest.raises(ValueError, match="read-only"):
                getattr(record, name)[0] = 1.0


def test_trajectories_are_equal_by_value() -> None:
    motion = with_acceleration()
    assert motion == with_acceleration()
    assert hash(motion) == hash(with_acceleration())
    assert motion == with_acceleration(inverse_dynamics=None)
    assert motion != with_acceleration(u=np.zeros((4, 2)))
    assert motion != with_acceleration(a=None)
    assert motion != "a motion"
    samples = motion.sample(0.1)
    assert samples == with_acceleration().sample(0.1)
    assert samples != replace(samples, q=samples.q + 1.0)
    assert len({samples, motion.sample(0.1)}) == 1


def test_pickled_trajectory_keeps_its_inverse_dynamics(planar3r: Robot) -> None:
    dynamics = RobotDynamics(planar3r)
    a = np.array([[1.0, -2.0, 3.0]])
    q = np.array([[0.5, 1.7, -1.7], [1.0, 0.7, -0.2]])
    v = np.array([[0.0, 0.0, 0.0], [1.0, -2.0, 3.0]])
    u = dynamics.inverse(q, v, np.vstack([a, a]))
    names = planar3r.joint_names
    motion = Trajectory(names, [0.0, 1.0], q, v, u, a, dynamics.inverse)
    back = pickle.loads(pickle.dumps(motion))
    assert back == motion
    np.testing.assert_array_equal(back(0.3).u, motion(0.3).u)
    assert isinstance(back.sample(0.5), Samples)
