"""Work of a plan: make a candidate, replay it, repair it, and save it on a stop."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

from tominpmp.exceptions import TominpmpError
from tominpmp.planner.candidate import Candidate, KeptIterate
from tominpmp.solvers.exchange import restored
from tominpmp.status import STOPPED, Status
from tominpmp.stopping import Stop, check
from tominpmp.transcription.exchange import LEAST
from tominpmp.transcription.problem_functions import PADDING, ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram
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
            state.begin()
            try:
                state.deadline.check()
                candidate = make_and_repair(state, work)
            except (Stop, KeyboardInterrupt) as stop:
                candidate = _from_iterates(state, state.stopped(stop))
            except (*NUMERICAL, TominpmpError) as error:
                candidate = _after_failure(state, error)
            candidate = _added_to_plan(state, work, candidate)
        schedule.close()
    except StopIteration:
        return None
    except (Stop, KeyboardInterrupt) as stop:
        return state.stopped(stop)
    return state.ended


def single(work: Work) -> Schedule[None]:
    """The schedule of one piece of work."""
    yield work


def _added_to_plan(
    state: PlanState, work: Work, candidate: Candidate | None
) -> Candidate | None:
    """Add a candidate to the plan; keep fallbacks beside an unfinished one.

    A later iterate of a confirmed candidate that has not converged may be faster.
    """
    if candidate is None:
        _keep_fallback(state, refuted=False)
        return None
    if not candidate.confirmed or candidate.status is not Status.CONVERGED:
        _keep_fallback(state, refuted=candidate.refuted)
    logger.info("start %d: %s", state.start, candidate.status.value)
    if candidate.status in STOPPED:
        state.cut_short = state.cut_short or candidate.status
    if work.follows is not None:
        candidate = candidate.after(work.follows)
    if work.replay or candidate.confirmed:
        state.candidates.append(candidate)
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
        if best.touches:
            # Links touch on this path at any speed: only its guess is of use.
            kept = state.kept_iterates[-1:]
            state.kept_iterates = [item.initial for item in kept if item.initial]
        if best.touches and system is not complete:
            system = complete
            # A final configuration that is free may have drifted to where links touch.
            former = None if system.final_configuration is None else best
        elif doublings == work.repairs or (best.touches and system.clearance is None):
            return best
        else:
            doublings += 1


def _lacks_padding(candidate: Candidate, reach: float, padding: float) -> bool:
    """Whether an infeasible candidate lacks no more than a padding of clearances [m].

    Other constraints are violated less.
    """
    violations, missing = candidate.violations, reach * candidate.violation
    worst = max(violations, key=violations.__getitem__, default="")
    return worst.startswith("clearance") and LEAST < missing <= padding


def _after_failure(state: PlanState, error: Exception) -> Candidate | None:
    """The candidate of work that ended with an error, from its kept iterates."""
    logger.warning("start %d failed: %r", state.start, error)
    if not any(item.feasible for item in state.kept_iterates):
        state.failures.append(error)
        return None
    candidate = _from_iterates(state, Status.NUMERICAL_FAILURE)
    if candidate is None or not candidate.confirmed:
        return candidate
    remark = STAGE_FAILED.format(type(error).__name__)
    return replace(candidate, status=Status.FEASIBLE, remark=remark)


def _from_iterates(state: PlanState, status: Status) -> Candidate | None:
    """The best kept iterate as a candidate, replayed within the grace period.

    Returns:
        The newest feasible iterate whose replay keeps all limits, slowed down if need
        be; else the last one tried; without feasible iterates the newest one, which is
        a fallback; None if no iterate was kept.
    """
    newest = state.kept_iterates[::-1]
    tried = _slowed(state, (item for item in newest if item.feasible), status)
    # There may have been no time to replay the last one.
    replayed = [item for item in tried if item.verification is not None]
    found = replayed or tried or [item.candidate(status) for item in newest[:1]]
    return found[-1] if found else None


def _keep_fallback(state: PlanState, *, refuted: bool) -> None:
    """Keep the last iterate of work and its guess as fallbacks, the best one first.

    Of a motion whose replay has broken limits, only the guess is kept. Beside an
    incumbent only the best one may be of use, and the programs of all candidates of a
    long search would fill the memory.
    """
    kept = state.kept_iterates if state.cut_short else state.kept_iterates[-1:]
    newest = [item for item in kept if not (refuted and item.feasible)]
    known = [item.iterate for item in kept]
    initial = [item.initial for item in kept[-1:] if item.initial is not None]
    guess = [item for item in initial if item.iterate not in known]
    fallbacks = sorted([*state.fallbacks, *newest, *guess], key=lambda item: item.rank)
    state.fallbacks = fallbacks if state.incumbent is None else fallbacks[:1]


def use_fallback(state: PlanState, status: Status) -> None:
    """Slow a former motion, a path or a guess down until its replay holds.

    Args:
        state: The plan. If it has an incumbent, only the best fallback is tried, once,
            if it is faster.
        status: How planning was stopped; FEASIBLE if it was not.
    """
    errors = state.failures[-1:]
    remark = "".join(STAGE_FAILED.format(type(error).__name__) for error in errors)
    tried = _slowed(state, _fallbacks(state), status)
    if tried and tried[-1].confirmed:
        state.candidates.append(replace(tried[-1], remark=remark))
    elif tried and not state.candidates:
        failed = Status.INFEASIBLE if status is Status.FEASIBLE else status
        state.candidates.append(replace(tried[0], status=failed))


def _fallbacks(state: PlanState) -> Iterator[KeptIterate]:
    """Motions to be slowed down, the most promising first.

    Slowing down does not restore clearances. Paths around obstacles keep them, and
    may be faster than a slowed-down guess.
    """
    if state.incumbent is not None:
        first, state.fallbacks = state.fallbacks[:1], []
        yield from first
        return
    yield from (item for item in state.fallbacks if item.feasible)
    others = [item for item in state.fallbacks if not item.feasible]
    with suppress(*NUMERICAL, TominpmpError):
        others += [follow() for follow in state.paths.values()]
    yield from sorted(others, key=lambda item: item.rank)


def _slowed(
    state: PlanState, kept: Iterable[KeptIterate], status: Status
) -> list[Candidate]:
    """Slow motions down, one after the other, until the replay of one of them holds.

    A warm start that has the ends of the problem is replayed first: restoring and
    slowing down may take all of the grace period.

    Args:
        state: The plan, whose incumbent they must beat.
        kept: The motions.
        status: Status of the candidates.

    Returns:
        The candidates tried within the grace period. Only the last may be confirmed.
    """
    tried: list[Candidate] = []
    with state.saving():
        try:
            state.recall_former(status)
            for item in kept:
                candidate = item.candidate(status)
                if candidate.trajectory.duration >= state.best_duration:
                    continue
                tried.append(candidate)
                try:
                    for scaled in _slower_motions(state, item, candidate):
                        tried[-1] = scaled
                except (*NUMERICAL, TominpmpError) as error:
                    logger.warning("a motion could not be slowed down: %r", error)
                if tried[-1].confirmed:
                    break
        except (Stop, KeyboardInterrupt) as stop:
            state.stopped(stop)
    return tried


def _slower_motions(
    state: PlanState, item: KeptIterate, candidate: Candidate
) -> Iterator[Candidate]:
    """Restore a motion and slow it down until its program and its replay keep limits.

    It is not slowed down to more than the duration of the incumbent. Yields the motion
    of each replay.
    """
    program, problem = item.program, item.program.system.problem
    tolerance = state.options.feasibility
    for factor in FACTORS:
        check()
        slower = item.iterate.on(program, program.time_scale(item.iterate.z, factor))
        if slower.duration >= state.best_duration:
            break
        feasible = slower
        # Programs of exact arcs have no linearisation.
        if slower.violation > tolerance and isinstance(program, NonlinearProgram):
            program, feasible = restored(program, slower)
        kept = item._replace(program=program, iterate=feasible, feasible=True)
        # In passages that are narrower, the padding of clearances is missing.
        if feasible.violation * program.system.reach > PADDING:
            continue
        candidate = kept.candidate(candidate.status).after(candidate)
        candidate = candidate.verified(problem, state.options)
        yield candidate
        # On the same path, links touch at any speed.
        same = feasible is slower and not problem.checker.moving
        if candidate.confirmed or (candidate.touches and same):
            break
