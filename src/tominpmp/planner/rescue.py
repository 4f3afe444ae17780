"""Rescue of a candidate: what it has found when it is cut short, or fails."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from tominpmp.exceptions import TominpmpError
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.plan_state import Kept, PlanState
from tominpmp.problem import Problem
from tominpmp.solvers.iterate import SlpResult
from tominpmp.status import Status
from tominpmp.stopping import Stop
from tominpmp.transcription.problem_functions import ProblemFunctions

logger = logging.getLogger(__name__)

# How much slower a guess is made to be a motion, where there is nothing better, and
# what violation will do: of none of the limits does it use more than it may.
SLOWER = (1.0, 1.1, 1.25, 1.5, 2.0, 3.0, 5.0, 10.0)
SLOW_ENOUGH = 1e-6

# What is said of a motion that is kept, as something failed that followed.
KEPT = "A later stage failed ({}), and this was kept."
# What numerics may end with. A failure after a motion was found does not lose it.
NUMERICAL = (ArithmeticError, ValueError, RuntimeError, MemoryError)


def keep_best_on_interrupt(
    problem: Problem,
    options: Options,
    progress: PlanState,
    name: str,
    work: Callable[[], Candidate | None],
) -> Candidate | None:
    """Make a candidate; cut short, or failed, it is what it has found by then.

    Args:
        problem: What the candidate is to solve.
        options: Options of the plan.
        progress: Has kept what was found.
        name: What the candidate begins with.
        work: Makes the candidate.

    Returns:
        The candidate; None if it led to nothing at all.

    Raises:
        TominpmpError: If that is what the candidate ended with, and nothing was found
            by it or before.
    """
    try:
        candidate = work()
        if candidate is not None and candidate.verification is not None:
            progress.replayed(candidate.verification.seconds)
        return candidate
    except (Stop, KeyboardInterrupt) as stop:
        return _rescued(problem, options, progress, name, progress.stopped(stop))
    except (*NUMERICAL, TominpmpError) as error:
        found = any(item.feasible for item in progress.kept)
        if isinstance(error, TominpmpError) and not found and progress.best == np.inf:
            raise
        logger.warning("start %d failed: %r", progress.start, error)
        if not found:
            progress.failures.append(error)
            return None
        failed = Status.NUMERICAL_FAILURE
        candidate = _rescued(problem, options, progress, name, failed)
        if candidate is None or not candidate.found:
            return candidate
        kept = KEPT.format(type(error).__name__)
        return replace(candidate, status=Status.FEASIBLE, remark=kept)


def improvement_of(
    problem: Problem,
    options: Options,
    progress: PlanState,
    best: Candidate,
    work: Callable[[ProblemFunctions], Candidate | None],
) -> Candidate | None:
    """Make another candidate of a motion that was found, and keep it on an interrupt.

    Args:
        problem: What it solves.
        options: Options of the plan.
        progress: Has kept what was found.
        best: What led to the motion.
        work: Makes the candidate, from the functions of the goal that the motion meets.
    """
    system = ProblemFunctions.of(problem.alternative_of(best.trajectory))
    progress.share(1)
    progress.begin()
    return keep_best_on_interrupt(
        problem, options, progress, best.name, partial(work, system)
    )


def _rescued(
    problem: Problem, options: Options, progress: PlanState, name: str, status: Status
) -> Candidate | None:
    """The best of what a candidate has found, replayed in a little time.

    Args:
        problem: What the candidate is to solve.
        options: Options of the plan.
        progress: Has kept what was found, and knows how much time there is.
        name: What the candidate began with.
        status: How it ended.

    Returns:
        The newest motion that its replay confirms. Without one, what it began with, if
        it need only be slowed down and nothing else is known; else the newest that was
        found. None if there is nothing.
    """
    if not progress.kept:
        return None
    first, *_ = progress.kept
    initial = first.program.trajectory(first.iterate.z)
    feasible = [item for item in reversed(progress.kept) if item.feasible]
    last: Candidate | None = None
    with progress.saving():
        if not feasible and progress.best == np.inf and progress.begun is not None:
            with contextlib.suppress(Stop, *NUMERICAL):
                slow = slowed_down(progress.begun)
                feasible = [] if slow is None else [slow]
        for item in feasible or progress.kept[-1:]:
            best = item.iterate if item.feasible else None
            records = tuple(progress.records)
            result = SlpResult(status, item.iterate, best, records, item.program)
            try:
                candidate = Candidate.of(name, item.program, initial, result)
                last = last or candidate
                candidate = candidate.verified(problem, options)
            except (Stop, KeyboardInterrupt) as again:
                progress.stopped(again)
                # That one was refuted says nothing of those there was no time for.
                return last and replace(last, verification=None)
            except (*NUMERICAL, TominpmpError) as error:
                logger.warning("what was found could not be replayed: %r", error)
                continue
            if candidate.found:
                return candidate
            last = candidate
    return last


def slowed_down(begun: Kept) -> Kept | None:
    """What a candidate began with, as slow as it has to be; None if that is no cure."""
    program, iterate, _ = begun
    for factor in SLOWER:
        z = program.time_scale(iterate.z, factor)
        slow = replace(iterate, z=z, values=program.evaluate(z))
        if slow.violation <= SLOW_ENOUGH:
            return Kept(program, slow, True)
    return None
