"""Limits of a motion as linear rows on its small changes, with their multipliers.

The constraints are those of the programs that plan motions, at instants of the
certificate: limits of joints at the nodes and at maxima between them. Other constraints
of a problem are sampled finely in time, and are rows where they are nearest to their
bounds.
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
from tominpmp.certificate.clearances import REGULAR, SAMPLES, contacts
from tominpmp.certificate.motion import Motion
from tominpmp.constraints.base import Constraint, Partials, States
from tominpmp.constraints.final import Arrival, GoalReached
from tominpmp.constraints.joint_limits import JointLimit
from tominpmp.constraints.path import PathConstraint
from tominpmp.constraints.torque import MotorLimit, TorqueLimit
from tominpmp.motion.extrema import interior_maxima, local_maxima
from tominpmp.transcription.instants import Instants

# Kinds of rows that are no limits of the problem: the trust region of the linear
# program, and the goal.
TRUST = "trust region"
GOAL = "goal"
# Pairs, constraints and rows of goals are numbered within a segment: subjects of the
# next segment are larger by this.
SEGMENT = 1 << 20
# Kinds of rows of arrival times, and of the torques of joints without a motor.
ARRIVAL, PASSIVE = "arrival", "passive"
# Shares of the intervals at which torques, speeds and positions are inspected.
SHARES = tuple((np.arange(11) / 10).tolist())
MIDDLE = len(SHARES) // 2
# Values are rows inside an interval where they exceed the values at both of its ends by
# the first share of their limits, and are above the second share of them.
BULGE = 1e-3
NEAR = 0.97
# A torque that is smaller in the middle by less than this runs along its limit.
FLAT = 1e-2
# Positions are rows inside an interval where their slack is below the first number
# [rad, or shares of the reach] and they turn back by more than the second; at nodes
# where their slack is below the third, the trust region.
ROOM, TURN, FAR = 0.05, 1e-5, 1.0
# Constraints farther below their bounds, in units of their scale, are no rows.
NEAR_CONSTRAINT = 0.1


@dataclass(frozen=True, eq=False)
class LimitRows:
    """Limits of a motion, one a row.

    A single number is broadcast to all rows.

    Attributes:
        kind: "effort", "velocity", "clearance", ..., shape (m,).
        at: Instants of the rows.
        subject: Joint of each row, or collision pair, shape (m,).
        below: Lower limit less value, negative: infinite without a lower limit,
            positive where the motion violates it, shape (m,).
        above: Upper limit less value, positive: infinite without an upper limit,
            negative where the motion violates it, shape (m,).
        slopes: Derivatives by the state there, shape (m, 2 n); zero for slopes over
            time.
        change: Derivatives of the limited quantities by the unknowns, shape (m, size);
            zero for unknowns, which are columns of the program.
        unit: A unit of each row in units of its limit: the reach for clearances [m],
            shape (m,).
        of_state: Whether each row limits the state, at whose instant the costate falls;
            not torques, which limit the control, shape (m,).
        component: Index of the value of its constraint, shape (m,).
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
        """Slack below, never positive, shape (m,)."""
        return np.minimum(self.below, 0.0)

    @property
    def upper(self) -> Array:
        """Slack above, never negative, shape (m,)."""
        return np.maximum(self.above, 0.0)

    @property
    def held_above(self) -> BoolArray:
        """Whether the upper limit is active, shape (m,)."""
        return np.asarray(self.y > 0.0)

    @property
    def value(self) -> Array:
        """Share of the duration that a unit of slack is worth, never negative, (m,)."""
        return np.asarray(np.abs(self.y) / self.unit)

    @property
    def room(self) -> Array:
        """Slack to the active limit, never negative, shape (m,).

        In shares of the limit for torques, velocities, accelerations and rates, in rad
        or m for positions, in m for clearances.
        """
        return np.where(self.held_above, self.upper, -self.lower) * self.unit

    @property
    def promise(self) -> Array:
        """Multiplier times slack of each row, as a share of the duration, (m,)."""
        return self.value * self.room

    @property
    def used(self) -> Array:
        """Used share of the active limit, shape (m,)."""
        left = np.where(self.held_above, self.above, -self.below)
        return np.asarray(1.0 - left * self.unit)

    # -- subsets -----------------------------------------------------------------------

    def of(self, *kinds: str) -> BoolArray:
        """Whether each row is of given kinds, shape (m,)."""
        return np.isin(self.kind, kinds)

    @property
    def limits(self) -> BoolArray:
        """Whether each row belongs to a limit of the problem, shape (m,)."""
        return ~self.of(TRUST, GOAL)

    def kept(self, rows: IntArray | BoolArray) -> LimitRows:
        """Some of the rows."""

        def some(item: Any) -> Any:
            if isinstance(item, Instants):
                return Instants(item.interval[rows], item.share[rows])
            return item[rows]

        return LimitRows(*(some(getattr(self, item.name)) for item in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[LimitRows]) -> LimitRows:
        """The rows of all parts, one after the other."""

        def together(items: list[Any]) -> Any:
            if isinstance(items[0], Instants):
                return reduce(Instants.joined, items)
            if isinstance(items[0], np.ndarray):
                return np.concatenate(items)
            return sp.vstack(items, format="csr")

        columns = ([getattr(part, item.name) for part in parts] for item in fields(cls))
        return cls(*(together(column) for column in columns))


# -- from the constraints of a problem -------------------------------------------------


def limits_of(motion: Motion, near: bool = True) -> LimitRows:
    """Rows of all limits, of one segment after the other, and of the goals.

    Args:
        motion: The motion.
        near: Whether distances are rows: they need all meshes cut into convex pieces.
    """
    found = [*_arrivals(motion)]
    for number, part in enumerate(motion.segments):
        for limit in limits_of_joints(part):
            if limit.order > 2:
                found.append(_slopes(part, limit))
            else:
                found += _of_joints(part, limit)
        own = [*(_clearances(part) if near else ()), _goal(part)]
        for index, item in enumerate(part.system.problem.ready_constraints):
            own.append(_along_the_way(part, item, index))
        # Subjects of these are numbered within a segment, not in the whole motion.
        shift = number * SEGMENT
        found += [replace(rows, subject=rows.subject + shift) for rows in own]
    return LimitRows.joined(found)


def limits_of_joints(part: Motion) -> list[JointLimit | MotorLimit]:
    """Limits of the joints on a segment of a motion."""
    system = replace(part.system, clearance_rows=None)  # distances take time
    every = system.constraints
    return [item for item in every if isinstance(item, JointLimit | MotorLimit)]


@dataclass(frozen=True, eq=False)
class SampledConstraint:
    """A constraint at instants of a motion, m of them.

    Attributes:
        part: The motion, on a segment of it.
        item: The constraint, with the directions of joints with dry friction.
        at: The instants; pairs of them for slopes over time.
        states: The states there.
        values: Values, shape (m, p); of pairs, shape (m / 2, p).
        lower: Their lower bounds, same shape.
        upper: Their upper bounds, same shape.
    """

    part: Motion
    item: Constraint
    at: Instants
    states: States
    values: Array
    lower: Array
    upper: Array

    @classmethod
    def of(cls, part: Motion, item: Constraint, at: Instants) -> SampledConstraint:
        """Evaluate a constraint."""
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
        """Rows of some of the values.

        Args:
            kind: Name of the rows.
            subjects: Joint, or number, of each value, shape (p,).
            chosen: Whether each value is a row, shape (m, p); None for all.
            unit: Unit of the values, one for all or of each, shape (p,).
            equal: Whether the motion keeps values, which have no slack, shape (p,).
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
        """Derivatives of values whose instants are fixed in time, as a window is.

        A state that the change of lengths brings earlier moves on until the instant of
        the row. Rates of accelerations are small and left out.
        """
        if not isinstance(self.item, PathConstraint) or self.item.window is None:
            return partials
        rates, moved = np.zeros(index.size), (partials.by_q, partials.by_v)
        for by, speed in zip(moved, (self.states.v, self.states.a), strict=True):
            if by is not None:
                rates -= np.einsum("kj,kj->k", by, speed[index])
        return partials._replace(by_t=rates)


def _rows_of(
    part: Motion,
    kind: str,
    at: Instants,
    states: States,
    partials: Partials,
    **more: Any,
) -> LimitRows:
    """Rows of quantities that depend on the state at instants.

    Args:
        part: The motion on a segment.
        kind: Name of the rows.
        at: Instants of which some have rows.
        states: The states there.
        partials: Derivatives of the quantities.
        **more: Other attributes of the rows.
    """
    change = part.changes.pull_back(at, states, partials)
    slopes = np.zeros((change.shape[0], 2 * part.changes.n))
    if partials.row is None:
        for k, by in enumerate((partials.by_q, partials.by_v)):
            if by is not None:
                np.hsplit(slopes, 2)[k][:] = by
    # Values of pairs of instants are at the first.
    which = partials.at[: len(slopes)]
    at = Instants(at.interval[which], at.share[which])
    return LimitRows(np.array(kind), at, slopes=slopes, change=change, **more)


# -- limits of joints ------------------------------------------------------------------


def _of_joints(part: Motion, item: JointLimit | MotorLimit) -> Iterator[LimitRows]:
    """Rows of positions, speeds and torques at nodes, and at maxima between them."""
    found = SampledConstraint.of(part, item, part.instants(*SHARES))
    shape = found.values.shape
    chosen = _chosen(part, item, found.excess.reshape(-1, len(SHARES), item.count))
    if isinstance(item, JointLimit):
        unit = item.scale if item.order == 0 else 1.0
        yield found.rows(item.kind.name, item.of_joints, chosen.reshape(shape), unit)
        return
    if isinstance(item, TorqueLimit):
        if part.changes.shape == "torques":
            # The mean over the interval, on which torques may have been merged.
            middles = found.values.reshape(chosen.shape)[:, MIDDLE]
            middles[:] = part.load
        # A joint without a motor obeys its equation of motion.
        passive = np.zeros(chosen.shape, dtype=bool)
        passive[:, MIDDLE] = np.isin(item.of_joints, part.driven, invert=True)
        chosen[:, :, ~np.isin(item.of_joints, part.driven)] = False
        yield found.rows(PASSIVE, item.of_joints, passive.reshape(shape), equal=True)
    yield found.rows(item.kind.name, item.of_joints, chosen.reshape(shape))


def _chosen(part: Motion, item: JointLimit | MotorLimit, excess: Array) -> BoolArray:
    """Values that are rows, at which of the inspected instants of each interval.

    Args:
        part: The motion on a segment.
        item: The constraint.
        excess: Excesses of its values over their bounds, shape (N, SHARES, p).
    """
    shape, of_torques = part.changes.shape, isinstance(item, TorqueLimit)
    if item.field == "q":
        chosen = interior_maxima(excess, -ROOM, TURN)
        chosen[:, -1] |= excess[:, -1] > -FAR
        return chosen
    if isinstance(item, JointLimit) and item.field == "v":
        chosen = interior_maxima(excess, NEAR - 1.0, BULGE)
        if shape == "ramps":
            chosen[:, MIDDLE] |= _may_bulge(part, item, excess) & ~chosen.any(axis=1)
        chosen[:, -1] = True
        return chosen
    if of_torques:
        # Where a torque runs along its limit, the middle is a row as well as the ends,
        # whose mean changes differently.
        excess = excess.copy()
        excess[:, MIDDLE] += FLAT
    smooth = shape != "torques" and item.field != "a"
    chosen = interior_maxima(excess, NEAR - 1.0, BULGE) & smooth
    if of_torques and shape == "torques":
        chosen[:, MIDDLE] = True
    else:
        chosen[:, 0] = chosen[-1, -1] = True
        # With ramps, the end of an interval is the beginning of the next one.
        chosen[:, -1] |= shape != "ramps"
    return chosen


def _may_bulge(part: Motion, item: JointLimit, excess: Array) -> BoolArray:
    """Whether a speed may get its maximum inside an interval, shape (N, p).

    An acceleration that is raised at the beginning of an interval and lowered at its
    end leaves the speeds at both ends unchanged; for light joints the change is large.
    """
    strongest = (2.0 * part.system.effort_half / part.inertia[0])[item.joints]
    h = part.changes.h[slice(*part.span), None]
    return np.asarray(h * strongest / 8.0 > -excess[:, MIDDLE] * item.scale)


def _slopes(part: Motion, item: JointLimit | MotorLimit) -> LimitRows:
    """Rows of slopes of torques and accelerations over time."""
    first, end = part.span
    interval = np.arange(first, end - (part.changes.shape != "ramps"))
    found = SampledConstraint.of(part, item, part.changes.pairs(interval))
    return found.rows(item.kind.name, item.of_joints)


# -- clearances and constraints of the problem -----------------------------------------


def _clearances(part: Motion) -> Iterator[LimitRows]:
    """Distances that are near their margins, as shares of the reach."""
    item = part.system.clearance
    if item is not None:
        found = contacts(part, item)
        at = Instants.at_times(found.times, part.changes.h)
        rates = found.rates if item.moving else None
        yield _rows_of(
            part,
            item.name,
            at,
            part.states(at),
            Partials(np.arange(at.size), by_q=found.slopes, by_t=rates),
            subject=found.pairs,
            below=np.full(at.size, -np.inf),
            above=-found.missing,
            unit=np.array(item.length),
        )


def _along_the_way(part: Motion, item: PathConstraint, index: int) -> LimitRows:
    """A constraint of the problem where it is near its bounds."""
    shares = np.arange(1, SAMPLES + 1) / SAMPLES
    if item.order > 1:
        # Accelerations jump at the nodes: both sides are inspected.
        shares = np.append(0.0, shares)
    found = SampledConstraint.of(part, item, part.instants(*shares.tolist()))
    excess = found.excess
    if item.window is not None:
        asked = item.window.contains(found.states.t)
        excess = np.where(asked[:, None], excess, -np.inf)
    peaks = local_maxima(excess)
    chosen = peaks | np.isin(found.at.share, (0.0, *REGULAR))[:, None]
    # The values before and after the largest ones, too.
    chosen[1:] |= peaks[:-1]
    chosen[:-1] |= peaks[1:]
    chosen &= excess > -NEAR_CONSTRAINT
    return found.rows(item.name, np.full(item.count, index), chosen, item.scale)


# -- goals, and arrival times ----------------------------------------------------------


def _arrivals(motion: Motion) -> Iterator[LimitRows]:
    """Rows of the arrival times of segments that limit them."""
    stayed, segments = 0.0, motion.system.problem.segments
    for part, segment in zip(motion.segments, segments, strict=False):
        if segment.arrival is not None:
            item = Arrival(*(time - stayed for time in segment.arrival))
            found = SampledConstraint.of(part, item, Instants.end(part.span[1]))
            yield found.rows(ARRIVAL, np.array([part.number]))
        stayed += segment.dwell


def _goal(part: Motion) -> LimitRows:
    """Rows of the goal at the end of a segment."""
    at, kinematics = Instants.end(part.span[1]), part.system.kinematics
    _, q, v, *_ = part.states(at)
    goal = part.system.problem.goal.nearest(kinematics, q[0], v[0])
    lower, upper = goal.bounds(kinematics)
    item = GoalReached(goal, kinematics, np.ones(lower.size))
    found = SampledConstraint.of(part, item, at)
    return found.rows(GOAL, np.arange(lower.size), equal=lower == upper)
