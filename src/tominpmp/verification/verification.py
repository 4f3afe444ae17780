"""Verification of a motion by a replay of its torques.

The replay is judged, not the plan: its end, and its violations of limits and margins,
every millisecond.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, get_args

import numpy as np

from tominpmp.arrays import Array, frozen_array
from tominpmp.blas_threads import on_one_thread
from tominpmp.checks import choice, instance
from tominpmp.collision.bodies import Geometry
from tominpmp.collision.checker import CollisionChecker
from tominpmp.exceptions import BRIEF, shortened
from tominpmp.motion.joining import checked_motion
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Tolerances
from tominpmp.problem.problem import Problem
from tominpmp.verification.feedback import (
    TIGHTER,
    Tracking,
    amplification,
    doubtful,
    feedback_rate,
    needed,
    settled,
)
from tominpmp.verification.limit_violations import LimitViolation, limit_violations
from tominpmp.verification.nearest import Touch, closest, never_touching
from tominpmp.verification.plant import Plant
from tominpmp.verification.polynomials import Pieces
from tominpmp.verification.replay import (
    Integration,
    Integrator,
    Replay,
    planned,
    start_of,
    torque_pieces,
)
from tominpmp.verification.stages import Stage, arrival, stages_of, with_segments

# Longer motions would take too many steps, and are not replayed [s].
LONGEST = 1e4
# Relative rounding of a floating-point number.
ROUNDING = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Verification:
    """Result of a replay of the torques of a motion.

    Attributes:
        ok: Whether it reaches the goal and keeps all limits, within the tolerances.
        goal_error: Distance of the end from the goal: of the worst joint, or of the
            frame in position and angle [rad or m].
        speed_error: Deviation of the final velocity from that of the goal: of the worst
            joint or direction [rad/s or m/s].
        worst: The worst of each kind of limit ("position", "velocity", "effort",
            "clearance", ...) with joint or pair, time and amount, also if it is within
            the tolerance.
        violations: Violations beyond the tolerances, those of the goal among them.
        min_clearance: Smallest distance to obstacles and between links [m], every
            millisecond; infinite without pairs.
        deviation: Largest distance of each joint from the plan, shape (n,).
        defect: Largest distance in position by which an interval that begins at its own
            node misses the next one; None for a motion without violations. Where this
            is small and the goal missed, the motion is unstable, or errors added up.
        integrator: Name of the integrator.
        complete: Whether the replay reached the end.
        tolerances: The tolerances.
        seconds: Time of the computation [s].
        replay: The replayed motion.
        problem: The problem that the motion is to solve.
        growth: Amplification of errors along the motion, to first order.
        feedback: Largest torques of the feedback in the replay of an unstable motion,
            shape (n,) [N m or N], see :mod:`~tominpmp.verification.feedback`; None
            without feedback.
    """

    ok: bool
    goal_error: float
    speed_error: float
    worst: dict[str, LimitViolation]
    violations: tuple[LimitViolation, ...]
    min_clearance: float
    deviation: Array
    defect: float | None
    integrator: str
    complete: bool
    tolerances: Tolerances
    seconds: float
    replay: Replay = field(repr=False)
    problem: Problem = field(repr=False)
    growth: float = 1.0
    feedback: Array | None = None

    def __bool__(self) -> bool:
        """Whether the motion has no violation beyond the tolerances."""
        return self.ok

    def __repr__(self) -> str:
        """The result, on one line."""
        found = "ok" if self.ok else "not ok"
        return f"<Verification {found}: {shortened(self.message, 2 * BRIEF)}>"

    @property
    def message(self) -> str:
        """The violations, or the absence of violations, in a sentence."""
        if not self.ok:
            return "; ".join(map(str, self.violations)) + "."
        if self.feedback is not None:
            text = (
                f"The motion is unstable: errors grow {self.growth:.0e}-fold. Its "
                f"replay with a feedback of at most {np.max(self.feedback):.1e} N m "
                f"(or N) reaches the goal within {self.goal_error:.1e}."
            )
        else:
            text = f"The replay reaches the goal within {self.goal_error:.1e}."
        return " ".join([text, *map(str, self.touches)])

    @cached_property
    def touches(self) -> tuple[Touch, ...]:
        """Links that touch although the SRDF says that they never do.

        They are searched when they are first used, in a motion without violations, and
        violate no limit; see :func:`~.nearest.never_touching`.
        """
        return never_touching(self.problem, self.replay) if self.ok else ()


@on_one_thread
def verify(
    problem: Problem,
    trajectory: Trajectory | Samples,
    tolerances: Tolerances | None = None,
    *,
    geometry: Geometry = "convex",
    checker: CollisionChecker | None = None,
    integrator: Integrator | None = None,
) -> Verification:
    """Replay the torques of a motion and compare the replay with its problem.

    Args:
        problem: The problem that the motion is to solve.
        trajectory: The motion: its torques are used, and its nodes, where torques may
            jump. Samples, from a file say, are joined to a motion first.
        tolerances: The tolerances; None for the usual ones.
        geometry: "convex" represents links by the convex pieces that motions are
            planned with; "mesh" by their triangles, which is slow.
        checker: Distances that replace either.
        integrator: See :func:`~tominpmp.verification.replay.replay`.

    Returns:
        The result.

    Raises:
        ProblemError: If the motion has other joints.
        ScenarioError: If the samples have other joints.
    """
    begin = time.perf_counter()
    instance(problem, Problem, "problem")
    tolerances = Tolerances() if tolerances is None else tolerances
    instance(tolerances, Tolerances, "tolerances", "Tolerances or None")
    shapes = get_args(Geometry)
    choice(geometry, shapes, "geometry", " or ".join(map(repr, shapes)))
    if checker is not None:
        instance(checker, CollisionChecker, "checker", "a CollisionChecker or None")
    robot = problem.robot
    trajectory = checked_motion(trajectory, robot, problem.q_start, problem.v_start)
    if trajectory.duration > LONGEST:
        return _too_long(problem, trajectory, tolerances, begin)
    trajectory = with_segments(problem, trajectory, tolerances)
    stages = stages_of(problem, trajectory)
    torque = torque_pieces(robot, trajectory)
    plants = [Plant(stage.problem.robot) for stage in stages]
    known = robot, trajectory, torque, integrator, plants
    integration = Integration(*known)
    start, checkers = start_of(problem), _checkers(stages, checker, geometry)
    growth, goal = amplification(stages, trajectory), tolerances.goal
    findings, feedback, defect, sure = None, None, None, False
    if not doubtful(growth, goal, ROUNDING, share=1.0):
        alone = integration.run(start)
        findings = judge(stages, alone, torque, tolerances, checkers)
        # Errors of the integration may also carry a motion to its goal.
        sure = not findings.violations and (
            not doubtful(growth, goal, integration.error)
            or settled(alone, Integration(*known, TIGHTER).run(start), tolerances)
        )
    rate = None if sure else feedback_rate(growth, trajectory.duration, goal)
    if rate is not None:
        tracking = Tracking(stages, trajectory, rate, integrator)
        tracked = tracking.run(start)
        feedback = frozen_array(np.max(np.abs(tracking.feedback), axis=0))
        findings = judge(stages, tracked, torque, tolerances, checkers)
        taken = needed(robot, tracked.t, tracking.feedback, tolerances.limits)
        findings.items.extend([] if taken is None else [taken])
    assert findings is not None  # noqa: S101
    if findings.violations:
        gaps = np.abs(integration.defects()[:, : robot.n])
        gaps = np.where(np.isfinite(gaps), gaps, np.inf)
        defect = float(np.max(gaps, initial=0.0))
    replayed = findings.replay
    # Torques would take most of the time of an evaluation.
    plan = replace(trajectory, inverse_dynamics=None)(replayed.t).q
    deviation = np.max(np.abs(replayed.q - plan), axis=0)
    found = findings.result(problem, tolerances, deviation, growth, begin)
    return replace(found, defect=defect, feedback=feedback)


def _too_long(
    problem: Problem, trajectory: Trajectory, tolerances: Tolerances, begin: float
) -> Verification:
    """Result for a motion that is too long to be replayed."""
    T = trajectory.duration
    beyond = T - LONGEST
    share = beyond / LONGEST
    violation = LimitViolation(
        "duration", "the motion", T, beyond, "s", share, violated=True
    )
    plan = replace(planned(trajectory, np.inf), complete=False)
    findings = Findings(plan, [violation], -np.inf)
    deviation = np.full(trajectory.n, np.inf)
    found = findings.result(problem, tolerances, deviation, np.inf, begin)
    return replace(found, goal_error=np.inf, speed_error=np.inf)


class Findings(NamedTuple):
    """Comparison of a replay with its problem.

    Attributes:
        replay: The replay.
        items: Deviations from the goals of the segments, in place ("goal") and velocity
            ("speed"), and the worst of each kind of limit, clearance among them.
        distance: Least distance of the pairs [m]; infinite without pairs.
    """

    replay: Replay
    items: list[LimitViolation]
    distance: float

    @property
    def violations(self) -> tuple[LimitViolation, ...]:
        """Violations beyond the tolerances."""
        return tuple(item for item in self.items if item.violated)

    def result(
        self,
        problem: Problem,
        tolerances: Tolerances,
        deviation: Array,
        growth: float,
        begin: float,
    ) -> Verification:
        """The verification without a defect and without feedback.

        Args:
            problem: The problem.
            tolerances: The tolerances.
            deviation: Largest distance of each joint from the plan, shape (n,).
            growth: Amplification of errors along the motion.
            begin: Begin of the computation, by ``time.perf_counter`` [s].
        """
        worst: dict[str, LimitViolation] = {}  # of each kind, on all segments
        for item in self.items:
            known = worst.get(item.kind)
            if known is None or item.share > known.share:
                worst[item.kind] = item
        goal, speed = worst.pop("goal", None), worst.pop("speed", None)
        return Verification(
            ok=not self.violations,
            goal_error=0.0 if goal is None else goal.amount,
            speed_error=0.0 if speed is None else speed.amount,
            worst=worst,
            violations=self.violations,
            min_clearance=self.distance,
            deviation=frozen_array(deviation),
            defect=None,
            integrator=self.replay.integrator,
            complete=self.replay.complete,
            tolerances=tolerances,
            seconds=time.perf_counter() - begin,
            replay=self.replay,
            problem=problem,
            growth=growth,
        )


def judge(
    stages: Sequence[Stage],
    replay: Replay,
    torque: Pieces,
    tolerances: Tolerances,
    checkers: Sequence[CollisionChecker],
) -> Findings:
    """Compare a replay with the goals, the limits and the obstacles."""
    limits: list[LimitViolation] = []
    ends: list[LimitViolation] = []
    distance = np.inf
    for stage, checker in zip(stages, checkers, strict=True):
        problem, (part, pieces) = stage.problem, stage.part(replay, torque)
        if not part.t.size:
            lost = replay.duration, np.inf, "m or rad", np.inf, True
            ends.append(stage.named(LimitViolation("goal", "the arm", *lost)))
            continue
        found = limit_violations(problem, part, pieces, tolerances.limits)
        near = closest(problem, part, checker, tolerances.contact)
        if near is not None:
            found.append(near[0])
            distance = min(distance, near[1].distance)
        limits += map(stage.named, [*found, *stage.timeliness])
        ends += map(stage.named, arrival(stage, part, tolerances))
    return Findings(replay, [*ends, *limits], distance)


def _checkers(
    stages: Sequence[Stage], checker: CollisionChecker | None, geometry: Geometry
) -> list[CollisionChecker]:
    if checker is not None and len(stages) == 1:
        return [checker]
    own = [stage.problem.checker for stage in stages]
    return own if geometry == "convex" else [item.using(geometry) for item in own]
