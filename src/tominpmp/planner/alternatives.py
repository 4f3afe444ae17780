"""Planning for a set of alternative goals, any of which may be met."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from tominpmp.exceptions import ProblemError
from tominpmp.initial_guess.warm_start import former_motion
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.planner.automatic_options import PROMISE
from tominpmp.planner.barriers import barrier_on_way
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import Schedule
from tominpmp.problem.problem import Problem
from tominpmp.stopping import Stop

# Makes the schedule of starts for a problem with one goal and a former motion, or None.
Starts = Callable[[Problem, Trajectory | Samples | None], Schedule[None]]


def candidates_of_alternatives(
    state: PlanState, starts: Starts, former: Trajectory | Samples | None = None
) -> Schedule[None]:
    """Multi-start over the goals of a set: round robin, one start per goal.

    The goals with the smallest lower bounds come first. As long as there is no
    incumbent, a start may take only its share of the planning time: a goal may be out
    of reach, and that is not always known at once. A goal whose share ends before its
    first start has a larger share in the next round. Goals whose lower bound is not
    below the duration of the incumbent are left out, and full turns that may gain no
    more than PROMISE of it, and goals that a barrier blocks, unless it blocks all.

    Args:
        state: The plan of a problem with one goal or a set of goals.
        starts: Makes the schedule of starts for each goal.
        former: A former motion as warm start, for the goal that it ends nearest to.

    Raises:
        ProblemError: If no goal can be reached at all.
    """
    parts, entered = list(state.problem.alternatives), None
    if len(parts) == 1:
        yield from starts(parts[0], former)
        return
    if former is not None:
        nearest = state.problem.alternative_of(former_motion(state.problem, former))
        places = [_goals(part) for part in (*parts, nearest)]
        entered = places.index(_goals(nearest))
        # Of several segments not all choices of joint angles are alternatives.
        parts = parts if entered < len(parts) else [*parts, nearest]

    def begun(i: int) -> Schedule[None]:
        return starts(parts[i], former if i == entered else None)

    schedules, late = [*map(begun, range(len(parts)))], [0] * len(parts)
    one_place = state.problem.goal.configuration is not None
    worth = 1.0 - PROMISE if one_place else 1.0
    bounds = [state.lower_bound(part).T for part in parts]
    order = sorted(range(len(parts)), key=lambda i: (i != entered, bounds[i]))
    tolerated = state.options.tolerances.contact
    free = [i for i in order if not barrier_on_way(parts[i], tolerated)]
    waiting = deque(free or order)
    answers: list[Candidate | None] = [None] * len(parts)
    wrong: list[str] = []
    while waiting:
        i = waiting.popleft()
        if bounds[i] >= worth * state.best_duration:
            continue
        # Alternatives of one configuration differ by full turns of joints, of which the
        # nearest ones are the likely ones.
        rivals = 1 + len(waiting)
        state.share_time((min(rivals, 2) if one_place else rivals) >> late[i])
        try:
            while True:
                work = schedules[i].send(answers[i])
                answers[i] = yield work
                if work.replay or state.cut_short:
                    break
            waiting.append(i)
        except StopIteration:
            continue
        except Stop as stop:
            state.stopped(stop)
            if state.ended:
                raise
            if answers[i] is None:  # the share of the time ended before a start
                schedules[i], late[i] = begun(i), late[i] + 1
                waiting.append(i)
        except ProblemError as error:
            wrong.append(f"goal {i + 1} of {len(parts)}: {error}")
    if len(wrong) == len(parts):
        raise ProblemError("; ".join(wrong), "goal")


def _goals(problem: Problem) -> list[int]:
    """Identities of the goals of all segments."""
    return [id(phase.goal) for phase in problem.phases]
