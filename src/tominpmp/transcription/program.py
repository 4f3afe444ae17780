"""Nonlinear programs: a transcription, and constraints as rows at instants.

In the paper's notation the rows are g(u, T) = 0 for the goal (equation 8) and
h(u, T) = max b(x(tau), tau, T) <= 0 for constraints (equation 9), with the maximum over
the instants. Programs are immutable, and all functions of an iterate depend on the
iterate alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray
from tominpmp.constraints.base import Constraint
from tominpmp.constraints.final import Arrival, GoalReached
from tominpmp.constraints.joint_limits import JointLimit
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.base import Linearization, Rows, StepBounds, Transcription
from tominpmp.transcription.blocks import Block, SampledRows, blocks_of
from tominpmp.transcription.grid import ROUNDING
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions

# An instant counts as attaining the maximum of a constraint if its value is this close.
ATTAINED = 1e-4

# Velocity limits times this rate scale the accelerations at an end [1/s].
BRAKING = 10.0

Selection = Literal["near", "exact"]
# Instants of rows, the intervals on which they hold, and the suffix of their name.
Place = tuple[Instants, tuple[int, int] | None, str]


@dataclass(frozen=True, eq=False)
class NonlinearProgram:
    """A transcription with rows of constraints.

    Attributes:
        transcription: The parameterisation.
        blocks: The blocks of rows.
        selection: Rows of path constraints that enter a linear program: "near" for rows
            that a step can bring to their bounds, "exact" for rows that attain the
            maximum over time (the paper's set S).
        least_duration: Lower bound on the duration [s], if the duration is the last
            unknown. Once the bound is active the iteration can only smooth the
            controls, and any feasible iterate is a solution.
    """

    transcription: Transcription[Any]
    blocks: tuple[Block, ...]
    selection: Selection = "near"
    least_duration: float = 0.0

    @classmethod
    def of(
        cls, transcription: Transcription[Any], selection: Selection = "near"
    ) -> NonlinearProgram:
        """The program of a problem, with all its constraints and its goal."""
        along = [*transcription.equations, *blocks_of(transcription)]
        ends = _at_ends_of_segments(transcription)
        # The ends come first if the torques are the only unknowns, as in the paper:
        # among steps of equal cost, linear programs then find a better one.
        blocks = [*ends, *along] if transcription.by_component else [*along, *ends]
        return cls(transcription, tuple(blocks), selection)

    def at(self, z: Array) -> NonlinearProgram:
        """The program with its assumptions about the motion taken from an iterate.

        The assumptions are the scales of the controls, and the velocity signs of joints
        with dry friction, where they are not known yet.
        """
        motion = self.transcription.motion(z)
        if not motion.finite:
            return self
        of = self.transcription.scaled_at(z)
        blocks = tuple(block.informed(motion) for block in self.blocks)
        return replace(self, transcription=of, blocks=blocks)

    def centred_at(self, z: Array) -> NonlinearProgram:
        """The same program, faster to evaluate near z; values differ by rounding."""
        of = self.transcription.centred_at(z)
        return self if of is self.transcription else replace(self, transcription=of)

    # -- interface of the solvers ------------------------------------------------------

    @property
    def system(self) -> ProblemFunctions:
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
        """Bounds, kinds and groups of the rows."""
        lower, upper = zip(*(block.bounds for block in self.blocks), strict=True)
        by_component = self.transcription.by_component
        each = [block.groups(by_component) for block in self.blocks]
        kind = np.repeat(np.arange(len(each)), [groups.size for groups in each])
        # Groups are counted from 0 within each block.
        first = np.cumsum([0, *(groups.max(initial=-1) + 1 for groups in each)])
        kinds = tuple(block.name for block in self.blocks)
        return Rows(
            np.concatenate(lower, axis=None),
            np.concatenate(upper, axis=None),
            kind,
            np.concatenate(each) + first[kind],
            kinds,
        )

    def timed(self, z: Array) -> Array:
        """The iterate, its duration snapped to the lower bound if it is almost there.

        Rows are evaluated at this iterate, so that constraints hold for the least
        duration.
        """
        T = self.least_duration
        if T == 0.0 or abs(z[-1] - T) > ROUNDING * T:
            return z
        return np.append(z[:-1], T)

    def evaluate(self, z: Array, attention: float = np.inf) -> Array:
        """Row values; see :meth:`ProgramInterface.evaluate` for ``attention``."""
        motion = self.transcription.motion(self.timed(z))
        if not motion.finite:
            return self.rows.not_integrated
        return np.concatenate(
            [block.values(motion, attention) for block in self.blocks]
        )

    def attention(self, steps: StepBounds) -> float:
        """Margin within which steps of a box can make gradual constraints active.

        Infinite if obstacles move.
        """
        moving = any(
            isinstance(block, SampledRows) and block.constraint.moving
            for block in self.blocks
        )
        return np.inf if moving else self.transcription.attention(steps)

    def linearize(self, z: Array, values: Array, steps: StepBounds) -> Linearization:
        """Jacobian of the rows that can become active within a box of steps."""
        motion = self.transcription.motion(self.timed(z))
        if not motion.finite:
            # There are no states to linearise at; a program without rows shortens the
            # motion, until it can be integrated.
            no_rows = np.zeros(0, dtype=np.int64)
            return Linearization(no_rows, sp.csr_matrix((0, self.size)), steps)
        chosen = self._chosen(values, steps)
        parts = [
            block.jacobian(motion, np.flatnonzero(mine))
            for block, mine in self._by_block(chosen)
        ]
        matrix, units = sp.vstack(parts, format="csr"), self.transcription.units(z)
        return Linearization(np.flatnonzero(chosen), matrix, steps, units)

    def curvature(self, z: Array, multipliers: Array) -> sp.csr_matrix:
        """Root of the curvature of the rows whose constraints have one.

        Args:
            z: Iterate.
            multipliers: Multipliers of the rows, shape (m,).

        Returns:
            Matrix R, shape (k, size): for a step d, |R d|^2 / 2 is the second-order
            term, weighted by the multipliers, that linearised rows lack. It has no rows
            if no row has a curvature.
        """
        motion = self.transcription.motion(self.timed(z))
        roots = [sp.csr_matrix((0, self.size))]
        for block, weights in self._by_block(multipliers):
            if motion.finite and isinstance(block, SampledRows):
                roots += block.curvature(motion, weights)
        return sp.vstack(roots, format="csr")

    def _by_block(self, values: Array | BoolArray) -> Iterator[tuple[Block, Any]]:
        """Each block, with its part of an array of all rows."""
        ends = np.cumsum([block.bounds[0].size for block in self.blocks])
        return zip(self.blocks, np.split(values, ends[:-1]), strict=True)

    def _chosen(self, values: Array, steps: StepBounds) -> BoolArray:
        """Whether each row enters a linear program, shape (m,).

        Args:
            values: Row values, shape (m,).
            steps: Box for the step of the linear program.
        """
        rows = self.rows
        if self.selection == "exact":
            path = np.array([len(block.bounds[0]) > 1 for block in self.blocks])
            return ~path[rows.kind] | self._attained(values)
        parts = []
        for block, own in self._by_block(values):
            near = np.ones(own.size, dtype=bool)
            if isinstance(block, SampledRows) and block.constraint.gradual:
                radius = self.transcription.attention(steps)
                if block.constraint.moving:
                    radius = max(radius, self.transcription.moving_attention)
                near = own > block.bounds[1].ravel() - radius
            parts.append(near)
        return np.concatenate(parts)

    def _attained(self, values: Array) -> BoolArray:
        """Whether each row attains the largest excess in its group, shape (m,)."""
        rows = self.rows
        chosen = np.zeros(rows.size, dtype=bool)
        for excess in (values - rows.upper, rows.lower - values):
            largest = np.full(rows.group_count, -np.inf)
            np.maximum.at(largest, rows.group, excess)
            attained = excess >= largest[rows.group] - ATTAINED
            chosen |= attained & np.isfinite(excess)
        return chosen

    def gradient(self, z: Array, weights: Array) -> Array:
        """Gradient of a weighted sum of row values.

        Args:
            z: Iterate.
            weights: Weight of each row, shape (m,).

        Returns:
            Transposed Jacobian times the weights, shape (size,).
        """
        of, total = self.transcription, np.zeros(self.size)
        motion = of.motion(z)
        for block, own in self._by_block(weights):
            chosen = np.flatnonzero(own)
            if not chosen.size:
                continue
            factors = own[chosen]
            if not isinstance(block, SampledRows):
                total += factors @ block.jacobian(motion, chosen)
                continue
            at, partials = block.partials(motion, chosen)
            if partials.row is not None:
                factors = factors[partials.row]
            total += of.pull_back_sum(motion, at, partials, factors)
        return total

    def step_bounds(self, z: Array, radius: float) -> StepBounds:
        """Box of the trust region, within the bounds of the unknowns."""
        bounds = self.transcription.step_bounds(z, radius)
        lower = bounds.lower.copy()
        lower[-1] = min(max(lower[-1], self.least_duration - z[-1]), 0.0)
        return bounds._replace(lower=lower)

    def time_scale(self, z: Array, factor: float) -> Array:
        """Iterate for the same path, slower by a factor; z itself for a factor of 1."""
        return z if factor == 1.0 else self.transcription.time_scale(z, factor)

    def slower(self, z: Array, factor: float, values: Array) -> tuple[Array, Array]:
        """Iterate for the same path, slower by a factor, and its row values.

        Args:
            z: Iterate.
            factor: Factor of the duration.
            values: Row values of z, of which clearances are reused.
        """
        slow, of = self.time_scale(z, factor), self.transcription
        former, motion = of.motion(self.timed(z)), of.motion(self.timed(slow))
        if not (former.finite and motion.finite):
            return slow, self.evaluate(slow)
        parts = []
        for block, own in self._by_block(values):
            kept = isinstance(block, SampledRows) and block.reusable(motion, former)
            parts.append(own if kept else block.values(motion))
        return slow, np.concatenate(parts)

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate."""
        return self.transcription.trajectory(z)


def _at_ends_of_segments(of: Transcription[Any]) -> list[Block]:
    """Rows at the ends of segments: goals, held loads, still joints, arrival times."""
    ends, arrivals = list[Block](), list[Block]()
    parts, segments = of.system.segments, of.system.problem.segments
    for number, (part, within) in enumerate(zip(parts, of.segments, strict=True)):
        at, last = Instants.end(within[1]), number + 1 == len(parts)
        place: Place = (at, within, f" of segment {number + 1}")
        # The list of segments is empty for a problem without segments.
        arrival = segments[number].arrival if segments else None
        if arrival is not None:
            arrivals.append(SampledRows(of, Arrival(*arrival), *place))
        if last:
            place, scale = (at, None, ""), of.goal_scale
            # The arm moves on without acceleration, unless accelerations may jump.
            still = part.final_velocity is None and not part.sudden
        else:
            scale = part.goal_scale
            # Motions above degree 3 are given by accelerations, which cannot jump.
            sudden = part.sudden and parts[number + 1].sudden and of.degree <= 3
            still = segments[number].dwell > 0.0 and not sudden and of.highest_order > 2
        wanted: list[Constraint | None] = [part.held]
        if scale is not None:
            wanted.insert(0, GoalReached(part.problem.goal, part.kinematics, scale))
        if still:
            speeds = part.problem.robot.limits.velocity
            wanted.append(JointLimit.at_end(BRAKING * speeds))
        ends += [SampledRows(of, item, *place) for item in wanted if item is not None]
    return [*ends, *arrivals]
