"""refine="switching": from a motion on a grid to arcs of exact length."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tominpmp.options import Options
from tominpmp.refinement.arc_transcription import ArcTranscription
from tominpmp.refinement.explore import explore
from tominpmp.refinement.monitor import Monitor
from tominpmp.refinement.reading import arcs_of, states_of
from tominpmp.refinement.switching import Budget, Settled, refine_arcs
from tominpmp.solution import Status
from tominpmp.solvers.iterate import Iterate, SlpResult
from tominpmp.solvers.lp import LpSolver
from tominpmp.solvers.slp import SlpSolver
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.base import Transcription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.controls import driven_joints
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.system import System

logger = logging.getLogger(__name__)

# More unknowns than this are left to the grid: the quadratic programs are dense.
MOST_UNKNOWNS = 160
# Grids of torques from which arcs are read where those of the plan lead nowhere, and
# iterations on them.
GRIDS = (60, 90)
GRID_ITERATIONS = 30
# A motion this much longer than the plan is none, relatively.
LONGER = 1e-6
# Random structures that are tried, motions that may be integrated for them, and up to
# how many motors there is any hope of finding something.
TRIES = 14
EXPLORING = 1500
EXPLORED_MOTORS = 3


def refine_switching(
    system: System,
    options: Options,
    transcription: Transcription,
    result: SlpResult,
    lp: LpSolver,
    watch: Monitor,
) -> tuple[Transcription, SlpResult]:
    """Place the switches of a motion exactly.

    Args:
        system: The functions of the problem.
        options: Options of the plan.
        transcription: The program of the motion.
        result: Its solution.
        lp: Solver of linear programs.
        watch: Time limit and callback.

    Returns:
        Program and solution of the refined motion; what was given where no better
        motion was found.
    """
    iterate = result.iterate if result.best is None else result.best
    limit = iterate.duration * (1.0 + LONGER) if result.best is not None else np.inf
    best: Settled | None = None
    for trajectory in _motions(system, options, transcription, result, lp, watch):
        found = _refined(system, trajectory, watch)
        if found is not None and found.duration <= limit:
            best = found
            break
    best = _explored(system, options, best, iterate.duration, limit, watch)
    if best is None:
        return transcription, result
    arcs = ArcTranscription(best.program, best.shot)
    values = arcs.evaluate(best.y)
    weights = np.ones(len(arcs.rows.kinds))
    merit = replace(iterate.merit, cost=arcs.cost, rows=arcs.rows, weights=weights)
    refined = Iterate(best.y, values, merit, iterate.region, np.zeros(arcs.rows.size))
    return arcs, SlpResult(Status.CONVERGED, refined, refined, result.history)


def _refined(system: System, trajectory: Trajectory, watch: Monitor) -> Settled | None:
    arcs = arcs_of(system, trajectory)
    if arcs.count + int(arcs.free.sum()) > MOST_UNKNOWNS:
        return None
    budget = Budget(stop=lambda: watch.over)
    return refine_arcs(system, arcs, states_of(trajectory), budget)


def _explored(
    system: System,
    options: Options,
    best: Settled | None,
    duration: float,
    limit: float,
    watch: Monitor,
) -> Settled | None:
    """The best motion after a look at others."""
    motors = driven_joints(system).size
    tries = TRIES if options.starts is None else options.starts - 1
    if motors > EXPLORED_MOTORS or (best is not None and best.at_limits):
        return best
    rng = np.random.default_rng(options.seed)
    budget = Budget(EXPLORING, lambda: watch.over)
    duration = duration if best is None else best.duration
    for found in explore(system, duration, rng, tries, budget):
        if found.duration <= limit:
            best = found
    return best


def _motions(
    system: System,
    options: Options,
    transcription: Transcription,
    result: SlpResult,
    lp: LpSolver,
    watch: Monitor,
) -> Iterator[Trajectory]:
    """Motions to read arcs from: the plan, then torques on finer grids."""
    iterate = result.iterate if result.best is None else result.best
    plan = transcription.trajectory(iterate.z)
    yield plan
    few = replace(options, max_iterations=min(options.max_iterations, GRID_ITERATIONS))
    for intervals in GRIDS:
        if watch.over:
            return
        shares = interval_shares("uniform", intervals)
        grid = CollocationTranscription(system, shares, plan.duration)
        times = np.concatenate([[0.0], np.cumsum(shares)]) * plan.duration
        start = grid.start(plan(times).q, np.array([plan.duration]))
        found = SlpSolver(grid, few, 1e-4 * plan.duration, lp, watch).run(start)
        last = found.iterate if found.best is None else found.best
        yield grid.trajectory(last.z)
