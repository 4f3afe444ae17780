"""Motions from samples as trajectories of a robot, of any origin.

The motion between samples depends on their reader. A controller follows a rule:
straight lines between positions, cubics where there are velocities, polynomials of
degree 5 where there are accelerations too; messages for a controller are joined by this
rule. A table in CSV or NPZ is a record of a motion, and the motion that it was sampled
from is recovered.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from tominpmp.arrays import Array, BoolArray
from tominpmp.checks import instance
from tominpmp.dynamics import STANDSTILL, RobotDynamics, torques_of
from tominpmp.exceptions import ProblemError, ScenarioError
from tominpmp.kinematics import prismatic_joints
from tominpmp.motion.samples import Interpolation, Samples, check_interpolation
from tominpmp.motion.trajectory import Trajectory
from tominpmp.robot.robot import Robot

# Tolerance of the position of a locked joint in a recorded motion [rad or m].
APART = 1e-3
# Deviation of a change of velocity from the mean of the accelerations before and after,
# relative to the largest one, up to which accelerations count as continuous.
SMOOTH = 0.02
# Relative excess of accelerations between samples over the largest ones of samples and
# cubics, from which on polynomials of degree 5 overshoot.
OVERSHOOT = 0.1
# Tolerance of equal accelerations and torques, as a share of the largest ones.
SAME = 1e-6
# Tolerance of equal times, as a share of T.
SAME_INSTANT = 1e-12
# Name of each interpolation in reports.
MANNERS = {
    "steps": "accelerations that jump, as recorded",
    "linear": "straight lines between positions, as a controller joins them",
    "cubic": "cubics through positions and velocities",
    "quintic": "polynomials of degree 5 through positions, velocities, accelerations",
    "held": "cubics through positions and velocities, torques held as recorded",
    "instant": "nothing, as there is a single point",
    "spline": "a smooth spline through positions, at rest at both ends",
}


class Joined(NamedTuple):
    """A motion joined from samples.

    Attributes:
        trajectory: The motion.
        manner: The interpolation, a key of MANNERS.
        note: A consequence for the motion, in a clause; empty without one.
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
    *,
    start: Array | None = None,
    start_velocity: Array | None = None,
    interpolation: Interpolation | None = None,
) -> Joined:
    """Make a trajectory of a robot from samples.

    Columns are found by the names of their joints. Torques follow from the inverse
    dynamics of the motion. With "auto", if the samples are those of a motion whose
    acceleration is constant with at most one jump between two samples, this motion is
    recovered. Else they are joined by polynomials, of degree 5 if they have
    accelerations that do not jump, of degree 3 if not. Without velocities, positions
    are joined by a smooth cubic spline that begins and ends at rest.

    Args:
        samples: The samples.
        robot: The robot that moves.
        path: The file that they come from, if any, for messages.
        start: Positions at time 0 if the first sample comes after it, as ROS allows,
            shape (n,).
        start_velocity: Velocities at time 0, shape (n,); None for rest.
        interpolation: The interpolation; None for that of the samples.

    Returns:
        The trajectory, from time 0, and its interpolation.

    Raises:
        ProblemError: If the interpolation is unknown.
        ScenarioError: If the samples are not of this robot, do not begin at 0, or lack
            the derivatives that the interpolation needs.
    """
    chosen = samples.interpolation if interpolation is None else interpolation
    check_interpolation(chosen)
    columns = _columns(samples, robot, path)
    parts = (samples.q, samples.v, samples.a, samples.u)
    rows = _Rows(robot, samples.t, *(part[:, columns] for part in parts))
    if samples.segment_ends is not None:
        # With a load on each segment, torques differ from those of the bare robot; they
        # are computed once the movement is known.
        rows = rows._replace(u=np.full_like(rows.q, np.nan))
    if rows.t[0] > 0.0 and start is not None:
        rows = _from_start(rows, start, start_velocity)
    elif rows.t[0] != 0.0:
        raise ScenarioError(
            f"{_named(path)}: the time begins at {rows.t[0]:g} s, expected 0",
            path,
            "time",
        )
    if rows.t.size == 1:
        joined = _instant(rows)
    elif chosen == "auto":
        joined = _as_recorded(rows)
    else:
        manner = _by_rule(chosen, rows, path)
        if manner == "linear":
            joined = _straight(rows, start_velocity)
        else:
            steps = rows.a if manner == "quintic" else None
            joined = Joined(rows.motion(rows.v, steps), manner)
    if samples.segment_ends is None:
        return joined
    return joined._replace(trajectory=_ended(joined.trajectory, samples.segment_ends))


