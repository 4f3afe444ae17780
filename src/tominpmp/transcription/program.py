"""Nonlinear programs: a transcription, and constraints as rows at instants.

They are values: nothing in them changes, and whatever they tell of an iterate depends
on the iterate alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.constraints import Constraint, GoalReached, JointLimit, Partials, States
from tominpmp.exceptions import OptionsError
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.base import (
    Hull,
    Linearization,
    Motion,
    Rows,
    StepBounds,
    Transcription,
    Variation,
)
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.system import System

# Value of the rows of a motion that could not be integrated to its end.
BROKEN = 1e3
# Instants attain the maximum of a constraint if they come this close to it.
ATTAINED = 1e-4

Selection = Literal["near", "exact", "violated"]


@dataclass(frozen=True, eq=False)
class Always:
    """Rows that hold at all times, or equations of a transcription.

    Attributes:
        name: Name of the kind.
        hull: The rows.
        curable: Whether a slower motion violates them less.
    """

    name: str
    hull: Hull[Any]
    curable: bool = False
    gradual: bool = False

    @property
    def lower(self) -> Array:
        """Lower bounds, shape (1, m)."""
        return self.hull.lower[None]

    @property
    def upper(self) -> Array:
        """Upper bounds, shape (1, m)."""
        return self.hull.upper[None]

    def groups(self, by_component: bool) -> IntArray:
        """One group."""
        return np.zeros(self.hull.lower.size, dtype=np.int64)

    def values(self, of: Transcription[Any], motion: Motion) -> Array:
        """Row values."""
        return self.hull.values(motion)

    def jacobian(
        self, of: Transcription[Any], motion: Motion, chosen: IntArray
    ) -> sp.csr_matrix:
        """Jacobian of some of them."""
        whole = self.hull.jacobian(motion)
        return whole if chosen.size == whole.shape[0] else whole[chosen]


@dataclass(frozen=True, eq=False)
class Sampled:
    """A constraint at instants.

    Attributes:
        constraint: The constraint, with what it takes for granted at the instants.
        fixed: Instants at shares of intervals. Those at which the constraint has kinks
            in real time come on top of them.
    """

    constraint: Constraint
    fixed: Instants

    @property
    def name(self) -> str:
        """Name of the constraint."""
        return self.constraint.name

    @property
    def gradual(self) -> bool:
        """Whether rows far below their bounds may be left out."""
        return self.constraint.gradual

    @property
    def curable(self) -> bool:
        """Whether a slower motion violates them less."""
        return self.constraint.curable

    @cached_property
    def _bounds(self) -> tuple[Array, Array]:
        return self.constraint.bounds(self.fixed.size + self.constraint.kinks.size)

    @property
    def lower(self) -> Array:
        """Lower bounds, shape (r, p)."""
        return self._bounds[0]

    @property
    def upper(self) -> Array:
        """Upper bounds, shape (r, p)."""
        return self._bounds[1]

    def groups(self, by_component: bool) -> IntArray:
        """One group; or one for each component, or instant."""
        rows, count = self.lower.shape
        if by_component and rows > 1:
            return np.tile(np.arange(count), rows)
        if self.constraint.shared:
            return np.zeros(rows * count, dtype=np.int64)
        return np.repeat(np.arange(rows), count)

    def instants(self, h: Array) -> Instants:
        """The instants on intervals of given lengths [s], shape (N,).

        Those that are due after the end of the motion are at its end.
        """
        kinks = self.constraint.kinks
        return (
            self.fixed.joined(Instants.at_times(kinks, h)) if kinks.size else self.fixed
        )

    def states(self, of: Transcription[Any], motion: Motion) -> tuple[Instants, States]:
        """The instants, and the states there."""
        at = self.instants(motion.h)
        return at, of.states(motion, at, self.constraint.order)

    def values(self, of: Transcription[Any], motion: Motion) -> Array:
        """Row values."""
        _, states = self.states(of, motion)
        return self.constraint.evaluate(states, of.cutoff).ravel()

    def jacobian(
        self, of: Transcription[Any], motion: Motion, chosen: IntArray
    ) -> sp.csr_matrix:
        """Jacobian of some of the values."""
        if not chosen.size:
            return sp.csr_matrix((0, of.size))
        at, partials = self.partials(of, motion, chosen)
        matrix = of.pull_back(motion, at, partials)
        if partials.row is None:
            return matrix
        shape = (chosen.size, partials.row.size)
        ones = np.ones(partials.row.size), (partials.row, np.arange(partials.row.size))
        return sp.csr_matrix(sp.csr_matrix(ones, shape=shape) @ matrix)

    def partials(
        self, of: Transcription[Any], motion: Motion, chosen: IntArray
    ) -> tuple[Instants, Partials]:
        """Instants, and partial derivatives of some of the values there."""
        at, states = self.states(of, motion)
        row, which = np.divmod(chosen, max(self.constraint.count, 1))
        partials = self.constraint.differentiate(states, row, which)
        return at, self._pinned(of, motion, at, partials)

    def _pinned(
        self, of: Transcription[Any], motion: Motion, at: Instants, partials: Partials
    ) -> Partials:
        """Partial derivatives of values some of whose instants are fixed in real time.

        An obstacle that begins to move at once, or turns a corner, makes a kink in the
        time that the arm may be somewhere. A row at a share of an interval jumps over
        it when the duration changes; a row at that very instant stays there, and the
        path shifts under it.
        """
        kinks = self.constraint.kinks
        due = np.concatenate(
            [np.zeros(self.fixed.size, dtype=bool), kinks < motion.h.sum()]
        )
        pinned: BoolArray = due[partials.at]
        if not pinned.any() or partials.by_q is None or partials.by_t is None:
            return partials
        rates = of.rates(motion, at)[partials.at]
        shift = np.einsum("kj,kj->k", partials.by_q, rates)
        return partials._replace(by_t=np.where(pinned, -shift, partials.by_t))

    def adapted(
        self,
        change: Callable[[Constraint, States, Array], Constraint],
        of: Transcription[Any],
        motion: Motion,
    ) -> Sampled:
        """The same with a constraint that is changed by a motion."""
        at, states = self.states(of, motion)
        beside = of.states(motion, at.middles, 1).v
        return replace(self, constraint=change(self.constraint, states, beside))


Block = Always | Sampled


@dataclass(frozen=True, eq=False)
class NonlinearProgram:
    """A transcription with rows of constraints.

    Attributes:
        transcription: The parameterisation.
        blocks: The rows.
        selection: Which rows of path constraints become rows of a linear program:
            "near" those that a step can bring to their bounds, "exact" those that
            attain the maximum over time (the paper's S), "violated" those beyond.
    """

    transcription: Transcription[Any]
    blocks: tuple[Block, ...]
    selection: Selection = "near"

    @classmethod
    def of(
        cls, transcription: Transcription[Any], selection: Selection = "near"
    ) -> NonlinearProgram:
        """The program of a problem, with all its constraints and its goal."""
        system = transcription.system
        blocks: list[Block] = []
        if transcription.equations is not None:
            blocks.append(Always("dynamics", transcription.equations))
        for constraint in system.constraints:
            block = _block(transcription, constraint)
            if block is not None and block.lower.size:
                blocks.append(block)
        scale = transcription.goal_scale
        if scale is not None:
            goal = GoalReached(system.problem.goal, system.kinematics, scale)
            blocks.append(Sampled(goal, Instants.end(transcription.intervals)))
        return cls(transcription, tuple(blocks), selection)

    def at(self, z: Array) -> NonlinearProgram:
        """The program with what it takes for granted of motions, from one of them.

        These are scales of the controls, and the way that joints with dry friction
        move, where that is not known yet.
        """
        motion = self.transcription.motion(z)
        if not motion.finite:
            return self
        of = self.transcription.scaled_at(z)
        blocks = tuple(
            block.adapted(_first_look, of, motion)
            if isinstance(block, Sampled)
            else block
            for block in self.blocks
        )
        return replace(self, transcription=of, blocks=blocks)

    # -- what solvers see --------------------------------------------------------------

    @property
    def system(self) -> System:
        """The functions of the problem."""
        return self.transcription.system

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.transcription.size

    @property
    def cost(self) -> Array:
        """Gradient of the duration."""
        return self.transcription.cost

    @cached_property
    def rows(self) -> Rows:
        """What the rows are."""
        by_component = self.transcription.by_component
        return Rows.stack(
            [
                (
                    block.name,
                    block.lower.ravel(),
                    block.upper.ravel(),
                    block.groups(by_component),
                )
                for block in self.blocks
            ],
            {block.name for block in self.blocks if block.curable},
        )

    def evaluate(self, z: Array) -> Array:
        """Row values."""
        motion = self.transcription.motion(z)
        if not motion.finite:
            return np.full(self.rows.size, BROKEN)
        parts = [block.values(self.transcription, motion) for block in self.blocks]
        return np.concatenate(parts)

    def linearize(self, z: Array, values: Array, steps: StepBounds) -> Linearization:
        """Jacobian of the rows that can become active within a box of steps."""
        of = self.transcription
        motion = of.motion(z)
        if not motion.finite:
            # Nothing can be said of it; without rows, the program makes it shorter.
            none = np.zeros(0, dtype=np.int64)
            return Linearization(none, sp.csr_matrix((0, self.size)))
        chosen = self.selected(values, steps)
        parts = []
        for index, block in enumerate(self.blocks):
            mine = chosen[self.rows.kind[chosen] == index] - self.first[index]
            parts.append(block.jacobian(of, motion, mine))
        return Linearization(chosen, sp.vstack(parts, format="csr"))

    @cached_property
    def first(self) -> IntArray:
        """Index of the first row of each block."""
        return np.searchsorted(self.rows.kind, np.arange(len(self.blocks)))

    def selected(self, values: Array, steps: StepBounds | None = None) -> IntArray:
        """Indices of the rows of a linear program, ascending.

        Args:
            values: Row values, shape (m,).
            steps: Box for its step.
        """
        rows = self.rows
        path = np.array([block.lower.shape[0] > 1 for block in self.blocks])[rows.kind]
        if self.selection == "violated":
            return np.flatnonzero(~path | (rows.violation(values) > 0.0))
        if self.selection == "exact":
            return np.flatnonzero(~path | self._attained(values))
        chosen = np.ones(rows.size, dtype=bool)
        for index, block in enumerate(self.blocks):
            if block.gradual:
                radius = self.transcription.attention(steps)
                if isinstance(block, Sampled) and block.constraint.moving:
                    radius = max(radius, self.transcription.moving_attention)
                mine = rows.kind == index
                chosen[mine] = values[mine] > rows.upper[mine] - radius
        return np.flatnonzero(chosen)

    def _attained(self, values: Array) -> BoolArray:
        rows = self.rows
        chosen = np.zeros(rows.size, dtype=bool)
        for excess in (values - rows.upper, rows.lower - values):
            largest = np.full(int(rows.group.max()) + 1, -np.inf)
            np.maximum.at(largest, rows.group, excess)
            attained = excess >= largest[rows.group] - ATTAINED
            chosen |= attained & np.isfinite(excess)
        return chosen

    def gradient(self, z: Array, weights: Array) -> Array:
        """Gradient of a weighted sum of rows.

        Args:
            z: Iterate.
            weights: Weight of each row, shape (m,).

        Returns:
            Jacobian transposed times weights, shape (size,).
        """
        of, total = self.transcription, np.zeros(self.size)
        motion = of.motion(z)
        for index, block in enumerate(self.blocks):
            mine = self.rows.kind == index
            chosen = np.flatnonzero(weights[mine])
            if not chosen.size:
                continue
            some = weights[mine][chosen]
            if not isinstance(block, Sampled):
                total += some @ block.jacobian(of, motion, chosen)
                continue
            at, partials = block.partials(of, motion, chosen)
            if partials.row is not None:
                some = some[partials.row]
            total += of.pull_back_sum(motion, at, partials, some)
        return total

    def step_bounds(self, z: Array, radius: float) -> StepBounds:
        """Trust region within the bounds of the unknowns."""
        return self.transcription.step_bounds(z, radius)

    def variation(self, z: Array) -> Variation:
        """Differences of the controls."""
        return self.transcription.variation(z)

    def stretch(self, z: Array, factor: float) -> Array:
        """The same path, slower by a factor."""
        return self.transcription.stretch(z, factor)

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate."""
        return self.transcription.trajectory(z)


def _first_look(constraint: Constraint, states: States, beside: Array) -> Constraint:
    return constraint if constraint.informed else constraint.assumed(states, beside)


def _block(of: Transcription[Any], constraint: Constraint) -> Block | None:
    """Rows of a constraint; None where bounds of the unknowns keep it."""
    if constraint.field in of.kept:
        return None
    if constraint.order > of.highest:
        raise OptionsError(
            f"{constraint.name}: limits of it need continuous accelerations, expected "
            "control 'linear' or 'spline'",
            "control",
        )
    if isinstance(constraint, JointLimit):
        hull = of.hull(constraint)
        if hull is not None:
            return Always(constraint.name, hull, curable=constraint.curable)
    return Sampled(constraint, of.instants(constraint.order, constraint.field))
