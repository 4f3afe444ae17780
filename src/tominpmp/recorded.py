"""Motions from files as trajectories of a robot, whoever planned them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from tominpmp.arrays import Array
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError, ScenarioError
from tominpmp.robot import Robot
from tominpmp.trajectory import Samples, Trajectory

# A locked joint may be this far from its place in a recorded motion [rad or m].
APART = 1e-3
# Deviations up to which positions and velocities are what the accelerations make,
# relative to the largest ones: more than rounding, as jumps may come in pairs.
EXACT_Q, EXACT_V = 1e-8, 1e-6
# Times of ROS messages are rounded to this [s].
NANOSECOND = 1e-9
# Deviation of a change of velocity from the mean of the accelerations before and after,
# relative to the largest one, up to which accelerations are taken not to jump.
SMOOTH = 0.02


def recorded_motion(
    samples: Samples,
    robot: Robot,
    path: str | Path | None = None,
    *,
    start: Array | None = None,
) -> Trajectory:
    """Make a trajectory of a robot from samples.

    Columns are found by the names of their joints. If the samples are those of a motion
    whose acceleration is constant but for a jump between two samples at most, this
    motion comes back. Else they are joined by polynomials, of degree 5 if they have
    accelerations that do not jump, of degree 3 if not. Without velocities, positions
    are joined by a smooth cubic spline that begins and ends at rest. The torque is what
    that motion takes.

    Args:
        samples: The samples.
        robot: Whose motion they are.
        path: The file that they come from, if any, for messages.
        start: Positions where the motion begins if the first sample comes after time 0,
            as ROS allows, shape (n,).

    Returns:
        The trajectory, from time 0.

    Raises:
        ScenarioError: If the samples are not of this robot, or do not begin at 0.
    """
    columns = _columns(samples, robot, path)
    t, q, v = samples.t, samples.q[:, columns], samples.v[:, columns]
    a, u = samples.a[:, columns], samples.u[:, columns]
    if t[0] < 0.0 or (t[0] > 0.0 and start is None):
        raise ScenarioError(
            f"{_named(path)}: the time begins at {t[0]:g} s, expected 0", path, "time"
        )
    if t[0] > 0.0 and start is not None:
        t = np.concatenate([[0.0], t])
        q = np.vstack([start, q])
        # Nothing else is known there: velocities come from a spline.
        v, a, u = (np.full(q.shape, np.nan) for _ in range(3))
    if np.isnan(v).any():
        v = CubicSpline(t, q, bc_type="clamped")(t, 1)
        a = np.full(q.shape, np.nan)
    dynamics = RobotDynamics(robot)
    steps = None
    stepwise = _stepwise(t, q, v, a)
    if stepwise is not None:
        if stepwise[0].size > t.size:
            u = np.full(stepwise[1].shape, np.nan)
        t, q, v, steps = stepwise
    elif _is_smooth(t, v, a):
        steps = a
    if np.isnan(u).any():
        draft = Trajectory(robot.joint_names, t, q, v, 0.0 * q, steps)
        u = dynamics.inverse(q, v, draft(t).a)
    return Trajectory(robot.joint_names, t, q, v, u, steps, dynamics.inverse)


def checked_motion(
    motion: Trajectory | Samples, robot: Robot, start: Array
) -> Trajectory:
    """A motion of a robot that is to be judged; samples are joined to one.

    Args:
        motion: The motion, or samples of it.
        robot: Whose motion it is.
        start: Where samples begin that come after time 0, shape (n,) [rad or m].

    Raises:
        ProblemError: If the motion is one of other joints, or has no numbers.
        ScenarioError: If samples are.
    """
    if isinstance(motion, Samples):
        motion = recorded_motion(motion, robot, start=start)
    if motion.joint_names != robot.joint_names:
        raise ProblemError(
            f"the motion is one of {', '.join(motion.joint_names)}, expected "
            f"{', '.join(robot.joint_names)}",
            "trajectory",
        )
    if not all(np.all(np.isfinite(x)) for x in (motion.q, motion.u)):
        raise ProblemError("the motion has positions or torques that are no numbers")
    return motion


def _named(path: str | Path | None) -> str:
    return "the motion" if path is None else str(path)


def _columns(samples: Samples, robot: Robot, path: str | Path | None) -> list[int]:
    """Columns of the robot's joints."""
    names = list(samples.joint_names)
    lacking = [name for name in robot.joint_names if name not in names]
    known = (*robot.joint_names, *robot.locked_joints)
    if lacking or any(name not in known for name in names):
        raise ScenarioError(
            f"{_named(path)} holds a motion of {', '.join(names)}; the joints of "
            f"{robot.name!r} are {', '.join(robot.joint_names)}",
            path,
            "joint_names",
        )
    for name, position in robot.locked_joints.items():
        column = samples.q[:, names.index(name)] if name in names else position
        away = float(np.max(np.abs(column - position)))
        if away > APART:
            raise ScenarioError(
                f"{_named(path)}: joint {name} is up to {away:g} away from "
                f"{position:g}, where the robot has it locked",
                path,
                name,
            )
    return [names.index(name) for name in robot.joint_names]


def _stepwise(
    t: Array, q: Array, v: Array, a: Array
) -> tuple[Array, Array, Array, Array] | None:
    """Find the motion whose acceleration is that of the samples, with jumps.

    Where all joints jump at one instant between two samples, from the acceleration of
    the one to that of the other, that instant follows from the velocities.

    Returns:
        Times, positions and velocities with those instants, and the acceleration of
        every interval; None if the samples are not of such a motion.
    """
    if np.isnan(a).any():
        return None
    h, before, jump = np.diff(t), a[:-1], np.diff(a, axis=0)
    slack_v = EXACT_V * (1.0 + np.abs(v).max()) + NANOSECOND * np.abs(a).max()
    slack_q = EXACT_Q * (1.0 + np.abs(q).max()) + NANOSECOND * np.abs(v).max()
    gap = np.diff(v, axis=0) - h[:, None] * before
    jumps = np.any(np.abs(gap) > slack_v, axis=1)
    # Time from the jump to the next sample.
    rest = np.zeros(h.size)
    size = np.sum(jump[jumps] ** 2, axis=1)
    if np.any(size == 0.0):
        return None
    rest[jumps] = np.clip(
        np.sum(gap[jumps] * jump[jumps], axis=1) / size, 0.0, h[jumps]
    )
    gap_q = np.diff(q, axis=0) - h[:, None] * (v[:-1] + 0.5 * h[:, None] * before)
    missed = np.abs(gap - rest[:, None] * jump) > slack_v
    missed_q = np.abs(gap_q - 0.5 * rest[:, None] ** 2 * jump) > slack_q
    if np.any(missed) or np.any(missed_q):
        return None
    at = np.flatnonzero(jumps)
    s = (h[at] - rest[at])[:, None]
    times = np.insert(t, at + 1, t[at] + s[:, 0])
    if np.any(np.diff(times) <= 0.0):
        return None
    return (
        times,
        np.insert(q, at + 1, q[at] + s * (v[at] + 0.5 * s * a[at]), axis=0),
        np.insert(v, at + 1, v[at] + s * a[at], axis=0),
        np.insert(a, at + 1, a[at + 1], axis=0)[:-1],
    )


def _is_smooth(t: Array, v: Array, a: Array) -> bool:
    """Whether accelerations are known and do not jump."""
    if np.isnan(a).any():
        return False
    h = np.diff(t)[:, None]
    gaps = np.abs(np.diff(v, axis=0) / h - 0.5 * (a[:-1] + a[1:]))
    return bool(np.all(gaps <= SMOOTH * np.abs(a).max()))
