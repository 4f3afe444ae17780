"""Switching refinement: from a motion on a grid to arcs of exact length."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from tominpmp.exact.detection import arcs_of, one_way, without_friction
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
from tominpmp.exact.transcription import ArcTranscription
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.plan_state import PlanState
from tominpmp.solvers.iterate import Iterate, SlpResult
from tominpmp.status import IterationRecord, Status
from tominpmp.stopping import EVALUATIONS, Budget
from tominpmp.transcription.controls import driven_joints
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.problem_functions import ProblemFunctions

logger = logging.getLogger(__name__)

# More unknowns than this are left to the grid: the quadratic programs are dense.
MOST_UNKNOWNS = 160
# Grids of torques from which arcs are read where those of the plan lead nowhere, and
# iterations on them.
GRIDS = (60, 90)
GRID_ITERATIONS = 30
# Largest relative excess of a refined motion over the plan, and over a plan that its
# replay does not confirm.
LONGER = 1e-6
UNCONFIRMED = 0.02
# Wild paths that are tried, evaluations of the dynamics for each, and up to how many
# motors there is any hope of finding something.
TRIES = 12
TRY_EVALUATIONS = 40_000
EXPLORED_MOTORS = 3
# Time that a refinement has at most [s], for so few motors and for more.
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
# Motions shorter by less than this share are the same.
SAME = 1e-6


@dataclass
class Search:
    """Locally optimal motions that have been found.

    Attributes:
        system: The functions of the problem.
        progress: Sees records, and keeps what is found.
        budget: What may be spent in all.
        limit: Longer motions are of no use [s].
        found: The motions, each faster than those before.
    """

    system: ProblemFunctions
    progress: PlanState
    budget: Budget
    limit: float
    found: list[OptimisedArcs] = field(default_factory=list)

    @property
    def duration(self) -> float:
        """T to be beaten [s]."""
        return self.found[-1].duration * (1.0 - SAME) if self.found else self.limit

    def seen(self, record: IterationRecord) -> Status | None:
        """See a record of a motion to begin with; a status ends its iteration."""
        status = self.progress.see(record)
        return status or (Status.TIME_LIMIT if self.budget.spent else None)

    def follow(self, arcs: Arcs, states: States, evaluations: int) -> bool:
        """Optimise rough arcs; whether the motion is short enough."""
        if arcs.count + int(arcs.free.sum()) > MOST_UNKNOWNS or self.budget.spent:
            return False
        budget = self.budget.share(evaluations)
        motion = refine_arcs(self.system, arcs, states, budget)
        if motion is None:
            return False
        logger.debug("%d arcs: %.9g s", motion.arcs.count, motion.duration)
        if motion.duration <= self.duration:
            self.found.append(motion)
            self.progress.keep(*_iterate(motion))
        return motion.duration <= self.limit

    def read(self, trajectory: Trajectory, evaluations: int) -> bool:
        """Read arcs off a motion and optimise them, likewise."""
        arcs = arcs_of(self.system, trajectory)
        # States (q, v) are the first two parts.
        return self.follow(
            arcs, lambda times: np.hstack(trajectory(times)[:2]), evaluations
        )


def exact_switches(
    system: ProblemFunctions, options: Options, attempt: Candidate, progress: PlanState
) -> Candidate:
    """Place the switches of a motion exactly.

    Args:
        system: The functions of the problem.
        options: Options of the plan.
        attempt: What led to the motion.
        progress: Time limit and callback.

    Returns:
        The refined motion, which its replay confirms; what was given, with a remark,
        where no such motion was found that is at least as fast.
    """
    plan, granted = attempt.trajectory, system
    if system.friction is not None:
        ways = one_way(system, plan)
        if ways is None:
            return replace(attempt, history=(), remark=TURNING)
        granted = replace(system, ways=ways)
    few = driven_joints(system).size <= EXPLORED_MOTORS
    budget = Budget(np.inf, PATIENCE if few else PATIENCE_OF_MANY)
    limit = np.inf
    if attempt.feasible:
        # A motion that its replay does not confirm may be somewhat too fast; without
        # arcs that are about as fast, a finer grid is better.
        limit = plan.duration * (1.0 + (LONGER if attempt.confirmed else UNCONFIRMED))
    search = Search(granted, progress, budget, limit)
    _look(search, options, without_friction(granted, plan))
    for motion in reversed(search.found):
        arcs, iterate = _iterate(sharpen(granted, motion, budget.share()))
        records = tuple(progress.records)
        result = SlpResult(Status.CONVERGED, iterate, iterate, records, arcs)
        exact = Candidate.of(attempt.name, attempt.initial, result)
        exact = exact.verified(system.problem, options)
        if exact.confirmed:
            return exact
    return replace(attempt, history=(), remark=KEPT)


def _look(search: Search, options: Options, plan: Trajectory) -> None:
    """Look for arcs near to the plan, and elsewhere."""
    small = driven_joints(search.system).size <= EXPLORED_MOTORS
    near = search.read(plan, TRY_EVALUATIONS if small else EVALUATIONS)
    # A single start looks not elsewhere. Where ways are taken for granted, perturbed
    # motions would not go them.
    if small and options.starts != 1 and search.system.ways is None:
        _explore(search, options, plan)
    # What was found elsewhere is no reason to give up what lies near.
    if small and not near:
        near = search.read(plan, EVALUATIONS)
    for trajectory in _finer(search, options, plan):
        if near:
            return
        near = search.read(trajectory, EVALUATIONS)


def _explore(search: Search, options: Options, plan: Trajectory) -> None:
    """Look for arcs elsewhere."""
    system, budget = search.system, search.budget
    rng = np.random.default_rng(options.seed)
    # More starts look at no less than fewer would.
    tries = range(max(TRIES, (options.starts or 1) - 1))
    perturbed = perturbed_motions(system, options, search.seen, plan, rng)
    for _, trajectory in zip(tries, perturbed, strict=False):
        if budget.spent:
            return
        search.read(trajectory, TRY_EVALUATIONS)
    if driven_joints(system).size == 1:
        part = budget.share()
        duration = search.duration if search.found else plan.duration
        for rough in single_motor_motions(system, duration, rng, part):
            search.follow(rough.arcs.cleaned(), rough.states, TRY_EVALUATIONS)


def _finer(search: Search, options: Options, plan: Trajectory) -> Iterator[Trajectory]:
    """The plan with torques that are constant on finer grids."""
    few = replace(options, max_iterations=min(options.max_iterations, GRID_ITERATIONS))
    for intervals in GRIDS:
        if search.budget.spent:
            return
        ends = np.cumsum(interval_shares("uniform", intervals))
        path = plan(np.append(0.0, ends) * plan.duration).q
        yield on_grid(search.system, few, search.seen, path, plan.duration)


def _iterate(motion: OptimisedArcs) -> tuple[ArcTranscription, Iterate]:
    """Optimised arcs as a transcription, and as an iterate of it."""
    arcs = ArcTranscription(motion.program, motion.shot)
    return arcs, Iterate.of(arcs, motion.y, 1.0)