def _instant(rows: _Rows) -> Joined:
    """A motion that takes no time; derivatives missing in its single row are zero."""
    v, a = (np.where(np.isnan(part), 0.0, part) for part in (rows.v, rows.a))
    return rows._replace(v=v).recorded("instant", a)


def _ended(motion: Trajectory, ends: Array) -> Trajectory:
    """A motion with the times at which its segments end, each at a node at least."""
    places = np.searchsorted(motion.t, ends - SAME_INSTANT * motion.duration)
    places = np.minimum(places, motion.t.size - 1)
    places[-1] = motion.t.size - 1
    if np.any((np.diff(places) == 0) & (np.diff(ends) > 0.0)):
        return motion  # segments shorter than the time between rows
    return replace(motion, segment_ends=motion.t[places])


class _Rows(NamedTuple):
    """Samples of the joints of a robot, in its order; unknown values are NaN."""

    robot: Robot
    t: Array
    q: Array
    v: Array
    a: Array
    u: Array

    def known(self, key: str) -> bool:
        return not np.isnan(getattr(self, key)).any()

    def curve(self, a: Array | None = None) -> Trajectory:
        """The movement through positions and velocities, without torques."""
        return Trajectory(
            self.robot.joint_names, self.t, self.q, self.v, 0.0 * self.q, a
        )

    def motion(self, v: Array, a: Array | None) -> Trajectory:
        """The motion with given velocities and accelerations, and its torques."""
        draft = self._replace(v=v).curve(a)
        return draft.with_torques(torques_of(self.robot))

    def recorded(self, manner: str, a: Array | None = None) -> Joined:
        """The motion with given accelerations, and its own torques where known."""
        if not self.known("u"):
            return Joined(self.motion(self.v, a), manner)
        inverse = torques_of(self.robot)
        motion = replace(self.curve(a), u=self.u, inverse_dynamics=inverse)
        return Joined(motion, manner)


def _from_start(rows: _Rows, start: Array, velocity: Array | None) -> _Rows:
    """Rows that begin at time 0: at rest unless a velocity is given."""
    rest = np.zeros(len(start))
    first = (start, rest if velocity is None else velocity, rest, rest * np.nan)
    parts = [np.vstack([row, part]) for row, part in zip(first, rows[2:], strict=True)]
    return _Rows(rows.robot, np.concatenate([[0.0], rows.t]), *parts)


def _by_rule(chosen: Interpolation, rows: _Rows, path: str | Path | None) -> str:
    """Interpolation of the rows by a rule, after a check that they suffice for it."""
    manner: str = chosen
    if chosen == "controller":
        manner = "cubic" if rows.known("v") else "linear"
        if rows.known("a"):
            manner = "quintic"  # velocities that it lacks are reported below
    needed = {"linear": "", "cubic": "v", "quintic": "va"}[manner]
    names = {"v": "velocities", "a": "accelerations"}
    for key in needed:
        if not rows.known(key):
            raise ScenarioError(
                f"{_named(path)} lacks {names[key]}, which the interpolation {manner} "
                "needs",
                path,
                names[key],
            )
    return manner


def _straight(rows: _Rows, velocity: Array | None) -> Joined:
    """Straight lines: the velocity jumps at all samples, and at both ends."""
    robot, t = rows.robot, rows.t
    slopes = np.diff(rows.q, axis=0) / np.diff(t)[:, None]
    motion = rows.motion(np.vstack([slopes, slopes[-1:]]), np.zeros_like(slopes))
    before = np.zeros(robot.n) if velocity is None else velocity
    jumps = np.abs(np.diff(np.vstack([before, slopes]), axis=0))
    k, joint = np.unravel_index(int(np.argmax(jumps)), jumps.shape)
    unit = "m/s" if prismatic_joints(robot)[joint] else "rad/s"
    note = (
        f"velocities jump, by {jumps[k, joint]:.3g} {unit} of joint "
        f"{robot.joint_names[int(joint)]} at {t[k]:.4g} s: the points need velocities"
    )
    return Joined(motion, "linear", note if jumps[k, joint] > 0.0 else "")


