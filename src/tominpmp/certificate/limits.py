"""Limits of a motion as linear rows on its small changes, with their multipliers.

The rows linearise the same constraints as the programs that plan motions, at instants
of the certificate: joint limits at the nodes and at maxima between the nodes, torques
that are constant on intervals in the middles. Other constraints of a problem are
sampled finely in time, and have rows where they are nearest to their bounds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial, reduce
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.certificate.clearances import REGULAR, SAMPLES, nearest_instants
from tominpmp.certificate.motion import GridMotion
from tominpmp.constraints.base import Constraint, Partials, States
from tominpmp.constraints.final import Arrival, GoalReached
from tominpmp.constraints.joint_limits import JointLimit
from tominpmp.constraints.path import PathConstraint
from tominpmp.constraints.torque import MotorLimit, TorqueLimit
from tominpmp.motion.extrema import interior_maxima, local_maxima
from tominpmp.transcription.instants import Instants

# Kinds of rows that are not limits of the problem: the trust region of the linear
# program, and the goal.
TRUST = "trust region"
GOAL = "goal"
# Offset of the subjects of a segment: pairs, constraints and rows of goals are numbered
# within each segment.
SEGMENT = 1 << 20
# Kinds of rows of arrival times, and of the torques of joints without a motor.
ARRIVAL, PASSIVE = "arrival", "passive"
# Shares of the intervals at which limits of joints and motors are inspected.
SHARES = tuple((np.arange(11) / 10).tolist())
MIDDLE = len(SHARES) // 2
# A value has a row inside an interval if it exceeds the values at both ends of the
# interval by the first share of its limit, and is above the second share of the limit.
PEAK = 1e-3
NEAR = 0.97
# A position has a row inside an interval if its slack is below the first number [rad,
# or shares of the reach] and it turns back by more than the second; at nodes if its
# slack is below the third, the radius of the trust region.
SLACK, TURN, FAR = 0.05, 1e-5, 1.0
# Slack beyond which a constraint has no row, in units of its scale.
NEAR_CONSTRAINT = 0.1


@dataclass(frozen=True, eq=False)
class LimitRows:
    """Limits of a motion, one in each row.

    A single number is broadcast to all rows.

    Attributes:
        kind: "effort", "velocity", "clearance", ..., shape (m,).
        at: Instants of the rows.
        subject: Number of the joint of each row, or of the collision pair, constraint,
            component of the goal or segment; -1 for lengths, shape (m,). Pairs,
            constraints and components are numbered from SEGMENT times their segment.
        below: Lower limit minus value: negative for slack, minus infinity without a
            lower limit, positive where the motion violates the limit, shape (m,).
        above: Upper limit minus value: positive for slack, infinity without an upper
            limit, negative where the motion violates the limit, shape (m,).
        slopes: Derivatives with respect to the state at the instant, shape (m, 2 n);
            zero for slopes over time.
        change: Derivatives of the limited quantities with respect to the unknowns,
            shape (m, size); zero for the unknowns themselves, which are columns of the
            program.
        unit: Unit of each row in units of :attr:`slack`, for example the reach for
            clearances [m], shape (m,).
        of_state: Whether each row limits the state, so that the costate jumps at its
            instant; torques limit the control, shape (m,).
        component: Index of the value within its constraint, shape (m,).
        y: Multipliers, as shares of the duration, positive where the upper limit is
            active, shape (m,).
    """

    kind: NDArray[np.str_]
    at: Instants
    subject: IntArray
    below: Array
    above: Array
    slopes: Array
    change: sp.csr_matrix
    unit: Array = field(default_factory=partial(np.ones, ()))
    of_state: BoolArray = field(default_factory=lambda: np.array(True))
    component: IntArray = field(default_factory=lambda: np.array(-1))
    y: Array = field(default_factory=partial(np.zeros, ()))

    def __post_init__(self) -> None:
        """Broadcast single numbers to all rows."""
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                each = value.shape[-1:] if item.name == "slopes" else ()
                value = np.broadcast_to(value, (self.subject.size, *each))
                object.__setattr__(self, item.name, value)

    # -- slack and multipliers ---------------------------------------------------------

    @property
    def lower(self) -> Array:
        """Negative slack to the lower limit, zero where violated, shape (m,)."""
        return np.minimum(self.below, 0.0)

    @property
    def upper(self) -> Array:
        """Slack to the upper limit, zero where it is violated, shape (m,)."""
        return np.maximum(self.above, 0.0)

    @property
    def upper_active(self) -> BoolArray:
        """Whether the upper limit is active, shape (m,)."""
        return np.asarray(self.y > 0.0)

    @property
    def value(self) -> Array:
        """Gain by a unit of slack, as a share of the duration, >= 0, shape (m,)."""
        return np.asarray(np.abs(self.y) / self.unit)

    @property
    def slack(self) -> Array:
        """Slack to the active limit, >= 0, shape (m,).

        Its unit is a share of the limit for torques, velocities, accelerations and
        rates, rad or m for positions, m for clearances, s for arrivals, and the unit of
        the quantity for constraints.
        """
        return np.where(self.upper_active, self.upper, -self.lower) * self.unit

    @property
    def predicted_gain(self) -> Array:
        """Multiplier times slack, as a share of the duration, shape (m,)."""
        return self.value * self.slack

    @property
    def used(self) -> Array:
        """Used share of the active limit, shape (m,)."""
        slack = np.where(self.upper_active, self.above, -self.below)
        return np.asarray(1.0 - slack * self.unit)

    # -- subsets -----------------------------------------------------------------------

    def of(self, *kinds: str) -> BoolArray:
        """Whether the kind of each row is one of the kinds, shape (m,)."""
        return np.isin(self.kind, kinds)

    @property
    def limits(self) -> BoolArray:
        """Whether each row belongs to a limit of the problem, shape (m,)."""
        return ~self.of(TRUST, GOAL)

    def selected(self, rows: IntArray | BoolArray) -> LimitRows:
        """The rows of an index or a mask."""
        return LimitRows(*(getattr(self, item.name)[rows] for item in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[LimitRows]) -> LimitRows:
        """Concatenate rows."""

        def concatenated(items: list[Any]) -> Any:
            if isinstance(items[0], Instants):
                return reduce(Instants.joined, items)
            if isinstance(items[0], np.ndarray):
                return np.concatenate(items)
            return sp.vstack(items, format="csr")

        columns = ([getattr(part, item.name) for part in parts] for item in fields(cls))
        return cls(*(concatenated(column) for column in columns))


# -- from the constraints of a problem -------------------------------------------------


def limits_of(motion: GridMotion, near: bool = True) -> LimitRows:
    """Rows of all limits and goals, segment by segment.

    Args:
        motion: The motion.
        near: Whether distances have rows, for which meshes may have to be decomposed
            into convex pieces.
    """
    every = [*_arrivals(motion)]
    for number, part in enumerate(motion.segments):
        # Distances take time.
        for limit in replace(part.system, clearance_rows=None).constraints:
            if isinstance(limit, JointLimit | MotorLimit):
                every += (_slopes if limit.order > 2 else _of_joints)(part, limit)
        every += _held(part)
        numbered = [*(_clearances(part) if near else ()), _goal(part)]
        for index, item in enumerate(part.system.problem.ready_constraints):
            numbered.append(_of_constraint(part, item, index))
        # Subjects of these rows are numbered within a segment, not in the whole motion.
        shift = number * SEGMENT
        every += [replace(rows, subject=rows.subject + shift) for rows in numbered]
    return LimitRows.joined(every)


@dataclass(frozen=True, eq=False)
class SampledConstraint:
    """A constraint evaluated at m instants of a motion.

    Attributes:
        part: The motion on a segment.
        item: The constraint, with the directions of joints with dry friction.
        at: The instants; pairs of instants for slopes over time.
        states: The states at the instants.
        values: Values of the constraint, shape (m, p); for pairs of instants, shape
            (m / 2, p).
        lower: Lower bounds of the values, same shape.
        upper: Upper bounds of the values, same shape.
    """

    part: GridMotion
    item: Constraint
    at: Instants
    states: States
    values: Array
    lower: Array
    upper: Array

    @classmethod
    def of(cls, part: GridMotion, item: Constraint, at: Instants) -> SampledConstraint:
        """Evaluate a constraint at instants of a motion."""
        if isinstance(item, MotorLimit):
            item = item.along(part.ways(at))
        states = part.states(at)
        values = item.evaluate(states)
        return cls(part, item, at, states, values, *item.bounds(at.size))

    @property
    def excess(self) -> Array:
        """Excess of the values over their bounds, shape (m, p)."""
        return np.maximum(self.values - self.upper, self.lower - self.values)

    def rows(
        self,
        kind: str,
        subjects: IntArray,
        chosen: BoolArray | None = None,
        unit: float | Array = 1.0,
        *,
        equal: bool | BoolArray = False,
    ) -> LimitRows:
        """Rows of selected values.

        Args:
            kind: Kind of the rows.
            subjects: Joint, or number of the subject, of each value, shape (p,).
            chosen: Whether each value has a row, shape (m, p); None for all values.
            unit: Unit of the values, one number for all or shape (p,).
            equal: Whether values are equations, which have no slack, one flag for all
                or shape (p,).
        """
        chosen = np.ones(self.values.shape, dtype=bool) if chosen is None else chosen
        index, which = np.nonzero(chosen)
        value, count = self.values[index, which], self.item.count
        slack = ~np.broadcast_to(equal, count)[which]
        partials = self.item.differentiate(self.states, index, which)
        return _rows_of(
            self.part,
            kind,
            self.at,
            self.states,
            self._pinned(partials, index),
            subject=subjects[which],
            below=np.where(slack, self.lower[index, which] - value, 0.0),
            above=np.where(slack, self.upper[index, which] - value, 0.0),
            unit=np.broadcast_to(unit, count)[which],
            of_state=np.array(not isinstance(self.item, MotorLimit)),
            component=which,
        )

    def _pinned(self, partials: Partials, index: IntArray) -> Partials:
        """Derivatives of values at instants that are fixed in time, as in a window.

        Where changed lengths of intervals bring a state earlier, the motion continues
        until the fixed instant: the derivative by time is minus the rate of the value
        along the motion. Rates of accelerations are neglected.
        """
        if not isinstance(self.item, PathConstraint) or self.item.window is None:
            return partials
        rates, moved = np.zeros(index.size), (partials.by_q, partials.by_v)
        for by, speed in zip(moved, (self.states.v, self.states.a), strict=True):
            if by is not None:
                rates -= np.einsum("kj,kj->k", by, speed[index])
        return partials._replace(by_t=rates)


def _rows_of(
    part: GridMotion,
    kind: str,
    at: Instants,
    states: States,
    partials: Partials,
    **more: Any,
) -> LimitRows:
    """Rows of quantities that depend on the state at instants.

    Args:
        part: The motion on a segment.
        kind: Kind of the rows.
        at: The instants, to which the partial derivatives refer by index.
        states: The states at the instants.
        partials: Partial derivatives of the quantities.
        **more: Other attributes of the rows.
    """
    change = part.changes.pull_back(at, states, partials)
    zero = np.zeros((change.shape[0], part.changes.n))
    by_state = (partials.by_q, partials.by_v) if partials.row is None else (None, None)
    slopes = np.hstack([zero if by is None else by for by in by_state])
    # Values of pairs of instants are assigned to the first instant.
    at = at[partials.at[: len(slopes)]]
    return LimitRows(np.array(kind), at, slopes=slopes, change=change, **more)


# -- limits of joints ------------------------------------------------------------------


def _of_joints(part: GridMotion, item: JointLimit | MotorLimit) -> Iterator[LimitRows]:
    """Rows of joint or motor limits at nodes, and at maxima between them."""
    sampled = SampledConstraint.of(part, item, part.instants(*SHARES))
    shape = sampled.values.shape
    chosen = _kept(part, item, sampled.excess.reshape(-1, len(SHARES), item.count))
    unit = item.scale if isinstance(item, JointLimit) and item.order == 0 else 1.0
    if isinstance(item, TorqueLimit):
        if part.changes.profile == "torques":
            # Torques may have been merged into their mean over the interval.
            middles = sampled.values.reshape(chosen.shape)[:, MIDDLE]
            middles[:] = part.load
        # A joint without a motor has its equation of motion instead of a limit.
        passive = np.zeros(chosen.shape, dtype=bool)
        passive[:, MIDDLE] = ~part.system.driven[item.of_joints]
        chosen[:, :, ~part.system.driven[item.of_joints]] = False
        yield sampled.rows(PASSIVE, item.of_joints, passive.reshape(shape), equal=True)
    yield sampled.rows(item.kind.name, item.of_joints, chosen.reshape(shape), unit)


def _kept(part: GridMotion, item: JointLimit | MotorLimit, excess: Array) -> BoolArray:
    """Which values have rows, at the inspected instants of each interval.

    Args:
        part: The motion on a segment.
        item: The constraint.
        excess: Excesses of the values over their bounds, shape (N, SHARES, p).

    Returns:
        Shape (N, SHARES, p).
    """
    profile, of_torques = part.changes.profile, isinstance(item, TorqueLimit)
    if item.field == "q":
        chosen = interior_maxima(excess, -SLACK, TURN)
        chosen[:, -1] |= excess[:, -1] > -FAR
        return chosen
    if isinstance(item, JointLimit) and item.field == "v":
        chosen = interior_maxima(excess, NEAR - 1.0, PEAK)
        if profile == "ramps":
            # An acceleration that is raised at the beginning of an interval and lowered
            # at its end leaves the speeds at both ends unchanged, but not in between.
            chosen[:, MIDDLE] |= ~chosen.any(axis=1)
        chosen[:, -1] = True
        return chosen
    smooth = profile != "torques" and item.field != "a"
    chosen = interior_maxima(excess, NEAR - 1.0, PEAK) & smooth
    if of_torques:
        # The torque in the middle does not change like the mean of the ends.
        chosen[:, MIDDLE] = True
    if not of_torques or profile != "torques":
        chosen[:, 0] = chosen[-1, -1] = True
        # With ramps, the end of an interval equals the beginning of the next interval.
        chosen[:, -1] |= profile != "ramps"
    return chosen


def _slopes(part: GridMotion, item: JointLimit | MotorLimit) -> Iterator[LimitRows]:
    """Rows of rates of torques and of accelerations (jerks)."""
    first, end = part.span
    interval = np.arange(first, end - (part.changes.profile != "ramps"))
    sampled = SampledConstraint.of(part, item, part.changes.pairs(interval))
    yield sampled.rows(item.kind.name, item.of_joints)


# -- clearances and constraints of the problem -----------------------------------------


def _clearances(part: GridMotion) -> Iterator[LimitRows]:
    """Rows of clearances near zero, as shares of the reach."""
    item = part.system.clearance
    if item is not None:
        nearest = nearest_instants(part, item)
        at = Instants.at_times(nearest.times, part.changes.h)
        by_t = nearest.slopes[:, -1] if item.moving else None
        yield _rows_of(
            part,
            item.name,
            at,
            part.states(at),
            Partials(np.arange(at.size), by_q=nearest.slopes[:, :-1], by_t=by_t),
            subject=nearest.pairs,
            below=np.full(at.size, -np.inf),
            above=-nearest.missing,
            unit=np.array(item.length),
        )


def _of_constraint(part: GridMotion, item: PathConstraint, index: int) -> LimitRows:
    """Rows of a constraint of the problem where it is near its bounds.

    Args:
        part: The motion on a segment.
        item: The constraint.
        index: Index of the constraint in the problem of the segment.
    """
    shares = np.arange(1, SAMPLES + 1) / SAMPLES
    if item.order > 1:
        # Accelerations jump at the nodes: both sides are inspected.
        shares = np.append(0.0, shares)
    sampled = SampledConstraint.of(part, item, part.instants(*shares.tolist()))
    excess = sampled.excess
    if item.window is not None:
        inside = item.window.contains(sampled.states.t)
        excess = np.where(inside[:, None], excess, -np.inf)
    peaks = local_maxima(excess)
    chosen = peaks | np.isin(sampled.at.share, (0.0, *REGULAR))[:, None]
    # The values before and after each maximum, as a change may shift the maximum.
    chosen[1:] |= peaks[:-1]
    chosen[:-1] |= peaks[1:]
    chosen &= excess > -NEAR_CONSTRAINT
    return sampled.rows(item.name, np.full(item.count, index), chosen, item.scale)


# -- goals, and arrival times ----------------------------------------------------------


def _arrivals(motion: GridMotion) -> Iterator[LimitRows]:
    """Rows of the arrival times, for segments with limits on them."""
    dwells, segments = 0.0, motion.system.problem.segments
    each = zip(motion.segments, segments, strict=False)
    for number, (part, segment) in enumerate(each):
        if segment.arrival is not None:
            # The motion has no dwells, which precede the arrival in the problem.
            item = Arrival(*(time - dwells for time in segment.arrival))
            sampled = SampledConstraint.of(part, item, Instants.end(part.span[1]))
            yield sampled.rows(ARRIVAL, np.array([number]))
        dwells += segment.dwell


def _held(part: GridMotion) -> Iterator[LimitRows]:
    """Rows of the torques that hold the arm at the end of a segment."""
    item = part.system.held
    if item is not None:
        sampled = SampledConstraint.of(part, item, Instants.end(part.span[1]))
        yield sampled.rows(item.name, np.arange(item.count), equal=~item.driven)


def _goal(part: GridMotion) -> LimitRows:
    """Rows of the goal at the end of a segment."""
    at, kinematics = Instants.end(part.span[1]), part.system.kinematics
    _, q, v, *_ = part.states(at)
    goal = part.system.problem.goal.nearest(kinematics, q[0], v[0])
    lower, upper = goal.bounds(kinematics)
    item = GoalReached(goal, kinematics, np.ones(lower.size))
    sampled = SampledConstraint.of(part, item, at)
    return sampled.rows(GOAL, np.arange(lower.size), equal=lower == upper)
