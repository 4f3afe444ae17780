"""Trajectories of a robot from samples of any origin.

The motion between samples depends on the reader of the samples. A controller follows a
rule: straight lines between positions, cubics if there are velocities, polynomials of
degree 5 if there are also accelerations; messages for a controller are joined by this
rule. A table in CSV or NPZ is a record of a motion, and the motion from which it was
sampled is recovered.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from tominpmp.arrays import Array, BoolArray
from tominpmp.checks import TINY, instance
from tominpmp.description.fields import Field
from tominpmp.description.joint_table import example_values
from tominpmp.dynamics import STANDSTILL, RobotDynamics, torques_of
from tominpmp.exceptions import ProblemError, ScenarioError
from tominpmp.kinematics import units_of
from tominpmp.motion.samples import Interpolation, Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.robot.robot import Robot

if TYPE_CHECKING:
    from tominpmp.problem.problem import Problem

# Tolerance of the position of a locked joint in a recorded motion [rad or m].
APART = 1e-3
# Deviation of a mean acceleration between two samples from the mean of the samples,
# relative to the largest acceleration, up to which accelerations are continuous.
SMOOTH = 0.02
# Relative excess of accelerations between samples over the largest accelerations of
# samples and cubics, from which on polynomials of degree 5 overshoot.
OVERSHOOT = 0.1
# Tolerance for equality of accelerations and torques, as a share of the largest.
SAME = 1e-6
# Tolerance for equality of times, as a share of T.
SAME_INSTANT = 1e-12
# Description of each interpolation in reports.
MANNERS = {
    "steps": "accelerations that jump, as recorded",
    "linear": "straight lines between positions, as a controller joins them",
    "cubic": "cubics through positions and velocities",
    "quintic": "polynomials of degree 5 through positions, velocities, accelerations",
    "held": "cubics through positions and velocities, torques held as recorded",
    "instant": "no interpolation, as there is a single point",
    "spline": "a smooth spline through positions, at rest at both ends",
}


class Joined(NamedTuple):
    """A motion joined from samples.

    Attributes:
        trajectory: The motion.
        manner: The interpolation, a key of MANNERS.
        note: Clause on a consequence for the motion; empty if there is no consequence.
    """

    trajectory: Trajectory
    manner: str
    note: str = ""

    def __str__(self) -> str:
        """The interpolation, in words."""
        return MANNERS[self.manner] + (f"; {self.note}" if self.note else "")


def join(
    samples: Samples,
    robot: Robot,
    path: str | Path | None = None,
    start: tuple[Array, Array] | None = None,
) -> Joined:
    """Make a trajectory of a robot from samples.

    Columns are assigned by the names of their joints. Torques follow from the inverse
    dynamics of the motion. With "auto", a motion with constant accelerations and at
    most one jump between two samples is recovered exactly. Other samples are joined by
    polynomials: of degree 5 if they have accelerations that do not jump, of degree 3
    otherwise. Without velocities, positions are joined by a smooth cubic spline that
    begins and ends at rest.

    Args:
        samples: The samples.
        robot: The robot that moves.
        path: File from which the samples were read, if any, for messages.
        start: Positions [rad or m] and velocities [rad/s or m/s] at time 0, shape (n,)
            each, if the first sample comes later, as ROS allows.

    Returns:
        The trajectory, from time 0, and its interpolation.

    Raises:
        ScenarioError: If the samples are not of this robot, have no rows, positions
            that are not finite or times that do not increase, do not begin at 0, or
            lack the derivatives that the interpolation needs.
    """
    chosen = samples.interpolation
    file = Field(None, Path("the motion" if path is None else path))
    columns = _columns(samples, robot, file)
    parts = (samples.q, samples.v, samples.a, samples.u)
    rows = _Rows(robot, samples.t, *(part[:, columns] for part in parts))
    valid = np.all(np.isfinite(np.column_stack([rows.t, samples.q])), axis=1)
    valid[1:] &= rows.t[1:] > rows.t[:-1]
    row = int(np.argmin(np.append(valid, False)))
    if row < max(valid.size, 1):
        file.fail(
            f"row {row + 1}: expected finite positions, and a time [s] after the time "
            "of the row before"
        )
    if samples.segment_ends is not None:
        # With a payload on each segment, torques differ from the torques of the bare
        # robot; they are computed later, from the movement.
        rows = rows._replace(u=np.full_like(rows.q, np.nan))
    if rows.t[0] >= TINY and start is not None:
        rows = _from_start(rows, *start)
    elif rows.t[0] != 0.0:
        file.get("time").fail(f"begins at {rows.t[0]:g} s, expected 0")
    if rows.t.size == 1:
        # Derivatives that the row lacks are zero.
        v, a = (np.where(np.isnan(part), 0.0, part) for part in (rows.v, rows.a))
        joined = rows._replace(v=v).recorded("instant", a)
    elif chosen == "auto":
        joined = _recovered(rows)
    else:
        manner = _by_rule(chosen, rows, file)
        if manner == "linear":
            joined = _by_lines(rows, None if start is None else start[1])
        else:
            steps = rows.a if manner == "quintic" else None
            joined = Joined(rows.motion(rows.v, steps), manner)
    if samples.segment_ends is None:
        return joined
    return joined._replace(trajectory=_ended(joined.trajectory, samples.segment_ends))


def _ended(motion: Trajectory, ends: Array) -> Trajectory:
    """A motion with the end times of its segments, moved to the next nodes."""
    nodes = np.searchsorted(motion.t, ends - SAME_INSTANT * motion.duration)
    nodes = np.minimum(nodes, motion.t.size - 1)
    nodes[-1] = motion.t.size - 1
    if np.any((np.diff(nodes) == 0) & (np.diff(ends) > 0.0)):
        return motion  # segments shorter than the time between rows
    return replace(motion, segment_ends=motion.t[nodes])


class _Rows(NamedTuple):
    """Samples in the joint order of a robot; unknown values are NaN."""

    robot: Robot
    t: Array
    q: Array
    v: Array
    a: Array
    u: Array

    def known(self, key: str) -> bool:
        """Whether all values of a quantity are known: "v", "a" or "u"."""
        return not np.isnan(getattr(self, key)).any()

    def curve(self, a: Array | None = None) -> Trajectory:
        """The movement through positions and velocities, without torques."""
        return Trajectory(
            self.robot.joint_names, self.t, self.q, self.v, 0.0 * self.q, a
        )

    def motion(self, v: Array, a: Array | None) -> Trajectory:
        """The motion with velocities and accelerations, and its inverse dynamics."""
        draft = self._replace(v=v).curve(a)
        return draft.with_torques(torques_of(self.robot))

    def recorded(self, manner: str, a: Array | None = None) -> Joined:
        """The motion with accelerations, and with the recorded torques if known."""
        motion = self.motion(self.v, a)
        return Joined(replace(motion, u=self.u) if self.known("u") else motion, manner)


def _from_start(rows: _Rows, q: Array, v: Array) -> _Rows:
    """Rows with an additional row at time 0, with zero acceleration."""
    first = (q, v, 0.0 * q, np.nan * q)
    parts = [np.vstack([row, part]) for row, part in zip(first, rows[2:], strict=True)]
    return _Rows(rows.robot, np.concatenate([[0.0], rows.t]), *parts)


def _by_rule(chosen: Interpolation, rows: _Rows, file: Field) -> str:
    """Interpolation by the rule of a controller, after a check of the derivatives."""
    manner: str = chosen
    if chosen == "controller":
        manner = "cubic" if rows.known("v") else "linear"
        if rows.known("a"):
            manner = "quintic"  # missing velocities are reported below
    names = {"v": "velocities", "a": "accelerations"}
    for key in {"linear": "", "cubic": "v", "quintic": "va"}[manner]:
        if not rows.known(key):
            fault = f"are missing, which the interpolation {manner} needs"
            file.get(names[key]).fail(fault)
    return manner


def _by_lines(rows: _Rows, velocity: Array | None) -> Joined:
    """Motion along straight lines, whose velocity jumps at samples and at both ends."""
    robot, t = rows.robot, rows.t
    slopes = np.diff(rows.q, axis=0) / np.diff(t)[:, None]
    motion = rows.motion(np.vstack([slopes, slopes[-1:]]), np.zeros_like(slopes))
    before = np.zeros(robot.n) if velocity is None else velocity
    jumps = np.abs(np.diff(np.vstack([before, slopes]), axis=0))
    k, joint = np.unravel_index(int(np.argmax(jumps)), jumps.shape)
    unit = units_of(robot)[int(joint)]
    note = (
        f"velocities jump, by {jumps[k, joint]:.3g} {unit}/s of joint "
        f"{robot.joint_names[int(joint)]} at {t[k]:.4g} s: the points need velocities"
    )
    return Joined(motion, "linear", note if jumps[k, joint] > 0.0 else "")


def _recovered(rows: _Rows) -> Joined:
    """The motion from which rows were sampled, as far as they determine it."""
    if not rows.known("v"):
        v = CubicSpline(rows.t, rows.q, bc_type="clamped")(rows.t, 1)
        return rows._replace(v=v).recorded("spline")
    if not rows.known("a"):
        return rows.recorded("cubic")
    stepwise = _stepwise_motion(rows)
    if stepwise is not None:
        nodes, steps = stepwise
        return nodes.recorded("steps", steps)
    cubics = _on_cubics(rows)
    if cubics and _holds_torques(rows):
        return Joined(replace(rows.curve(), u=rows.u), "held")
    # The mean acceleration of a cubic is the mean of the accelerations at its ends: a
    # jump at the next sample, whose row has the acceleration just after it, changes the
    # mean of both rows by half of its height.
    jumps = cubics and not _continues(rows, 0.5 * JUMP)
    if not jumps and (_continues(rows, SMOOTH) or not _overshoots(rows)):
        return rows.recorded("quintic", rows.a)
    return rows.recorded("cubic")


def checked_motion(motion: Trajectory | Samples, problem: Problem) -> Trajectory:
    """Check a caller's motion; samples are joined into a motion.

    Args:
        motion: The motion, or samples of it, which may begin after time 0.
        problem: The problem, with the robot that moves and its state at time 0.

    Raises:
        ProblemError: If the motion has other joints than the robot, or values that are
            not finite, or is neither a trajectory nor samples.
        ScenarioError: As raised by :func:`join`.
    """
    robot, start = problem.robot, (problem.q_start, problem.v_start)
    if isinstance(motion, Samples):
        try:
            motion = join(motion, robot, start=start).trajectory
        except ScenarioError as error:
            error.path = None  # the samples may not be from a file
            raise
    instance(motion, Trajectory, "trajectory", "a Trajectory or Samples")
    motion._check_joints(robot.joint_names)
    if robot.kinematic or np.all(np.isnan(motion.u)):
        # Accelerations take the place of torques for a kinematic robot; torques that a
        # motion planned without dynamics lacks follow from the dynamics of the robot.
        motion = motion.with_torques(RobotDynamics(robot).inverse)
    if not all(np.all(np.isfinite(x)) for x in (motion.q, motion.v, motion.u)):
        raise ProblemError("the motion has values that are not finite numbers")
    return motion


def _columns(samples: Samples, robot: Robot, file: Field) -> list[int]:
    """Columns of the robot's joints, after a check of the names and locked joints."""
    names = list(samples.joint_names)
    known = {*robot.joint_names, *robot.locked_joints}
    if not set(robot.joint_names) <= set(names) <= known:
        held = example_values([name for name in robot.joint_names if name not in names])
        hint = f"; give locked_joints={held} if they are held"
        file.get("joint_names").fail(
            f"are {', '.join(names)}; the joints of {robot.name!r} are "
            f"{', '.join(robot.joint_names)}{hint if known.issuperset(names) else ''}"
        )
    for name, position in robot.locked_joints.items():
        column = samples.q[:, names.index(name)] if name in names else position
        distance = float(np.max(np.abs(column - position), initial=0.0))
        if distance > APART:
            file.get(name).fail(
                f"is up to {distance:g} away from {position:g}, at which the joint is "
                "locked in the robot"
            )
    return [names.index(name) for name in robot.joint_names]


