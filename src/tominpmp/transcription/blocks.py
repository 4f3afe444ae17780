"""Blocks of rows that a constraint, or a transcription, adds to a program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.constraints.base import Constraint, Partials, States
from tominpmp.constraints.joint_limits import JointLimit
from tominpmp.constraints.path import PathConstraint
from tominpmp.constraints.torque import MotorLimit
from tominpmp.exceptions import OptionsError
from tominpmp.transcription.base import HullRows, Motion, Transcription
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions

# Rates of states are differences over this share of an interval.
ASIDE = 1e-4
# Positions that differ by no more than this are equal to rounding [rad or m].
SAME_PLACE = 1e-12


@dataclass(frozen=True, eq=False)
class SampledRows:
    """Rows of a constraint that is sampled at instants.

    Attributes:
        scheme: The transcription, which gives states and pulls derivatives back.
        constraint: The constraint, with its assumptions at the instants.
        fixed: Instants at fixed shares of intervals. A constraint that holds on all
            segments has rows at its kinks, which are in real time, as well.
        within: Half-open range of the intervals on which the constraint holds; None for
            all.
        suffix: Suffix of the name of the rows.
    """

    scheme: Transcription[Any]
    constraint: Constraint
    fixed: Instants
    within: tuple[int, int] | None = None
    suffix: str = ""

    @property
    def name(self) -> str:
        """Name of the constraint, with the segment on which it holds."""
        return self.constraint.name + self.suffix

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds, shape (r, p) each."""
        return self.constraint.bounds(self.fixed.size + self.kinks.size)

    def groups(self, by_component: bool) -> IntArray:
        """Group of each row: one for all rows, for each component, or each instant."""
        rows, count = self.bounds[0].shape
        if by_component and rows > 1:
            return np.tile(np.arange(count), rows)
        if self.constraint.gradual:
            return np.repeat(np.arange(rows), count)
        return np.zeros(rows * count, dtype=np.int64)

    @property
    def kinks(self) -> Array:
        """Times of the kinks at which the constraint has rows [s], shape (k,)."""
        return self.constraint.kinks if self.within is None else np.zeros(0)

    def instants(self, h: Array) -> Instants:
        """Instants of the rows, for intervals of lengths h [s], shape (N,).

        Kinks after the end of the motion are moved to its end.
        """
        if not self.kinks.size:
            return self.fixed
        return self.fixed.joined(Instants.at_times(self.kinks, h, self.scheme.delays))

    def states(self, motion: Motion) -> tuple[Instants, States]:
        """Instants of the rows, and the states at them."""
        at = self.instants(motion.h)
        return at, self.scheme.states(motion, at, self.constraint.order)

    def values(self, motion: Motion, attention: float = np.inf) -> Array:
        """Row values; those with a margin above ``attention`` may be too large."""
        states, cutoff = self.states(motion)[1], min(self.scheme.cutoff, attention)
        return self.constraint.evaluate(states, cutoff).ravel()

    def reusable(self, motion: Motion, former: Motion) -> bool:
        """Whether costly row values (clearances) equal the values of a former motion.

        Clearances to obstacles at rest depend on the positions alone.
        """
        constraint = self.constraint
        if not constraint.gradual or constraint.moving or constraint.order:
            return False
        here, there = self.states(motion)[1].q, self.states(former)[1].q
        return bool(np.max(np.abs(here - there), initial=0.0) <= SAME_PLACE)

    def jacobian(self, motion: Motion, chosen: IntArray) -> sp.csr_matrix:
        """Jacobian of some of the rows, shape (k, size)."""
        if not chosen.size:
            return sp.csr_matrix((0, self.scheme.size))
        at, partials = self.partials(motion, chosen)
        matrix = self.scheme.pull_back(motion, at, partials)
        if partials.row is None:
            return matrix
        shape = (chosen.size, partials.row.size)
        ones = np.ones(partials.row.size), (partials.row, np.arange(partials.row.size))
        return sp.csr_matrix(sp.csr_matrix(ones, shape=shape) @ matrix)

    def partials(self, motion: Motion, chosen: IntArray) -> tuple[Instants, Partials]:
        """Instants of the rows, and partial derivatives of some of the row values."""
        at, states = self.states(motion)
        row, which = np.divmod(chosen, max(self.constraint.count, 1))
        partials = self.constraint.differentiate(states, row, which)
        return at, self._pinned(motion, at, partials)

    def curvature(self, motion: Motion, multipliers: Array) -> list[sp.csr_matrix]:
        """Root of the curvature of the weighted sum of the row values.

        Args:
            motion: A motion.
            multipliers: Weights of the row values, positive at upper bounds.

        Returns:
            The matrix R, shape (k, size), of a curvature R^T R; an empty list if the
            curvature is zero.
        """
        chosen = np.flatnonzero(multipliers > 0.0)
        if not (chosen.size and self.constraint.bends):
            return []
        at, states = self.states(motion)
        row, which = np.divmod(chosen, max(self.constraint.count, 1))
        partials = self.constraint.bend(states, row, which)
        if partials is None or partials.row is None:
            return []
        roots = np.sqrt(multipliers[chosen])[partials.row]
        bent = self._pinned(motion, at, partials.times(roots))
        return [self.scheme.pull_back(motion, at, bent)]

    def _pinned(self, motion: Motion, at: Instants, partials: Partials) -> Partials:
        """Partial derivatives corrected for the rows at fixed real times (kinks).

        An obstacle that starts abruptly, or turns a corner, makes a kink in the
        constraint as a function of time. A row at a share of an interval would cross
        the kink when the duration changes; a row at the time of the kink stays there,
        and the path shifts relative to it.
        """
        end = motion.h.sum() + self.scheme.delays[-1]
        due = np.concatenate([np.zeros(self.fixed.size, dtype=bool), self.kinks < end])
        pinned: BoolArray = due[partials.at]
        if not pinned.any() or partials.by_t is None:
            return partials
        of, here = self.scheme, at[partials.at[pinned]]
        early = np.clip(here.share - ASIDE, 0.0, 1.0)
        late = np.clip(here.share + ASIDE, 0.0, 1.0)
        before, after = (
            of.states(motion, Instants(here.interval, share), self.constraint.order)
            for share in (early, late)
        )
        span = ((late - early) * motion.h[here.interval])[:, None]
        by_t: Array = np.where(pinned, 0.0, partials.by_t)
        # Slopes of the polynomials between the nodes, which may have defects.
        parts = partials[1:4], before[1:4], after[1:4]
        for part, first, last in zip(*parts, strict=True):
            if part is not None:
                rate = (last - first) / span
                by_t[pinned] -= np.einsum("kj,kj->k", part[pinned], rate)
        return partials._replace(by_t=by_t)

    def informed(self, motion: Motion) -> SampledRows:
        """The block with the assumptions of its constraint taken from a motion."""
        if not isinstance(self.constraint, MotorLimit) or self.constraint.motors.signs:
            return self
        return replace(self, constraint=self.assumed(motion, self.fixed))

    def assumed(self, motion: Motion, at: Instants) -> Constraint:
        """The constraint with its assumptions taken from a motion at instants."""
        of, constraint = self.scheme, self.constraint
        if not isinstance(constraint, MotorLimit) or not constraint.assumes:
            return constraint
        middle_v = of.states(motion, at.middles, 1).v
        return constraint.assumed(of.states(motion, at, constraint.order), middle_v)


