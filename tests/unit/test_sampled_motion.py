"""Making trajectories from recorded motions:

`join` on samples of motion files and of callers.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ScenarioError
from tominpmp.files.export import export, load_motion
from tominpmp.motion.joining import join
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.robot.robot import Robot, load_robot

HERE = Path("m.csv")
NAMES = ("joint1", "joint2", "joint3")


def smooth(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and accelerations of a motion from rest to rest in 2 s."""
    s = t[:, None] / 2.0
    span = np.array([1.0, -0.5, 0.25])
    q = np.array([0.5, 1.7, -1.7]) + span * s**3 * (10 - 15 * s + 6 * s**2)
    v = span * 30 * s**2 * (1 - s) ** 2 / 2.0
    a = span * 60 * s * (1 - 3 * s + 2 * s**2) / 4.0
    return q, v, a


def samples_of(t: np.ndarray, **changes: np.ndarray) -> Samples:
    q, v, a = smooth(t)
    lacking = np.full(q.shape, np.nan)
    parts = {"q": q, "v": v, "a": a, "u": lacking} | changes
    return Samples(NAMES, t, **parts)


def test_exported_motion_of_constant_accelerations_is_joined_exactly(
    planar3r: Robot, tmp_path: Path
) -> None:
    dynamics = RobotDynamics(planar3r)
    t = np.array([0.0, 0.3, 0.5, 1.0])
    a = np.array([[1.0, -2.0, 0.5], [0.0, 1.0, 0.0], [-1.0, 0.5, 0.25]])
    q, v = [np.array([0.5, 1.7, -1.7])], [np.zeros(3)]
    for h, row in zip(np.diff(t), a, strict=True):
        q.append(q[-1] + h * v[-1] + 0.5 * h**2 * row)
        v.append(v[-1] + h * row)
    rows = np.array(q), np.array(v)
    u = dynamics.inverse(*rows, np.vstack([a, a[-1:]]))
    motion = Trajectory(NAMES, t, *rows, u, a, dynamics.inverse)
    for ending in ("csv", "npz"):
        path = export(motion, tmp_path / f"m.{ending}")
        assert join(load_motion(path), planar3r, path).trajectory == motion
    # Jumps of the acceleration between two samples are joined again.
    between = np.linspace(0.0, 1.0, 77)
    for ending in ("csv", "npz"):
        path = export(motion, tmp_path / f"m.{ending}", dt=0.04)
        joined = join(load_motion(path), planar3r, path).trajectory
        assert joined.a is not None
        assert joined.t.size == 27 + 1  # the jump at 0.3 is between samples
        np.testing.assert_allclose(joined(between).q, motion(between).q, atol=1e-7)
        np.testing.assert_allclose(joined(between).a, motion(between).a, atol=1e-9)
        np.testing.assert_allclose(joined(between).u, motion(between).u, atol=1e-5)


def test_torques_come_from_inverse_dynamics_of_the_joined_motion(
    planar3r: Robot,
) -> None:
    t = np.linspace(0.0, 2.0, 201)
    lacking = np.full((201, 3), np.nan)
    motion = join(samples_of(t, a=lacking), planar3r, HERE).trajectory
    assert motion.a is None
    between = np.linspace(0.003, 1.997, 50)
    q, v, a = smooth(between)
    state = motion(between)
    np.testing.assert_allclose(state.q, q, atol=1e-8)
    np.testing.assert_allclose(state.v, v, atol=1e-6)
    expected = RobotDynamics(planar3r).inverse(q, v, a)
    np.testing.assert_allclose(state.u, expected, atol=0.05)
    np.testing.assert_allclose(motion.u[1:-1], motion(t[1:-1]).u, atol=1e-9)


def test_samples_with_smooth_accelerations_are_interpolated_exactly(
    planar3r: Robot,
) -> None:
    motion = join(samples_of(np.linspace(0.0, 2.0, 21)), planar3r, HERE).trajectory
    between = np.linspace(0.003, 1.997, 50)
    q, v, a = smooth(between)
    state = motion(between)
    # The motion is of degree 5.
    np.testing.assert_allclose(state.q, q, atol=1e-12)
    expected = RobotDynamics(planar3r).inverse(q, v, a)
    np.testing.assert_allclose(state.u, expected, atol=1e-8)


@pytest.mark.parametrize(
    ("rows", "share"), [(2_001, 1.0), (2_001, 0.01), (20_001, 1.0)]
)
def test_dense_samples_of_a_smooth_motion_are_no_steps(
    planar3r: Robot, rows: int, share: float
) -> None:
    """Regression: they were joined as steps, in whose velocities errors added up.

    From one sample to the next, the error of steps was less than that of rounding.
    """
    t = np.linspace(0.0, 2.0, rows)
    q, v, a = smooth(t)
    q = q[0] + share * (q - q[0])
    found = join(samples_of(t, q=q, v=share * v, a=share * a), planar3r)
    assert found.manner == "quintic"


def test_recorded_accelerations_that_jump_are_ignored(planar3r: Robot) -> None:
    t = np.linspace(0.0, 2.0, 21)
    jumping = smooth(t)[2]
    jumping[10:] += 1.0
    assert join(samples_of(t, a=jumping), planar3r, HERE).trajectory.a is None


def test_velocities_are_estimated_from_positions_alone(planar3r: Robot) -> None:
    t = np.linspace(0.0, 2.0, 81)
    lacking = np.full((81, 3), np.nan)
    motion = join(samples_of(t, v=lacking, a=lacking), planar3r, HERE).trajectory
    np.testing.assert_allclose(motion.v, smooth(t)[1], atol=1e-4)
    np.testing.assert_allclose(motion.v[[0, -1]], np.zeros((2, 3)), atol=1e-12)