def _on_cubics(rows: _Rows) -> bool:
    """Whether samples have the accelerations of the cubics that begin at them."""
    error = rows.curve()(rows.t[:-1]).a - rows.a[:-1]
    return bool(np.all(np.abs(error) <= SAME * np.abs(rows.a).max()))


def _holds_torques(rows: _Rows) -> bool:
    """Whether samples on cubics are nodes of a motion with piecewise-constant torques.

    The torques of such a motion are not the inverse dynamics of the cubics: the motion
    was integrated from the torques. At a joint at rest, dry friction may have any value
    up to its limit.
    """
    robot, _, q, v, a, u = rows
    if robot.kinematic or not rows.known("u"):
        return False
    residual = u - RobotDynamics(robot, dry=False).inverse(q, v, a)
    friction = robot.friction
    static = np.clip(residual, -friction, friction)
    dry = np.where(np.abs(v) > STANDSTILL, friction * np.sign(v), static)
    return bool(np.any(np.abs(residual - dry) > SAME * np.abs(u).max()))


def _overshoots(rows: _Rows) -> bool:
    """Whether polynomials of degree 5 accelerate much more than samples and cubics."""
    t, a = rows.t, rows.a
    between = (t[:-1, None] + np.diff(t)[:, None] * np.linspace(0, 1, 9)[1:-1]).ravel()
    cubic = np.abs(rows.curve()(between).a).max(axis=0)
    largest = np.maximum(cubic, np.abs(a).max(axis=0))
    quintic = np.abs(rows.curve(a)(between).a).max(axis=0)
    return bool(np.any(quintic > (1.0 + OVERSHOOT) * largest))


