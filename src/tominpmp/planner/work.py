"""Work of a plan: a candidate is made, replayed, repaired, and saved on a stop."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from tominpmp.exceptions import TominpmpError
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate, Fallback, Kept
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.objective import TIME_SCALINGS
from tominpmp.status import STOPPED, Status
from tominpmp.stopping import Stop, check
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.verification.verification import LONGEST

if TYPE_CHECKING:
    from tominpmp.planner.plan_state import PlanState

logger = logging.getLogger(__name__)

# Doublings of the grid of a motion whose replay does not hold.
REPAIRS = 2
# Largest time scaling that makes an initial guess feasible where there is no incumbent,
# and the number of factors up to it that are tried.
SLOWEST, FACTORS = 10.0, 12
# Largest violation of a motion that is nearly feasible.
NEARLY = 1e-2

# Remark on a motion that is kept, as a later stage failed.
KEPT = "A later stage failed ({}), and this was kept."
# Errors of numerics. A failure after a motion was found does not lose it.
NUMERICAL = (ArithmeticError, ValueError, RuntimeError, MemoryError)

# Makes a candidate from the functions of the problem, the number of doublings of its
# grid, and the candidate whose replay did not hold.
Make = Callable[[ProblemFunctions, int, Candidate | None], Candidate]


@dataclass(frozen=True, eq=False)
class Work:
    """One candidate to be made.

    Attributes:
        system: Functions of the problem it solves, which has one goal.
        name: Name of the motion it begins with.
        make: Makes the candidate.
        repairs: How often the grid is doubled at most where its replay does not hold.
        self_collision_rows: Whether the first program has them already; else they are
            added once links of a single arm touch in the replay.
        replay: Whether the candidate is replayed; those of coarse grids are not, and
            are kept as a fallback only.
        follows: The candidate that it goes on from.
        cutoff: The candidate is kept only if its duration is shorter [s].
    """

    system: ProblemFunctions
    name: str
    make: Make
    repairs: int = 0
    self_collision_rows: bool = False
    replay: bool = True
    follows: Candidate | None = None
    cutoff: float = np.inf

    @classmethod
    def from_best(cls, state: PlanState, best: Candidate, make: Make) -> Work:
        """Work that goes on from the best motion, with the goal that it meets."""
        system = ProblemFunctions.of(state.problem.alternative_of(best.trajectory))
        return cls(system, best.name, make, self_collision_rows=best.clearance_rows)


T = TypeVar("T")
# A coroutine: yields the next work, and is sent the candidate made of it, or None.
Schedule = Generator[Work, Candidate | None, T]


def run(state: PlanState, work: Work) -> Candidate | None:
    """Make a candidate; after a stop or a failure, from its kept iterates.

    Returns:
        The candidate; ``state`` keeps it, unless it misses the cutoff or is kept as a
        fallback. None if there is no motion at all.
    """
    state.begin()
    candidate: Candidate | None
    try:
        state.deadline.check()
        candidate = made(state, work)
    except (Stop, KeyboardInterrupt) as stop:
        candidate = _rescued(state, work, state.stopped(stop))
    except (*NUMERICAL, TominpmpError) as error:
        candidate = _failed(state, work, error)
    _keep_first_guess(state, work)
    if candidate is None:
        return None
    logger.info("start %d: %s", state.start, candidate.status.value)
    if candidate.status in STOPPED:
        state.cut_short = state.cut_short or candidate.status
    if work.follows is not None:
        candidate = candidate.after(work.follows)
    if not (work.replay or candidate.found):
        _keep_fallback(state, work, candidate)
    elif candidate.duration < work.cutoff or work.cutoff == np.inf:
        state.candidates.append(candidate)
    return candidate


def made(state: PlanState, work: Work) -> Candidate:
    """Make a candidate, and again with the rows or knots that its replay lacks.

    Where links of a single arm touch, these are rows for them; else a finer grid.

    Args:
        state: The plan; it learns how long a replay takes.
        work: The work.
    """
    complete = work.system
    system = complete if work.self_collision_rows else complete.without_self_collision
    best, doublings = None, 0
    while True:
        candidate = work.make(system, doublings, best)
        if work.replay and candidate.verification is None:
            # The time that is reserved is that of a replay.
            with state.saving():
                candidate = candidate.verified(complete.problem, state.options)
                if candidate.refuted and candidate.coarser is not None:
                    # Short intervals may break by rounding what longer ones keep.
                    coarser = candidate.coarser
                    candidate = coarser.verified(complete.problem, state.options)
        if candidate.verification is not None:
            state.replayed(candidate.verification.seconds)
        worse = best is not None and candidate.excess > best.excess
        if best is not None and doublings and (worse or not candidate.feasible):
            return best  # shorter intervals break more by rounding than they mend
        best = candidate if best is None else candidate.after(best)
        if not best.refuted or best.status in STOPPED or best.dropped:
            return best
        if best.trajectory.duration > LONGEST:
            return best
        if best.touches and system is not complete:
            system = complete
        elif doublings == work.repairs or (best.touches and system.clearance is None):
            return best
        else:
            doublings += 1


def _failed(state: PlanState, work: Work, error: Exception) -> Candidate | None:
    """The motion found by work that ended with an error."""
    logger.warning("start %d failed: %r", state.start, error)
    if not any(item.feasible for item in state.kept):
        state.failures.append(error)
        return None
    candidate = _rescued(state, work, Status.NUMERICAL_FAILURE)
    if candidate is None or not candidate.found:
        return candidate
    kept = KEPT.format(type(error).__name__)
    return replace(candidate, status=Status.FEASIBLE, remark=kept)


def _rescued(state: PlanState, work: Work, status: Status) -> Candidate | None:
    """The best kept iterate of a candidate, replayed in the time of grace.

    Returns:
        The newest feasible iterate whose replay holds; without a feasible iterate, the
        newest one. None if no iterate was kept.
    """
    if not state.kept:
        return None
    initial = state.begun or state.kept[0]
    feasible = [item for item in reversed(state.kept) if item.feasible]
    last: Candidate | None = None
    with state.saving():
        for item in feasible or state.kept[-1:]:
            try:
                last = _as_candidate(work.name, item, initial, status)
                last = replace(last, history=tuple(state.records))
                candidate = last.verified(work.system.problem, state.options)
            except (Stop, KeyboardInterrupt) as again:
                state.stopped(again)
                return last  # its replay is not known
            except (*NUMERICAL, TominpmpError) as error:
                logger.warning("a kept motion could not be replayed: %r", error)
                continue
            if candidate.found:
                return candidate
            last = candidate
    return last


def _as_candidate(name: str, kept: Kept, initial: Kept, status: Status) -> Candidate:
    """The candidate of a kept iterate, which is not replayed yet."""
    program, iterate, feasible = kept
    best = iterate if feasible else None
    result = SlpResult(status, iterate, best, (), program)
    begun = initial.program.trajectory(initial.iterate.z)
    return Candidate.of(name, begun, result)


def _slowed_down(begun: Kept, feasibility: float) -> Kept | None:
    """A motion, as slow as its limits ask for; None if that is no cure."""
    program, iterate, _ = begun
    for factor in np.geomspace(1.0, SLOWEST, FACTORS).tolist():
        check()
        z = program.time_scale(iterate.z, factor)
        slow = replace(iterate, z=z, values=program.evaluate(z))
        if slow.violation <= feasibility:
            return Kept(program, slow, True)
    return None


def _keep_first_guess(state: PlanState, work: Work) -> None:
    """Keep the guess that was the first for its goal, as a last resort."""
    problem, guess = work.system.problem, state.begun
    known = any(given is problem for _, _, given in state.first_guesses)
    if guess is not None and not known:
        state.first_guesses.append((work.name, guess, problem))


def _keep_fallback(state: PlanState, work: Work, candidate: Candidate) -> None:
    """Keep the best motion of a coarse grid."""

    def order(one: Candidate) -> tuple[bool, float]:
        return one.violation > NEARLY, one.trajectory.duration

    if state.fallback is None or order(candidate) < order(state.fallback.candidate):
        problem = work.system.problem
        state.fallback = Fallback(candidate, state.kept[-1], problem)


def use_fallback(state: PlanState, status: Status) -> None:
    """Replay the best coarse motion, or a first guess, slowed down until it holds.

    Args:
        state: The plan, which has not found another motion.
        status: How it was stopped, or FEASIBLE.
    """
    coarse = () if state.fallback is None else (state.fallback,)
    guesses = (
        Fallback(_as_candidate(name, kept, kept, status), kept, problem)
        for name, kept, problem in state.first_guesses
    )
    failed = state.failures[-1:]
    remark = "".join(KEPT.format(type(error).__name__) for error in failed)
    tried: list[Candidate] = []
    with state.saving():
        for fallback in chain(coarse, guesses):
            candidate = replace(fallback.candidate, status=status, remark=remark)
            try:
                candidate = _time_scaled(fallback, candidate, state.options)
            except (Stop, KeyboardInterrupt) as stop:
                state.stopped(stop)
                tried.append(replace(candidate, verification=None))
                break
            except NUMERICAL as error:
                logger.warning("a guess could not be slowed down: %r", error)
            tried.append(candidate)
            if candidate.found:
                break
    if tried and (tried[-1].found or not state.candidates):
        state.candidates.append(tried[-1] if tried[-1].found else tried[0])


def _time_scaled(
    fallback: Fallback, candidate: Candidate, options: Options
) -> Candidate:
    """A candidate, as slow as its limits and its replay ask for."""
    _, kept, problem = fallback
    slow = _slowed_down(kept, options.feasibility)
    if slow is None:
        return candidate
    for factor in TIME_SCALINGS:
        z = slow.program.time_scale(slow.iterate.z, factor)
        motion = slow.program.trajectory(z)
        candidate = replace(candidate, trajectory=motion, layout=None, feasible=True)
        candidate = candidate.verified(problem, options)
        if candidate.found:
            break
    return candidate
