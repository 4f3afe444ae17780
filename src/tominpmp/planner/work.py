"""Work of a plan: make a candidate, replay it, repair it, and save it on a stop."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from tominpmp.exceptions import TominpmpError
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate, KeptIterate
from tominpmp.solvers.objective import RESTORABLE
from tominpmp.status import STOPPED, Status
from tominpmp.stopping import Stop, check
from tominpmp.transcription.exchange import LEAST
from tominpmp.transcription.problem_functions import PADDING, ProblemFunctions
from tominpmp.verification.verification import LONGEST

if TYPE_CHECKING:
    from tominpmp.planner.plan_state import PlanState

logger = logging.getLogger(__name__)

# Most doublings of the grid of a candidate whose replay breaks limits: motions by
# collocation need short intervals, and other grids are rarely doubled twice.
REPAIRS = 4
# Time-scaling factors at which a fallback is tried.
FACTORS = (1.0, 1.02, 1.05, 1.1, 1.2, 1.5, 3.0, 10.0)
# Share of the padding of clearances that is left where it is too much.
LESS_PADDING = 0.3

# Remark on a motion that was saved after a later stage failed.
STAGE_FAILED = "A later stage failed ({}), and this was kept."
# Numerical errors. The motions found before such an error are not lost.
NUMERICAL = (ArithmeticError, ValueError, RuntimeError, MemoryError)

# Makes a candidate from the functions of the problem, the number of doublings of its
# grid, and the candidate to be repaired, which is None in the first try.
Make = Callable[[ProblemFunctions, int, Candidate | None], Candidate]


@dataclass(frozen=True, eq=False)
class Work:
    """One candidate to be made.

    Attributes:
        system: Functions of the problem, which has one goal.
        make: Makes the candidate.
        repairs: Most doublings of the grid if the replay breaks limits; None for a
            candidate that a process has made and repaired.
        self_collision_rows: Whether the first program has rows against self-collision,
            as links of a single arm touch in the guess; otherwise they are added once
            links touch in the replay.
        replay: Whether the candidate is replayed. Candidates of coarse grids are not;
            they are kept only as a fallback.
        follows: The predecessor whose motion is improved; None without one.
    """

    system: ProblemFunctions
    make: Make
    repairs: int | None = 0
    self_collision_rows: bool = False
    replay: bool = True
    follows: Candidate | None = None


T = TypeVar("T")
# A coroutine that yields work, and is sent the candidate made from it, or None.
Schedule = Generator[Work, Candidate | None, T]


def run(state: PlanState, schedule: Schedule[None]) -> Status | None:
    """Carry out a schedule, until planning ends or any feasible motion will do.

    After a stop or a failure, the best kept iterate of work is its candidate. All
    candidates are appended to those of the plan, unless they are only fallbacks.

    Returns:
        How planning was stopped; None if it was not.
    """
    candidate: Candidate | None = None
    try:
        while state.ended is None and not state.satisfied:
            work = schedule.send(candidate)
            state.begin(work.system.problem)
            try:
                state.deadline.check()
                candidate = make_and_repair(state, work)
            except (Stop, KeyboardInterrupt) as stop:
                candidate = _from_iterates(state, work, state.stopped(stop))
            except (*NUMERICAL, TominpmpError) as error:
                candidate = _after_failure(state, work, error)
            if candidate is not None:
                candidate = _kept(state, work, candidate)
        schedule.close()
    except StopIteration:
        return None
    except (Stop, KeyboardInterrupt) as stop:
        return state.stopped(stop)
    return state.ended


def single(work: Work) -> Schedule[None]:
    """The schedule of one piece of work."""
    yield work


def _kept(state: PlanState, work: Work, candidate: Candidate) -> Candidate:
    """Keep a candidate of the plan, or of a coarse grid as a fallback."""
    logger.info("start %d: %s", state.start, candidate.status.value)
    if candidate.status in STOPPED:
        state.cut_short = state.cut_short or candidate.status
    if work.follows is not None:
        candidate = candidate.after(work.follows)
    if work.replay or candidate.confirmed:
        state.candidates.append(candidate)
    else:
        _keep_fallback(state)
    return candidate


def make_and_repair(state: PlanState, work: Work) -> Candidate:
    """Make a candidate and replay it; repair and repeat if the replay breaks limits.

    If links of a single arm touch, the repair adds rows against self-collision;
    otherwise it doubles the grid. A candidate that lacks only the padding of
    clearances, as in passages that are narrower, is improved with less padding.

    Args:
        state: The plan, which records how long a replay takes.
        work: The work.
    """
    complete = work.system
    system = complete if work.self_collision_rows else complete.without_self_collision
    best, former, doublings, padding = None, None, 0, PADDING
    while True:
        candidate = work.make(system, doublings, former)
        if work.replay and candidate.verification is None:
            # The reserved time is meant for this replay.
            with state.saving():
                candidate = candidate.verified(complete.problem, state.options)
                if candidate.refuted and candidate.coarser is not None:
                    # On very short intervals rounding may break a limit that the longer
                    # ones keep.
                    coarser = candidate.coarser
                    candidate = coarser.verified(complete.problem, state.options)
        if candidate.verification is not None:
            state.replayed(candidate.verification.seconds)
        worse = best is not None and candidate.excess > best.excess
        if best is not None and doublings and (worse or not candidate.feasible):
            return best  # on shorter intervals, rounding does more harm than good
        former = best = candidate if best is None else candidate.after(best)
        if work.repairs is None or best.status in STOPPED or best.dropped:
            return best
        if not best.feasible and _lacks_padding(best, system.reach, padding):
            padding *= LESS_PADDING
            system = complete = complete.padded(LESS_PADDING)
            continue
        if not best.refuted or best.trajectory.duration > LONGEST:
            return best
        # The iterates that led to the refuted motion need no replay after a stop.
        kept = state.kept_iterates
        state.kept_iterates = [item._replace(feasible=False) for item in kept]
        if best.touches and system is not complete:
            system = complete
            # A final configuration that is free may have drifted to where links touch.
            former = None if system.final_configuration is None else best
        elif doublings == work.repairs or (best.touches and system.clearance is None):
            return best
        else:
            doublings += 1


def _lacks_padding(candidate: Candidate, reach: float, padding: float) -> bool:
    """Whether an infeasible candidate violates the padding [m] most."""
    missing = candidate.missing_clearance
    return candidate.violation == missing and LEAST < reach * missing <= padding


def _after_failure(state: PlanState, work: Work, error: Exception) -> Candidate | None:
    """The candidate of work that ended with an error, from its kept iterates."""
    logger.warning("start %d failed: %r", state.start, error)
    if not any(item.feasible for item in state.kept_iterates):
        state.failures.append(error)
        return None
    candidate = _from_iterates(state, work, Status.NUMERICAL_FAILURE)
    if candidate is None or not candidate.confirmed:
        return candidate
    remark = STAGE_FAILED.format(type(error).__name__)
    return replace(candidate, status=Status.FEASIBLE, remark=remark)


def _from_iterates(state: PlanState, work: Work, status: Status) -> Candidate | None:
    """The best kept iterate as a candidate, replayed within the grace period.

    Returns:
        The newest feasible iterate whose replay keeps all limits; if there is none, the
        last one tried. Without feasible iterates it is the newest one; None if no
        iterate was kept.
    """
    system = work.system
    feasible = [item for item in reversed(state.kept_iterates) if item.feasible]
    last: Candidate | None = None
    with state.saving():
        for item in feasible or state.kept_iterates[-1:]:
            try:
                last = item.candidate(status)
                # A motion that lacks only padding may keep all limits of the problem.
                usable = last.feasible or _lacks_padding(last, system.reach, PADDING)
                candidate = replace(last, feasible=usable)
                candidate = candidate.verified(system.problem, state.options)
            except (Stop, KeyboardInterrupt) as again:
                state.stopped(again)
                return last  # unconfirmed: its replay was cut short
            except (*NUMERICAL, TominpmpError) as error:
                logger.warning("a kept motion could not be replayed: %r", error)
                continue
            if candidate.confirmed:
                return candidate
            last = replace(candidate, feasible=last.feasible)
    return last


def _keep_fallback(state: PlanState) -> None:
    """Keep the motion of work on a coarse grid as fallback, the best one first.

    Beside an incumbent only the best one may be of use, and the programs of all
    candidates of a long search would fill the memory.
    """

    def order(item: KeptIterate) -> tuple[bool, float]:
        return item.iterate.violation > RESTORABLE, item.iterate.duration

    fallbacks = sorted([*state.fallbacks, state.kept_iterates[-1]], key=order)
    state.fallbacks = fallbacks if state.incumbent is None else fallbacks[:1]


def use_fallback(state: PlanState, status: Status) -> None:
    """Slow a coarse motion, or a first guess, down until its replay holds.

    Args:
        state: The plan. If it has an incumbent, only the best coarse motion is tried,
            if it is faster.
        status: How planning was stopped; FEASIBLE if it was not.
    """
    best = state.best_duration
    errors = state.failures[-1:]
    remark = "".join(STAGE_FAILED.format(type(error).__name__) for error in errors)
    tried: list[Candidate] = []
    with state.saving():
        try:
            for fallback in _fallbacks(state):
                candidate = replace(fallback.candidate(status), remark=remark)
                if candidate.trajectory.duration >= best:
                    continue
                tried.append(candidate)
                try:
                    tried[-1] = _scaled(fallback, candidate, state.options)
                except NUMERICAL as error:
                    logger.warning("a guess could not be slowed down: %r", error)
                if tried[-1].confirmed:
                    break
        except (Stop, KeyboardInterrupt) as stop:
            state.stopped(stop)
    if tried and tried[-1].confirmed:
        state.candidates.append(tried[-1])
    elif tried and not state.candidates:
        failed = Status.INFEASIBLE if status is Status.FEASIBLE else status
        state.candidates.append(replace(tried[0], status=failed))


def _fallbacks(state: PlanState) -> Iterator[KeptIterate]:
    """Motions to be slowed down, the most promising first.

    The best motion on a coarse grid may lack clearance, which slowing down does not
    restore. Paths around obstacles keep it.
    """
    first, others = state.fallbacks[:1], state.fallbacks[1:]
    yield from first
    if state.best_duration == np.inf:
        yield from (item for item in others if item.feasible)
        with suppress(*NUMERICAL, TominpmpError):
            yield from (follow() for follow in state.paths.values())
        yield from state.first_guesses.values()
        yield from (item for item in others if not item.feasible)


def _scaled(fallback: KeptIterate, candidate: Candidate, options: Options) -> Candidate:
    """A fallback slowed down until its program and its replay keep all limits."""
    program, problem = fallback.program, fallback.problem
    moving = problem.checker.moving
    if candidate.missing_clearance > options.feasibility and not moving:
        return candidate  # on the same path, links touch at any speed
    for factor in FACTORS:
        check()
        z = program.time_scale(fallback.iterate.z, factor)
        if program.rows.largest_violation(program.evaluate(z)) > options.feasibility:
            continue
        motion = program.trajectory(z)
        candidate = replace(candidate, trajectory=motion, layout=None, feasible=True)
        candidate = candidate.verified(problem, options)
        if candidate.confirmed or (candidate.touches and not moving):
            break
    return candidate