def _continues(rows: _Rows, tolerance: float) -> bool:
    """Whether accelerations are continuous, as far as the samples show.

    Args:
        rows: The samples.
        tolerance: Deviation of a mean acceleration between two samples from the mean of
            the samples, relative to the largest acceleration.
    """
    h, a = np.diff(rows.t)[:, None], rows.a
    gaps = np.abs(np.diff(rows.v, axis=0) / h - 0.5 * (a[:-1] + a[1:]))
    return bool(np.all(gaps <= tolerance * np.abs(a).max()))


# Deviations up to which positions and velocities are integrals of the accelerations,
# relative to the largest values: more than rounding, as jumps may come in pairs.
EXACT_Q, EXACT_V = 1e-8, 1e-6
# Resolution of the times of ROS messages [s].
NANOSECOND = 1e-9
# Distance of successive jumps from the middles of their intervals, as a share of the
# interval, up to which they indicate a sampled ramp.
MIDDLE = 0.01
# Least jump of accelerations at a node, as a share of the largest acceleration.
JUMP = 0.02


def _stepwise_motion(rows: _Rows) -> tuple[_Rows, Array] | None:
    """Find the motion with the accelerations of the samples, constant between jumps.

    If the accelerations of all joints jump at one instant between two samples, from the
    values of the first sample to the values of the second, the instant follows from the
    velocities.

    Returns:
        The rows with additional rows at the jumps, whose torques are unknown, and the
        acceleration of every interval; None if the samples do not belong to a motion
        with piecewise-constant accelerations.
    """
    _, t, q, v, a, u = rows
    h, before, jump = np.diff(t), a[:-1], np.diff(a, axis=0)
    slack_v = EXACT_V * (1.0 + np.abs(v).max()) + NANOSECOND * np.abs(a).max()
    slack_q = EXACT_Q * (1.0 + np.abs(q).max()) + NANOSECOND * np.abs(v).max()
    gap = np.diff(v, axis=0) - h[:, None] * before
    jumps = np.any(np.abs(gap) > slack_v, axis=1)
    # Time from the jump to the next sample.
    remaining = np.zeros(h.size)
    size = np.sum(jump[jumps] ** 2, axis=1)
    if np.any(size == 0.0):
        return None
    remaining[jumps] = np.clip(
        np.sum(gap[jumps] * jump[jumps], axis=1) / size, 0.0, h[jumps]
    )
    gap_q = np.diff(q, axis=0) - h[:, None] * (v[:-1] + 0.5 * h[:, None] * before)
    # Errors of rounding cancel each other in the sum, those of a sampled ramp add up.
    missed = np.cumsum(gap - remaining[:, None] * jump, axis=0) / slack_v
    missed_q = (gap_q - 0.5 * remaining[:, None] ** 2 * jump) / slack_q
    if _ramps(h, jumps, remaining) or not np.abs([missed, missed_q]).max() <= 1.0:
        return None
    at = np.flatnonzero(jumps)
    s = (h[at] - remaining[at])[:, None]
    times = np.insert(t, at + 1, t[at] + s[:, 0])
    if np.any(np.diff(times) <= 0.0):
        return None
    nodes = rows._replace(
        t=times,
        q=np.insert(q, at + 1, q[at] + s * (v[at] + 0.5 * s * a[at]), axis=0),
        v=np.insert(v, at + 1, v[at] + s * a[at], axis=0),
        u=np.insert(u, at + 1, np.nan, axis=0),
    )
    return nodes, np.insert(a, at + 1, a[at + 1], axis=0)[:-1]


def _ramps(h: Array, jumps: BoolArray, remaining: Array) -> bool:
    """Whether apparent jumps of accelerations come from sampled ramps.

    Velocities are the same whether an acceleration rises evenly from one sample to the
    next or jumps halfway; positions are nearly the same, but their differences add up.

    Args:
        h: Lengths of the intervals between samples [s], shape (m,).
        jumps: Whether accelerations jump in each interval, shape (m,).
        remaining: Time from the jump to the end of the interval [s], shape (m,).
    """
    halfway = jumps & (np.abs(remaining - 0.5 * h) <= MIDDLE * h)
    after = np.append(halfway[:-1] & halfway[1:], False)
    successive = after | np.insert(after[:-1], 0, False)
    return bool(2 * np.sum(successive) > np.sum(jumps))
