"""Other objectives than time: another motion of the one that was found.

The motion is taken up on its own grid, or on one with some of its intervals halved, and
improved for the other objective. Its replay tells what is missing: rows for links that
touch, else a finer grid. Where nothing comes of it, the motion is left as it was.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace

from tominpmp.arrays import Array
from tominpmp.linear_programs import make_solver
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.control_period import on_ticks
from tominpmp.planner.first_program import rested
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import NUMERICAL, REPAIRS, Work, made
from tominpmp.solution import Solution
from tominpmp.solvers.exchange import RowExchange
from tominpmp.solvers.loop import solve
from tominpmp.solvers.objective import Objective
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import IterationRecord, Status
from tominpmp.stopping import Stop, bounded, seconds_left
from tominpmp.transcription.layout import Layout
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

logger = logging.getLogger(__name__)

# Time for the replay of what was found, in multiples of what the last one took.
REPLAYS = 2.0


def another_motion(
    solution: Solution,
    layout: Callable[[int], Layout],
    objective: Callable[[NonlinearProgram, Array], tuple[Objective, Array]],
) -> Candidate:
    """Make another motion of the one of a solution, on finer grids until it holds.

    Args:
        solution: The solution.
        layout: Grid of the other motion, whose intervals are halved a number of times.
        objective: What is to be least, and where to begin, from a program and the
            motion as its iterate.
    """
    options, problem, former = solution.options, solution.problem, solution.trajectory
    assert former is not None  # noqa: S101
    replay = 0.0 if solution.verification is None else solution.verification.seconds

    def seen(_: IterationRecord) -> Status | None:
        return Status.TIME_LIMIT if seconds_left() < REPLAYS * replay else None

    def make(tried: ProblemFunctions, halvings: int, _: Candidate | None) -> Candidate:
        of, z = layout(halvings).represented(tried, former)
        program, z = rested(NonlinearProgram.of(of).at(z), z)
        least, start = objective(program, z)
        step, stop = trust_regions(options, make_solver("piqp"))
        exchange = RowExchange(level=0.0)
        result = solve(
            program, least, start, step, stop, exchange=exchange, callback=seen
        )
        found = Candidate.of("former motion", result.program, former, result)
        if options.control_period is not None:
            motion = on_ticks(found.trajectory, options.control_period)
            found = replace(found, trajectory=motion)
        return found.verified(problem, options)

    system = ProblemFunctions.of(problem.alternative_of(former))
    work = Work(system, "former motion", make, REPAIRS)
    return made(PlanState(problem, options), work)


def bettered(
    solution: Solution, doing: str, kept: str, work: Callable[[], Solution | str]
) -> Solution:
    """What a stage makes of a solution, within the time of a plan.

    Args:
        solution: The solution.
        doing: What is done to its motion, in a few words.
        kept: What is said of the motion where it is left as it was.
        work: Makes the better solution, or says why there is none.
    """
    begin, status = time.perf_counter(), None
    try:
        with bounded(solution.options.time_limit):
            found = work()
    except (Stop, KeyboardInterrupt) as stop:
        if isinstance(stop, Stop) and not stop.requested:
            found = f"there was no time for {doing}."
        else:
            found, status = "this was interrupted.", Status.INTERRUPTED
    except NUMERICAL as error:
        logger.warning("%s failed: %r", doing, error)
        found = f"{doing} failed ({type(error).__name__})."
    if isinstance(found, str):
        found = replace(solution, message=f"{solution.message} {kept}: {found}")
    seconds = solution.planning_time + time.perf_counter() - begin
    return replace(found, status=status or found.status, planning_time=seconds)
