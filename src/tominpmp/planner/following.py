"""Following: iterations whose rows of distances go along with the motion.

Each iteration linearises distances where pairs are nearest in the motion as it is, and
the step is judged where they are nearest in the motion that it leads to: the merit is
that of the least distances, whenever these are. Nothing that a grid has chosen holds
the motion, and no row is left behind.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.certificate.clearances import Nearest, nearest_instants
from tominpmp.certificate.motion import Motion
from tominpmp.certificate.task import Task
from tominpmp.linear_programs import make_solver
from tominpmp.options import Options
from tominpmp.planner.direct_solve import NEARLY
from tominpmp.planner.progress import Progress
from tominpmp.solvers.callbacks import go_on
from tominpmp.solvers.iterate import Iterate, SlpResult
from tominpmp.solvers.merit import WEIGHT_MARGIN, Merit
from tominpmp.solvers.rounds import solve_in_rounds
from tominpmp.solvers.slp import SlpSolver
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.distance_rows import (
    anchored,
    padding_left,
    unanchored,
    with_nearest,
)
from tominpmp.transcription.exchange import exchanged
from tominpmp.transcription.layout import Gridded
from tominpmp.transcription.program import NonlinearProgram

# Iterations at most.
STEPS = 20
# Trust region to begin with, as a share of the usual one, and how it follows.
RADIUS, LARGER, SMALLER, SMALLEST = 0.1, 2.0, 0.3, 5e-3
# A step is taken if it brings so much of T, and following ends when this many together
# bring less than that.
WORTH, WINDOW, LITTLE = 1e-6, 4, 3e-4
# Least weight of violations in the merit, as a share of T.
LEAST_WEIGHT = 0.5
# The last iterations, with rows that stay where they are, and those with more of them.
LAST, CLOSER = 8, 25


class Budget:
    """Callback that ends iterations when there have been enough.

    Args:
        progress: Is shown every record.
        limit: So many iterations are enough.

    Attributes:
        used: Iterations so far.
    """

    def __init__(self, progress: Progress, limit: int) -> None:
        self.progress, self.limit, self.used = progress, limit, 0

    @property
    def spent(self) -> bool:
        """Whether there have been enough."""
        return self.used >= self.limit

    def allow(self, more: int) -> None:
        """Have so many left at least."""
        self.limit = max(self.limit, self.used + more)

    def __call__(self, record: IterationRecord) -> Status | None:
        """See a record; a status ends the iteration."""
        self.used += 1
        status = self.progress(record)
        return status or (Status.ITERATION_LIMIT if self.spent else None)


class Following:
    """Improves a motion with rows of distances at its own nearest instants.

    Args:
        of: The parameterisation.
        options: Options of the plan; the smoothing is a share of T.
        budget: Time limit and callback, and how many iterations there may be.
        padding: Share of the padding of distances that is left.
        squares: Whether the variation of torques counts by its squares.
    """

    def __init__(
        self,
        of: Gridded,
        options: Options,
        budget: Budget,
        padding: float,
        squares: bool,
    ) -> None:
        self.of, self.budget, self.padding = of, budget, padding
        self.task = Task.of(of.system.problem)
        self.lp = make_solver(options.lp_solver)
        self.options, self.radius = options, RADIUS
        self.squares = squares

    def run(self, z: Array) -> tuple[NonlinearProgram, SlpResult]:
        """Follow a motion, then settle it with the rows that it has in the end."""
        self.padding = padding_left(self.of, z, self._nearest(z), self.padding)
        program, gains = self.anchored(z), [np.inf] * WINDOW
        for _ in range(STEPS):
            result = self._solve(program, z, None, 1)
            self.budget(result.history[-1])
            merit, there = _weighted(result.iterate), result.iterate.z
            after = self.anchored(there)
            gain = _merit(merit, program, z) - _merit(merit, after, there)
            T = result.iterate.duration
            if gain > WORTH * T:
                z, program = there, after
                self.radius = min(LARGER * self.radius, 1.0)
            else:
                self.radius *= SMALLER
            gains = [*gains[1:], max(gain, 0.0)]
            little = sum(gains) < LITTLE * T or self.radius < SMALLEST
            if little or self.budget.spent:
                break
        return self.settled(unanchored(program), z, LAST)

    def settled(
        self, program: NonlinearProgram, z: Array, iterations: int
    ) -> tuple[NonlinearProgram, SlpResult]:
        """Iterate with rows that stay where they are, and others between them."""
        few = replace(self.options, max_iterations=iterations)

        def solve(
            program: NonlinearProgram, z: Array, few: Options, former: SlpResult | None
        ) -> SlpResult:
            return self._solve(program, z, former, few.max_iterations)

        return solve_in_rounds(program, z, few, solve, rough=False)

    def looked_closer(
        self, program: NonlinearProgram, result: SlpResult
    ) -> tuple[NonlinearProgram, SlpResult]:
        """Settle once more, with rows where pairs are nearest beside the others."""
        z = result.iterate.z
        program = with_nearest(program, z, self._nearest(z))
        self.budget.allow(min(CLOSER, self.options.max_iterations))
        return self.settled(program, z, CLOSER)

    def anchored(self, z: Array) -> NonlinearProgram:
        """The program with rows of distances where pairs are nearest in an iterate."""
        return anchored(self.plain(z), z, self._nearest(z), self.padding)

    def plain(self, z: Array) -> NonlinearProgram:
        """The program with rows where a grid has them, and where the motion rests."""
        program = NonlinearProgram.of(self.of).at(z)
        return exchanged(program, z, -NEARLY) or program

    def _nearest(self, z: Array) -> Nearest:
        if self.of.system.clearance is None:
            return Nearest.none(self.of.system.n)
        return nearest_instants(Motion.of(self.task, self.of.trajectory(z)))

    def _solve(
        self, program: NonlinearProgram, z: Array, former: SlpResult | None, most: int
    ) -> SlpResult:
        """Some iterations with given rows."""
        options = self.options
        radius = options.trust_region * max(self.radius, SMALLEST)
        few = replace(options, trust_region=radius, max_iterations=most)
        smoothing = (options.smoothing or 0.0) * float(program.cost @ z)
        keep = self.budget.progress.keep
        # A single iteration is shown by whoever asked for it.
        callback = go_on if most == 1 else self.budget
        solver = SlpSolver(program, few, smoothing, self.lp, callback, keep=keep)
        return replace(solver, squares=self.squares).run(z, after=former)


def _weighted(iterate: Iterate) -> Merit:
    """The merit with weights a little above the multipliers of the last program."""
    merit, rows = iterate.merit, iterate.merit.rows
    groups = np.zeros(int(rows.group.max()) + 1)
    np.add.at(groups, rows.group, np.abs(iterate.multipliers))
    needed = np.zeros_like(merit.weights)
    np.maximum.at(needed, rows.group_kind, WEIGHT_MARGIN * groups)
    least = LEAST_WEIGHT * iterate.duration
    return replace(merit, weights=np.clip(needed, least, merit.weights))


def _merit(merit: Merit, program: NonlinearProgram, z: Array) -> float:
    """Merit of an iterate with the rows of a program, but for the smoothing."""
    own = replace(merit, rows=program.rows, smoothing=0.0)
    return own(z, program.evaluate(z), None)