Block = HullRows[Any] | SampledRows


def blocks_of(of: Transcription[Any]) -> list[Block]:
    """Blocks of rows for all constraints along the motion of a problem.

    Position and speed limits of the arm, and constraints that all segments have in
    common, hold on all segments; other constraints hold on a single segment. There are
    no blocks without rows.
    """
    parts = of.system.segments
    common = (item for item in parts[0].constraints if _shared(item, parts))
    blocks = [block_of(of, item) for item in common]
    for number, (part, within) in enumerate(zip(parts, of.segments, strict=True)):
        own = (item for item in part.constraints if not _shared(item, parts))
        blocks += [block_of(of, item, within, number) for item in own]
    return [block for block in blocks if block is not None and block.bounds[0].size]


def _shared(constraint: Constraint, parts: Sequence[ProblemFunctions]) -> bool:
    """Whether a constraint is the same on all segments, as limits of the arm are."""
    found = (any(_same(constraint, c) for c in part.constraints) for part in parts)
    return constraint.field in ("q", "v") or all(found)


def _same(one: Constraint, other: Constraint) -> bool:
    return one is other or (isinstance(one, JointLimit) and one == other)


def block_of(
    of: Transcription[Any],
    constraint: Constraint,
    within: tuple[int, int] | None = None,
    segment: int = 0,
) -> Block | None:
    """Rows of a constraint; None if bounds of the unknowns keep it.

    Args:
        of: The parameterisation.
        constraint: The constraint.
        within: Half-open range of the intervals of the segment on which the constraint
            holds; None for all segments.
        segment: Number of this segment, from 0.
    """
    if constraint.field in of.bounded:
        return None
    if constraint.order > of.highest_order:
        raise OptionsError(
            f"{constraint.name}: its limits need continuous accelerations, expected "
            "control 'linear' or 'spline'",
            "control",
        )
    suffix = "" if within is None else f" on segment {segment + 1}"
    if isinstance(constraint, JointLimit):
        hull = of.hull(constraint, constraint.name + suffix, within)
        if hull is not None:
            return hull
    if isinstance(constraint, PathConstraint) and constraint.window is not None:
        return SampledRows(of, constraint, Instants.of_pairs(()))
    at = of.instants(constraint.order, constraint.field)
    if within is not None:
        at = at.within(*within)
        if constraint.order <= 2:  # instants for rates come in pairs
            # The beginning and the end of the segment have rows, too.
            first, end = within
            known, ends = set(at.pairs), [(first, 0.0)] if first else []
            missing = [pair for pair in (*ends, (end - 1, 1.0)) if pair not in known]
            at = at.joined(Instants.of_pairs(missing))
    return SampledRows(of, constraint, at, within, suffix)