def test_first_sample_after_time_zero_needs_the_start_state(planar3r: Robot) -> None:
    t = np.linspace(0.0, 2.0, 81)
    whole = samples_of(t)
    late = Samples(
        NAMES, *(getattr(whole, key)[4:] for key in ("t", "q", "v", "a", "u"))
    )
    start = smooth(t[:1])[0][0]
    motion = join(late, planar3r, HERE, (start, np.zeros(3))).trajectory
    assert motion.t[0] == 0.0
    np.testing.assert_array_equal(motion.q[0], start)
    np.testing.assert_allclose(motion.v[1:], whole.v[4:], atol=5e-3)
    with pytest.raises(ScenarioError, match=r"time: begins at 0\.1 s") as caught:
        join(late, planar3r, HERE)
    assert caught.value.key == "time"
    early = Samples(NAMES, whole.t - 1.0, whole.q, whole.v, whole.a, whole.u)
    with pytest.raises(ScenarioError, match="time: begins at -1 s"):
        join(early, planar3r, HERE, (start, np.zeros(3)))
    # Nothing can be divided by a time as short as this.
    soon = Samples(
        NAMES,
        np.array([1e-320, 1.0]),
        *(x[:2] for x in (whole.q, whole.v, whole.a, whole.u)),
    )
    with pytest.raises(ScenarioError, match=r"begins at .*e-321 s"):
        join(soon, planar3r, HERE, (start, np.zeros(3)))


@pytest.mark.parametrize("interpolation", ["auto", "controller"])
@pytest.mark.parametrize(
    ("times", "position", "row"),
    [
        ([0.0, 1.0, 1.0, 2.0], 0.3, 3),
        ([0.0, np.nan, 1.0, 2.0], 0.3, 2),
        ([0.0, 1.0, 2.0, np.inf], 0.3, 4),
        ([0.0, 0.5, 1.0, 2.0], np.nan, 2),
        ([0.0, 0.5, 1.0, 2.0], np.inf, 2),
        ([], 0.3, 1),
    ],
)
def test_samples_with_unordered_times_or_without_positions_are_rejected(
    planar3r: Robot, interpolation: str, times: list[float], position: float, row: int
) -> None:
    """Regression: samples given by a caller reached SciPy, which refused to join them
    with messages of its own.
    """
    q = np.zeros((len(times), 3))
    q[1:2, 1] = position
    lacking = np.full(q.shape, np.nan)
    samples = Samples(NAMES, times, q, lacking, lacking, lacking, interpolation)
    with pytest.raises(ScenarioError, match=f"the motion: row {row}: expected finite"):
        join(samples, planar3r)


def test_columns_are_assigned_to_joints_by_name(planar3r: Robot) -> None:
    t = np.linspace(0.0, 2.0, 21)
    whole = samples_of(t)
    rows = [getattr(whole, key)[:, ::-1] for key in ("q", "v", "a", "u")]
    turned = Samples(NAMES[::-1], t, *rows)
    assert join(turned, planar3r, HERE) == join(whole, planar3r, HERE)
    other = Samples(("joint1", "joint2", "elbow"), t, *rows)
    message = r"joint1, joint2, elbow; the joints of"
    with pytest.raises(ScenarioError, match=message) as caught:
        join(other, planar3r, HERE)
    assert caught.value.path == HERE
    problem = tm.Problem(planar3r, whole.q[0], tm.JointGoal(whole.q[-1]))
    with pytest.raises(ScenarioError, match=f"the motion: .*{message}") as caught:
        tm.verify(problem, other)
    assert caught.value.path is None  # the samples are not from a file


def test_dry_friction_of_a_single_row_is_that_of_a_longer_motion() -> None:
    robot = load_robot("planar3r", friction=0.5)
    t = np.array([0.0, 1e-3])
    a = np.tile([5.0, -5.0, 0.0], (2, 1))
    v = a * t[:, None]
    q = np.array([0.5, 1.7, -1.7]) + 0.5 * v * t[:, None]
    longer, single = (
        join(Samples(NAMES, t[:k], q[:k], v[:k], a[:k], np.full((k, 3), np.nan)), robot)
        for k in (2, 1)
    )
    np.testing.assert_array_equal(single.trajectory.turns.first, [[1.0, -1.0, 0.0]])
    first = [joined.trajectory(np.zeros(1)).u for joined in (single, longer)]
    np.testing.assert_allclose(*first, atol=1e-9)


def test_recorded_locked_joints_are_dropped_if_they_stay_at_their_lock(
    planar3r: Robot,
) -> None:
    t = np.linspace(0.0, 2.0, 21)
    q = smooth(t)[0]
    q[:, 2] = -1.7
    samples = samples_of(t, q=q)
    locked = load_robot("planar3r", locked_joints={"joint3": -1.7})
    assert join(samples, locked, HERE).trajectory.joint_names == NAMES[:2]
    elsewhere = load_robot("planar3r", locked_joints={"joint3": -1.0})
    with pytest.raises(ScenarioError, match=r"joint3: is up to 0\.7 away from -1"):
        join(samples, elsewhere, HERE)
    with pytest.raises(ScenarioError, match="row 1: expected finite positions"):
        join(samples_of(t[:0]), locked, HERE)
    q[3, 2] = np.nan
    with pytest.raises(ScenarioError, match="row 4: expected finite positions"):
        join(samples_of(t, q=q), locked, HERE)
