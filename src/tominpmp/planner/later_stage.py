"""What stages that follow the search have in common: energy, quiet torques.

Each makes another motion of the one that was found, and leaves that as it is where
nothing comes of it.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from tominpmp.arrays import Array
from tominpmp.linear_programs import make_solver
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.work import NUMERICAL, REPAIRS
from tominpmp.solution import Solution
from tominpmp.solvers.exchange import RowExchange
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.loop import solve
from tominpmp.solvers.objective import Objective
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import IterationRecord, Status
from tominpmp.stopping import Stop, bounded, seconds_left
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram
from tominpmp.verification import Verification, verify

logger = logging.getLogger(__name__)

# Time for the replay of what was found, in multiples of what the last one took.
REPLAYS = 2.0

Over = Callable[[], bool]
# Makes a motion on a grid of so many intervals, and says how its iteration ended.
Make = Callable[[ProblemFunctions, int, Over], tuple[Trajectory | None, Status]]


class Made(NamedTuple):
    """What a stage has made.

    Attributes:
        trajectory: The motion.
        status: How its iteration ended.
        verification: Its replay.
    """

    trajectory: Trajectory
    status: Status
    verification: Verification


def bettered(
    solution: Solution,
    work: Callable[[], Solution | str],
    left: Callable[[str], Solution],
    doing: str,
) -> Solution:
    """What a stage makes of a solution, within the time of a plan.

    Args:
        solution: The solution.
        work: Makes the better one, or says why there is none.
        left: The solution as it was, with a reason in its message.
        doing: What is done to the motion, in a few words.
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
        found = left(found)
    seconds = solution.planning_time + time.perf_counter() - begin
    return replace(found, status=status or found.status, planning_time=seconds)


def made(
    solution: Solution,
    former: Trajectory,
    intervals: int,
    make: Make,
) -> Made | None:
    """Make another motion, on finer grids until its replay is all right.

    Args:
        solution: The solution.
        former: Its motion.
        intervals: Of the first grid.
        make: Makes the motion.

    Returns:
        The last motion, whether or not its replay is all right; None if there is none.
    """
    options, problem = solution.options, solution.problem
    replay = 0.0 if solution.verification is None else solution.verification.seconds

    def over() -> bool:
        return seconds_left() < REPLAYS * replay

    complete = ProblemFunctions.of(problem.alternative_of(former))
    system = complete.without_self_collision
    found = None
    for refinement in range(1 + REPAIRS):
        motion, status = make(system, intervals, over)
        if motion is None:
            break
        verdict = verify(problem, motion, options.tolerances, checker=problem.checker)
        found = Made(motion, status, verdict)
        if verdict.ok or over():
            break
        if any(item.kind == "clearance" for item in verdict.violations):
            system = complete  # with rows for the links
        intervals = intervals * 2 ** (refinement + 1)
    return found


def bent(
    program: NonlinearProgram,
    objective: Objective,
    z: Array,
    options: Options,
    over: Over,
) -> SlpResult:
    """Solve a program for an objective that bends, by quadratic programs.

    Args:
        program: The program.
        objective: What is to be least.
        z: Where to begin.
        options: Limits and the trust region.
        over: Tells whether the time is up.
    """

    def seen(_: IterationRecord) -> Status | None:
        return Status.TIME_LIMIT if over() else None

    method = trust_regions(options, make_solver("piqp"))
    exchange = RowExchange(level=0.0)
    return solve(program, objective, z, *method, exchange=exchange, callback=seen)
