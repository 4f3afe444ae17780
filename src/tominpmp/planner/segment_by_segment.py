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

import numpy as np

from tominpmp.arrays import Array
from tominpmp.goals.joints import JointGoal
from tominpmp.initial_guess.guess import Guess
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate, KeptIterate
from tominpmp.planner.descent import descend, guess_of
from tominpmp.planner.improvements import improvements
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import Schedule, Work, as_candidate, carry_out
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import spans_of
from tominpmp.solvers.iterate import Iterate
from tominpmp.status import IterationRecord, Status
from tominpmp.stopping import Stop
from tominpmp.transcription.layout import Layout
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

# Makes the schedule of starts for a problem with one goal.
Starts = Callable[[PlanState, Problem], Schedule[None]]


def can_be_joined(system: ProblemFunctions, options: Options) -> bool:
    """Whether segments can be planned one by one: no obstacle may move."""
    moving = any(part.problem.scene.moving for part in system.parts)
    return bool(system.parts) and options.method == "inverse" and not moving


def segments_joined(
    system: ProblemFunctions, guess: Guess, state: PlanState, starts: Starts
) -> Work:
    """Work that plans each segment alone, joins the motions, and improves the result.

    Args:
        system: Functions of the problem.
        guess: The guess, which has the final configurations of the segments.
        state: The plan.
        starts: Makes the schedule of starts of a segment.
    """

    def make(
        system: ProblemFunctions, doublings: int, former: Candidate | None
    ) -> Candidate:
        better = guess
        motions = [] if former else _planned_alone(system, guess, state, starts)
        if motions:
            joined = _as_candidate(system, motions, state)
            if joined.confirmed and _is_separable(system):
                return joined
            if joined.confirmed:
                state.candidates.append(joined)
            better = guess_of(system, joined)
        return descend(state.options, better, state, None, system, doublings, former)

    return Work(system, guess.name, make, self_collision_rows=True)


def _is_separable(system: ProblemFunctions) -> bool:
    """Whether the fastest motions of the segments are the fastest motion together."""
    return all(
        part.final_configuration is not None
        and part.problem.goal.stopped is part.problem.goal
        and not part.motion_limits.continuous
        for part in system.parts
    )


def _planned_alone(
    system: ProblemFunctions, guess: Guess, state: PlanState, starts: Starts
) -> list[Trajectory]:
    """Motions of the segments from rest to rest; empty if one of them is not found."""
    motions: list[Trajectory] = []
    q = system.problem.q_start
    for k, (part, end) in enumerate(zip(system.parts, guess.ends, strict=True)):
        phase = part.problem
        goal = phase.goal.stopped
        if goal.configuration is None:
            goal = JointGoal(end).resolved(phase.robot, q)
        problem = phase._altered(goal=goal, q_start=q)
        others = guess.duration - guess.durations[k]
        seconds = state.remaining_time / (len(system.parts) - k)
        motion = _alone(problem, state, starts, others, seconds)
        if motion is None:
            return []
        motions.append(motion)
        q = motion.q[-1]
    return motions


def _alone(
    problem: Problem, state: PlanState, starts: Starts, others: float, seconds: float
) -> Trajectory | None:
    """The motion of one segment; None if it is not found in time.

    Args:
        problem: The problem of the segment.
        state: The plan of all segments, which sees the iterations.
        starts: Makes the schedule of starts of the segment.
        others: Estimated duration of the other segments [s].
        seconds: Planning time [s].
    """

    def show(record: IterationRecord) -> bool:
        state(replace(record, duration=record.duration + others))
        return False

    def schedule() -> Schedule[None]:
        yield from starts(alone, problem)
        yield from improvements(alone)

    control = state.options.control
    options = replace(
        state.options,
        # All segments have accelerations of one kind.
        control="constant" if control == "auto" else control,
        max_planning_time=seconds,
        callback=show,
        starts=None,
        processes=1,
    )
    alone = PlanState(problem, options, stop_requested=lambda: state.deadline.due)
    with alone.deadline.in_force():
        try:
            carry_out(alone, schedule())
        except Stop as stop:
            alone.stopped(stop)
    best = alone.incumbent
    return None if best is None else best.trajectory


def _as_candidate(
    system: ProblemFunctions, motions: Sequence[Trajectory], state: PlanState
) -> Candidate:
    """The joined motion as a replayed candidate, with the dwells of its segments."""
    motion = _joined(motions)
    layout = Layout.of_motion(motion)
    assert layout is not None  # noqa: S101
    transcription, z = layout.represented(system, motion, spans_of(motion, ()))
    program = NonlinearProgram.of(transcription).at(z)
    iterate = Iterate.of(program, z, 1.0)
    kept = KeptIterate(program, iterate, True)
    candidate = as_candidate("segments", kept, kept, Status.CONVERGED)
    candidate = replace(candidate, history=tuple(state.records))
    with state.saving():
        return candidate.verified(system.problem, state.options)


def _joined(motions: Sequence[Trajectory]) -> Trajectory:
    """Motions one after another, without dwells; their torques are not adapted."""
    ends = np.cumsum([motion.duration for motion in motions])
    begins = [0.0, *ends[:-1]]

    def rows(parts: Sequence[Array]) -> Array:
        return np.concatenate([*(part[:-1] for part in parts), parts[-1][-1:]])

    t = [motion.t + begin for motion, begin in zip(motions, begins, strict=True)]
    t[-1][-1] = ends[-1]
    a = [motion.a for motion in motions if motion.a is not None]
    return replace(
        motions[0],
        t=rows(t),
        q=rows([motion.q for motion in motions]),
        v=rows([motion.v for motion in motions]),
        u=rows([motion.u for motion in motions]),
        a=np.concatenate(a) if a else None,
        segment_ends=ends,
    )
