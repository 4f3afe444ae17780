"""Several segments planned one by one, from rest to rest, and joined.

Among obstacles a straight line through the goals of all segments is far from any
motion, and a path around the obstacles is needed on each segment. Alone, each segment
is a problem with one goal, for which the search on coarse grids applies. The joined
motion, which stops at every goal, is the fastest one if all goals are configurations at
which the arm stops. Otherwise the motion is improved as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from tominpmp.goals.joints import JointGoal
from tominpmp.initial_guess.guess import Guess
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.descent import descend, guess_of
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import Schedule, Work, run, use_fallback
from tominpmp.problem.problem import Problem
from tominpmp.problem.sequence import joined
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.problem_functions import ProblemFunctions

# Makes the schedule of a plan for a problem with one goal.
MakeSchedule = Callable[[PlanState, Problem], Schedule[None]]


def can_be_joined(system: ProblemFunctions) -> bool:
    """Whether segments can be planned one by one: neither goals nor obstacles move."""
    scenes = any(part.problem.scene.moving for part in system.parts)
    goals = any(part.problem.goal.ends_moving for part in system.parts[:-1])
    return bool(system.parts) and not (scenes or goals)


def segments_joined(
    system: ProblemFunctions, guess: Guess, state: PlanState, schedule: MakeSchedule
) -> Work:
    """Work that plans each segment alone, joins the motions, and improves the result.

    Args:
        system: Functions of the problem.
        guess: The guess, which has the final configurations of the segments.
        state: The plan.
        schedule: Makes the schedule of a segment.
    """

    def make(
        system: ProblemFunctions, doublings: int, former: Candidate | None
    ) -> Candidate:
        better = guess
        parts = [] if former else _planned_alone(system, guess, state, schedule)
        if parts:
            whole = _as_candidate(system, parts, state)
            if whole.confirmed and _is_separable(system):
                return whole
            if whole.confirmed:
                state.candidates.append(replace(whole, status=Status.STALLED))
            better = guess_of(system, whole)
        return descend(state.options, better, state, None, system, doublings, former)

    return Work(system, make, self_collision_rows=True)


def _is_separable(system: ProblemFunctions) -> bool:
    """Whether the fastest motions of the segments are the fastest motion together."""
    return all(
        part.final_configuration is not None
        and part.problem.goal.stopped is part.problem.goal
        and not part.motion_limits.continuous
        for part in system.parts
    )


def _planned_alone(
    system: ProblemFunctions, guess: Guess, state: PlanState, schedule: MakeSchedule
) -> list[Candidate]:
    """The segments from rest to rest; empty if one of them is not found."""
    found: list[Candidate] = []
    q = system.problem.q_start
    for k, (part, end) in enumerate(zip(system.parts, guess.ends, strict=True)):
        phase = part.problem
        goal = phase.goal.stopped
        if goal.configuration is None:
            goal = JointGoal(end).resolved(phase.robot, q)
        problem = phase._altered(goal=goal, q_start=q)
        others = guess.duration - guess.durations[k]
        seconds = state.remaining_time / (len(system.parts) - k)
        candidate = _alone(problem, state, others, seconds, schedule)
        if candidate is None:
            if state.searches.impasse:
                state.searches.impasse = f"on segment {k + 1}, {state.searches.impasse}"
            return []
        found.append(candidate)
        q = candidate.trajectory.q[-1]
    return found


def _alone(
    problem: Problem,
    state: PlanState,
    others: float,
    seconds: float,
    schedule: MakeSchedule,
) -> Candidate | None:
    """The fastest candidate for one segment; None if no motion is found in time.

    Args:
        problem: The problem of the segment.
        state: The plan of all segments, which sees the iterations.
        others: Estimated duration of the other segments [s].
        seconds: Planning time [s].
        schedule: Makes the schedule of the segment.
    """

    def show(record: IterationRecord) -> bool:
        state(replace(record, duration=record.duration + others))
        return False

    control = state.options.control
    options = replace(
        state.options,
        # The joined motion has one layout, and so accelerations of one kind.
        control="constant" if control == "auto" else control,
        max_planning_time=seconds,
        callback=show,
        starts=None,
        processes=1,
    )
    alone = PlanState(problem, options, stop_requested=lambda: state.deadline.due)
    with alone.deadline.in_force():
        status = run(alone, schedule(alone, problem))
        if alone.incumbent is None:
            use_fallback(alone, status or Status.FEASIBLE)
    state.searches.impasse = alone.searches.impasse
    return alone.incumbent


def _as_candidate(
    system: ProblemFunctions, parts: Sequence[Candidate], state: PlanState
) -> Candidate:
    """The joined motion as a replayed candidate, with the dwells of its segments."""
    dwells = [segment.dwell for segment in system.problem.segments]
    motion = joined([part.trajectory for part in parts], [0.0, *dwells])
    converged = all(part.status is Status.CONVERGED for part in parts)
    status = Status.CONVERGED if converged else Status.STALLED
    rows = system.clearance is not None
    whole = Candidate(status, True, motion, motion, {}, clearance_rows=rows)
    with state.saving():
        return whole.verified(system.problem, state.options)