def _as_recorded(rows: _Rows) -> Joined:
    """The motion that rows were sampled from, as far as they determine it."""
    if not rows.known("v"):
        v = CubicSpline(rows.t, rows.q, bc_type="clamped")(rows.t, 1)
        return rows._replace(v=v).recorded("spline")
    if not rows.known("a"):
        return rows.recorded("cubic")
    stepwise = _stepwise_motion(rows)
    if stepwise is not None:
        found, steps = stepwise
        return found.recorded("steps", steps)
    if _holds_torques(rows):
        return Joined(replace(rows.curve(), u=rows.u), "held")
    if not _cubics_that_jump(rows) and (_is_smooth(rows) or not _overshoots(rows)):
        return rows.recorded("quintic", rows.a)
    return rows.recorded("cubic")


def checked_motion(
    motion: Trajectory | Samples,
    robot: Robot,
    start: Array,
    start_velocity: Array | None = None,
) -> Trajectory:
    """A motion of a robot, checked; samples are joined to a motion.

    Args:
        motion: The motion, or samples of it.
        robot: The robot that moves.
        start: Positions at time 0 of samples that begin later, shape (n,) [rad or m].
        start_velocity: Velocities at time 0, shape (n,) [rad/s or m/s]; None for rest.

    Raises:
        ProblemError: If the motion has other joints, or values that are not finite.
        ScenarioError: If the samples have other joints.
    """
    if isinstance(motion, Samples):
        joined = join(motion, robot, start=start, start_velocity=start_velocity)
        motion = joined.trajectory
    instance(motion, Trajectory, "trajectory", "a Trajectory or Samples")
    if motion.joint_names != robot.joint_names:
        raise ProblemError(
            f"the motion is one of {', '.join(motion.joint_names)}, expected one "
            f"of {', '.join(robot.joint_names)}",
            "trajectory",
        )
    motion = controlled(motion, robot)
    if not all(np.all(np.isfinite(x)) for x in (motion.q, motion.v, motion.u)):
        raise ProblemError("the motion has values that are no numbers")
    return motion


def controlled(motion: Trajectory, robot: Robot) -> Trajectory:
    """A motion with what drives it.

    Accelerations are the torques of a kinematic robot; those that a motion planned
    without dynamics lacks follow from the robot's.
    """
    if not robot.kinematic and not np.all(np.isnan(motion.u)):
        return motion
    return motion.with_torques(RobotDynamics(robot).inverse)


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


def _holds_torques(rows: _Rows) -> bool:
    """Whether the samples are the nodes of a motion whose torques are held.

    Its accelerations are those of the cubics through the nodes, and its torques are not
    the inverse dynamics of these cubics: the motion was integrated from its torques.
    Where a joint stands, dry friction may have any value up to its limit.
    """
    robot, t, q, v, a, u = rows
    if robot.kinematic or not rows.known("u"):
        return False
    if np.any(np.abs(rows.curve()(t).a - a) > SAME * np.abs(a).max()):
        return False
    rest = u - RobotDynamics(robot, dry=False).inverse(q, v, a)
    friction = robot.friction
    standing = np.clip(rest, -friction, friction)
    dry = np.where(np.abs(v) > STANDSTILL, friction * np.sign(v), standing)
    return bool(np.any(np.abs(rest - dry) > SAME * np.abs(u).max()))


def _overshoots(rows: _Rows) -> bool:
    """Whether polynomials of degree 5 accelerate far beyond the samples."""
    t, a = rows.t, rows.a
    between = (t[:-1, None] + np.diff(t)[:, None] * np.linspace(0, 1, 9)[1:-1]).ravel()
    cubic = np.abs(rows.curve()(between).a).max(axis=0)
    largest = np.maximum(cubic, np.abs(a).max(axis=0))
    found = np.abs(rows.curve(a)(between).a).max(axis=0)
    return bool(np.any(found > (1.0 + OVERSHOOT) * largest))


