"""Switching refinement: from a motion on a grid to exact switching times."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from tominpmp.exact.detection import arcs_of, constant_signs, without_friction
from tominpmp.exact.perturbed_starts import (
    on_grid,
    perturbed_motions,
    single_motor_motions,
)
from tominpmp.exact.structure import Arcs
from tominpmp.exact.switching_times import (
    OptimisedArcs,
    States,
    refine_arcs,
    sharpen,
)
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.plan_state import PlanState
from tominpmp.solvers.iterate import SlpResult
from tominpmp.status import IterationRecord, Status
from tominpmp.stopping import EVALUATIONS, Budget
from tominpmp.transcription.controls import driven_joints
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.problem_functions import ProblemFunctions

logger = logging.getLogger(__name__)

# Largest number of unknowns of a refinement, whose quadratic programs are dense.
MOST_UNKNOWNS = 160
# Numbers of intervals of finer grids on which the plan is optimised again if its own
# grid does not lead to feasible arcs, and iterations on them.
GRIDS = (60, 90)
GRID_ITERATIONS = 30
# Largest relative excess of the duration of a refined motion over that of the plan, and
# over that of a plan that its replay does not confirm.
LONGER = 1e-6
UNCONFIRMED = 0.02
# Number of perturbed paths that are tried, evaluations of the dynamics for each path,
# and largest number of motors for which perturbed paths are tried.
TRIES = 12
TRY_EVALUATIONS = 40_000
EXPLORED_MOTORS = 3
# Time limit of a refinement [s], for at most EXPLORED_MOTORS motors and for more.
PATIENCE = 45.0
PATIENCE_OF_MANY = 20.0
KEPT = (
    "No exact switching was found that is faster and that the replay confirms: the "
    "motion on the grid was kept."
)
TURNING = (
    "Its switches were not placed exactly: that is not done where a joint with dry "
    "friction turns on the way."
)
# Motions that are shorter by less than this share count as equal.
SAME = 1e-6


@dataclass
class Search:
    """Search for arcs of locally optimal motions.

    Attributes:
        system: The functions of the problem.
        progress: State of the plan, which receives records and incumbents.
        budget: Budget of the whole search.
        limit: Largest duration of a useful motion [s].
        found: Incumbents, each faster than its predecessors.
    """

    system: ProblemFunctions
    progress: PlanState
    budget: Budget
    limit: float
    found: list[OptimisedArcs] = field(default_factory=list)

    @property
    def duration(self) -> float:
        """Duration to beat [s]."""
        return self.found[-1].duration * (1.0 - SAME) if self.found else self.limit

    def record(self, record: IterationRecord) -> Status | None:
        """Callback of optimisations on grids; a status ends the iteration."""
        status = self.progress.see(record)
        return status or (Status.TIME_LIMIT if self.budget.spent else None)

    def optimise(self, arcs: Arcs, states: States, evaluations: int) -> bool:
        """Optimise approximate arcs; returns whether the motion is short enough.

        Args:
            arcs: The arcs.
            states: States (q, v) at times, shape (m,) to (m, 2n), as a guess.
            evaluations: Largest number of evaluations of the dynamics.
        """
        if arcs.count + int(arcs.free.sum()) > MOST_UNKNOWNS or self.budget.spent:
            return False
        budget = self.budget.share(evaluations)
        motion = refine_arcs(self.system, arcs, states, budget)
        if motion is None:
            return False
        logger.debug("%d arcs: %.9g s", motion.arcs.count, motion.duration)
        if motion.duration <= self.duration:
            self.found.append(motion)
            self.progress.keep(motion.program, motion.iterate)
        return motion.duration <= self.limit

    def optimise_motion(self, trajectory: Trajectory, evaluations: int) -> bool:
        """Detect the arcs of a motion and optimise them, see :meth:`optimise`."""
        arcs = arcs_of(self.system, trajectory)
        # The state (q, v) is the first two fields of a sample.
        return self.optimise(
            arcs, lambda times: np.hstack(trajectory(times)[:2]), evaluations
        )


def exact_switches(
    system: ProblemFunctions, options: Options, attempt: Candidate, progress: PlanState
) -> Candidate:
    """Optimise the switching times of a motion exactly.

    Args:
        system: The functions of the problem.
        options: Options of the plan.
        attempt: The candidate with the motion.
        progress: State of the plan, with its time limit and callback.

    Returns:
        A candidate with the refined motion, which its replay confirms; the given
        candidate with a remark, if no such motion was found that is at least as fast.
    """
    plan, smooth = attempt.trajectory, system
    if system.friction is not None:
        signs = constant_signs(system, plan)
        if signs is None:
            return replace(attempt, history=(), remark=TURNING)
        smooth = replace(system, signs=signs)
    few = driven_joints(system).size <= EXPLORED_MOTORS
    budget = Budget(np.inf, PATIENCE if few else PATIENCE_OF_MANY)
    limit = np.inf
    if attempt.feasible:
        # A motion that its replay does not confirm may be slightly too fast; if no arcs
        # are about as fast, a finer grid is better.
        limit = plan.duration * (1.0 + (LONGER if attempt.confirmed else UNCONFIRMED))
    search = Search(smooth, progress, budget, limit)
    _search(search, options, without_friction(smooth, plan))
    for motion in reversed(search.found):
        sharp = sharpen(motion, budget.share())
        iterate, records = sharp.iterate, tuple(progress.records)
        result = SlpResult(Status.CONVERGED, iterate, iterate, records, sharp.program)
        exact = Candidate.of(attempt.name, attempt.initial, result)
        exact = exact.verified(system.problem, options)
        if exact.confirmed:
            return exact
    return replace(attempt, history=(), remark=KEPT)


def _search(search: Search, options: Options, plan: Trajectory) -> None:
    """Optimise arcs of the plan, of perturbed motions, and of finer grids."""
    small = driven_joints(search.system).size <= EXPLORED_MOTORS
    near = search.optimise_motion(plan, TRY_EVALUATIONS if small else EVALUATIONS)
    # No multi-start for options with a single start, nor with assumed velocity signs,
    # which perturbed motions would not have.
    if small and options.starts != 1 and search.system.signs is None:
        _explore(search, options, plan)
    # Arcs near the plan remain of interest even if others were found.
    if small and not near:
        near = search.optimise_motion(plan, EVALUATIONS)
    for trajectory in _finer(search, options, plan):
        if near:
            return
        near = search.optimise_motion(trajectory, EVALUATIONS)


def _explore(search: Search, options: Options, plan: Trajectory) -> None:
    """Multi-start: optimise arcs of perturbed motions."""
    system, budget = search.system, search.budget
    rng = np.random.default_rng(options.seed)
    # A larger option ``starts`` never reduces the number of tries.
    tries = range(max(TRIES, (options.starts or 1) - 1))
    perturbed = perturbed_motions(system, options, search.record, plan, rng)
    for _, trajectory in zip(tries, perturbed, strict=False):
        if budget.spent:
            return
        search.optimise_motion(trajectory, TRY_EVALUATIONS)
    if driven_joints(system).size == 1:
        part = budget.share()
        duration = search.duration if search.found else plan.duration
        for rough in single_motor_motions(system, duration, rng, part):
            search.optimise(rough.arcs.cleaned(), rough.states, TRY_EVALUATIONS)


def _finer(search: Search, options: Options, plan: Trajectory) -> Iterator[Trajectory]:
    """Generate the plan with piecewise constant torques, optimised on finer grids."""
    few = replace(options, max_iterations=min(options.max_iterations, GRID_ITERATIONS))
    for intervals in GRIDS:
        if search.budget.spent:
            return
        ends = np.cumsum(interval_shares("uniform", intervals))
        path = plan(np.append(0.0, ends) * plan.duration).q
        yield on_grid(search.system, few, search.record, path, plan.duration)