def _is_smooth(rows: _Rows) -> bool:
    """Whether accelerations do not jump."""
    h, a = np.diff(rows.t)[:, None], rows.a
    gaps = np.abs(np.diff(rows.v, axis=0) / h - 0.5 * (a[:-1] + a[1:]))
    return bool(np.all(gaps <= SMOOTH * np.abs(a).max()))


# Deviations up to which positions and velocities are integrals of the accelerations,
# relative to the largest ones: more than rounding, as jumps may come in pairs.
EXACT_Q, EXACT_V = 1e-8, 1e-6
# Times of ROS messages are rounded to this [s].
NANOSECOND = 1e-9
# Successive jumps this close to the middle of their intervals, in shares of these,
# indicate a sampled ramp.
MIDDLE = 0.01
# Largest deviation of accelerations from those of cubics, and least jump of
# accelerations at a node, as shares of the largest acceleration.
CUBIC, JUMP = 1e-6, 0.02


def _stepwise_motion(rows: _Rows) -> tuple[_Rows, Array] | None:
    """Find the motion with the accelerations of the samples, constant between jumps.

    Where all joints jump at one instant between two samples, from the acceleration of
    the first sample to that of the second, that instant follows from the velocities.

    Returns:
        The rows and these instants, with unknown torques there, and the acceleration of
        every interval; None if the samples are not of a motion with constant
        accelerations.
    """
    _, t, q, v, a, u = rows
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
    if _ramps(h, jumps, rest):
        return None
    missed = np.abs(gap - rest[:, None] * jump) > slack_v
    missed_q = np.abs(gap_q - 0.5 * rest[:, None] ** 2 * jump) > slack_q
    if np.any(missed) or np.any(missed_q):
        return None
    at = np.flatnonzero(jumps)
    s = (h[at] - rest[at])[:, None]
    times = np.insert(t, at + 1, t[at] + s[:, 0])
    if np.any(np.diff(times) <= 0.0):
        return None
    found = rows._replace(
        t=times,
        q=np.insert(q, at + 1, q[at] + s * (v[at] + 0.5 * s * a[at]), axis=0),
        v=np.insert(v, at + 1, v[at] + s * a[at], axis=0),
        u=np.insert(u, at + 1, np.nan, axis=0),
    )
    return found, np.insert(a, at + 1, a[at + 1], axis=0)[:-1]


def _ramps(h: Array, jumps: BoolArray, rest: Array) -> bool:
    """Whether apparent jumps of accelerations come from sampled ramps.

    Velocities are the same whether an acceleration rises evenly from one sample to the
    next or jumps halfway; positions nearly so, but their differences add up.

    Args:
        h: Lengths of the intervals between samples [s], shape (m,).
        jumps: Whether accelerations jump in each interval, shape (m,).
        rest: Time from the jump to the end of the interval [s], shape (m,).
    """
    halfway = jumps & (np.abs(rest - 0.5 * h) <= MIDDLE * h)
    after = np.append(halfway[:-1] & halfway[1:], False)
    row = after | np.insert(after[:-1], 0, False)
    return bool(2 * np.sum(row) > np.sum(jumps))


def _cubics_that_jump(rows: _Rows) -> bool:
    """Whether samples are nodes of cubics whose accelerations jump at some.

    A row has the acceleration just after its jump; polynomials of degree 5 would have
    to end with it.
    """
    a, largest = rows.a, np.abs(rows.a).max()
    begins = rows.curve()(rows.t[:-1]).a
    # The mean acceleration of a cubic is that of both of its ends.
    ends = 2.0 * np.diff(rows.v, axis=0) / np.diff(rows.t)[:, None] - begins
    if np.any(np.abs(begins - a[:-1]) > CUBIC * largest):
        return False
    return bool(np.any(np.abs(ends - a[1:]) > JUMP * largest))
