"""Verification of a motion by a replay of its torques.

The replay is judged instead of the plan: its final state, its violations of limits,
every millisecond, and its violations of margins, at all times. An unstable motion,
whose errors grow too fast for its torques alone, is replayed with a small feedback
(:mod:`~tominpmp.verification.feedback`), whose torques are judged as well.
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
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import BRIEF, shortened
from tominpmp.goals.joints import nearest_turns
from tominpmp.kinematics import units_of
from tominpmp.motion.joining import checked_motion
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Tolerances
from tominpmp.problem.problem import Problem
from tominpmp.verification.feedback import (
    TIGHTER,
    Tracking,
    amplification,
    ends_agree,
    errors_matter,
    feedback_rate,
)
from tominpmp.verification.limit_violations import LimitViolation, limit_violations
from tominpmp.verification.nearest import Touch, nearest_pair, never_touching
from tominpmp.verification.plant import Plant
from tominpmp.verification.polynomials import Pieces
from tominpmp.verification.replay import (
    Integration,
    Integrator,
    Replay,
    planned,
    torque_pieces,
)
from tominpmp.verification.stages import Stage, goal_misses, stages_of, with_segments

# Duration above which a motion is not replayed, as it would take too many steps [s].
LONGEST = 1e4
# Relative rounding of a floating-point number.
ROUNDING = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Verification:
    """Result of a replay of the torques of a motion.

    Attributes:
        ok: Whether the replay reaches the goal and keeps all limits, within the
            tolerances.
        goal_error: Distance of the final configuration from the goal: of the worst
            joint, or of the frame in position and angle [rad or m].
        speed_error: Deviation of the final velocity from the velocity of the goal: of
            the worst joint or direction [rad/s or m/s].
        worst: The worst violation, or least slack, of each kind of limit ("position",
            "velocity", "effort", "clearance", ...) with joint or pair, time and amount,
            also if it is within the tolerance.
        violations: Violations beyond the tolerances, violations of the goal included.
        min_clearance: Smallest measured distance to obstacles and between links during
            the motion [m], above the least one by at most a tenth of what exceeds the
            margin; infinite without pairs, minus infinity for a motion that is too long
            to be replayed.
        deviation: Largest distance of each joint from the plan, shape (n,) [rad or m].
        defect: Largest distance in position by which the integration of an interval
            from its first node misses its last node [rad or m], infinite if it fails on
            the way; None for a motion without violations, and for a motion that is too
            long to be replayed. If the defect is small and the goal is missed, the
            motion is unstable, or errors add up.
        integrator: Name of the integrator.
        complete: Whether the replay reached the end of the motion.
        tolerances: The tolerances.
        seconds: Computation time [s].
        replay: The replayed motion.
        problem: The problem that the motion has to solve.
        growth: Amplification of errors along the motion, to first order.
        feedback: Largest feedback torques in the replay of an unstable motion, shape
            (n,) [N m or N], see :mod:`~tominpmp.verification.feedback`; None without
            feedback.
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
        """Whether the replay reaches the goal and keeps all limits."""
        return self.ok

    def __repr__(self) -> str:
        """Show the result on one line."""
        verdict = "ok" if self.ok else "not ok"
        return f"<Verification {verdict}: {shortened(self.message, 2 * BRIEF)}>"

    @property
    def message(self) -> str:
        """The violations, or the success of the replay, in a sentence."""
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

        They are determined at the first access, for a motion without violations, and do
        not count as violations; see :func:`~.nearest.never_touching`.
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
        problem: The problem that the motion has to solve.
        trajectory: The motion: the torques are used, and the nodes, at which torques
            may jump. Samples, for example from a file, are joined into a motion first.
        tolerances: The tolerances; None for the defaults.
        geometry: "convex" represents links by the convex pieces with which motions are
            planned; "hull" by one convex hull each; "mesh" by their triangles, which is
            slow.
        checker: Collision checker that replaces the checker of the geometry, for a
            motion of one segment: segments of several have their own checkers.
        integrator: See :class:`~tominpmp.verification.replay.Integration`.

    Returns:
        The result of the replay.

    Raises:
        ProblemError: If the motion has other joints than the robot or values that are
            not finite, or another argument is invalid.
        ScenarioError: If the samples have other joints than the robot.
    """
    begin = time.perf_counter()
    instance(problem, Problem, "problem")
    tolerances = Tolerances() if tolerances is None else tolerances
    instance(tolerances, Tolerances, "tolerances", "Tolerances or None")
    shapes = get_args(Geometry)
    choice(geometry, shapes, "geometry", " or ".join(map(repr, shapes)))
    if checker is not None:
        instance(checker, CollisionChecker, "checker", "a CollisionChecker or None")
    trajectory = checked_motion(trajectory, problem)
    if trajectory.duration > LONGEST:
        return _too_long(problem, trajectory, tolerances, begin)
    trajectory = with_segments(problem, trajectory, tolerances)
    stages = stages_of(problem, trajectory)
    torque = torque_pieces(problem.robot, trajectory)
    plants = [Plant(stage.problem.robot) for stage in stages]
    args = plants, trajectory, torque, integrator
    integration = Integration(*args)
    start, checkers = problem.x_start, _checkers(stages, checker, geometry)
    growth, goal = amplification(plants, trajectory), tolerances.goal
    findings, feedback, defect, accepted = None, None, None, False
    if not errors_matter(growth, goal, ROUNDING, share=1.0):
        open_loop = integration.run(start)
        findings = judge(stages, open_loop, torque, tolerances, checkers)
        # Integration errors may also carry a motion to its goal by accident.
        accepted = not findings.violations and (
            not errors_matter(growth, goal, integration.error)
            or ends_agree(open_loop, Integration(*args, TIGHTER).run(start), tolerances)
        )
    rate = None if accepted else feedback_rate(growth, trajectory.duration, goal)
    if rate is not None:
        tracking = Tracking(plants, trajectory, rate, integrator)
        tracked = tracking.run(start)
        feedback = frozen_array(np.max(np.abs(tracking.feedback), axis=0))
        findings = judge(stages, tracked, torque, tolerances, checkers)
        findings.items.extend(tracking.excesses(tracked.t, tolerances.limits))
    assert findings is not None  # noqa: S101
    findings.items.extend(_start_misses(problem, trajectory, goal))
    if findings.violations:
        gaps = np.abs(integration.defects()[:, : trajectory.n])
        defect = float(np.max(np.nan_to_num(gaps, nan=np.inf), initial=0.0))
    replayed = findings.replay
    deviation = np.max(np.abs(replayed.q - trajectory(replayed.t, 0)), axis=0)
    result = findings.result(problem, tolerances, deviation, growth, begin)
    return replace(result, defect=defect, feedback=feedback)


def _start_misses(
    problem: Problem, trajectory: Trajectory, tolerance: float
) -> list[LimitViolation]:
    """Distance of a motion from the start of its problem; empty if it is tolerated.

    The torques of a motion may lead from the start to the goal although its positions
    do not: torques do not depend on turns about the vertical, for example.

    Args:
        problem: The problem.
        trajectory: The motion.
        tolerance: Tolerated distance of each joint [rad or m].
    """
    robot, here = problem.robot, trajectory.q[0]
    # Whole turns of continuous joints do not count.
    away = np.abs(here - nearest_turns(robot, [problem.q_start], here)[0])
    joint = int(np.argmax(away))
    amount, unit = float(away[joint]), units_of(robot)[joint]
    miss = "start", robot.joint_names[joint], 0.0, amount, unit, amount, True
    return [LimitViolation(*miss)] if amount > tolerance else []


def _too_long(
    problem: Problem, trajectory: Trajectory, tolerances: Tolerances, begin: float
) -> Verification:
    """Result for a motion that is too long to be replayed."""
    T, excess = trajectory.duration, trajectory.duration - LONGEST
    row = "duration", "the motion", T, excess, "s", excess / LONGEST, True
    plan = replace(planned(trajectory, np.inf), complete=False)
    findings = Findings(plan, [LimitViolation(*row)], -np.inf)
    deviation = np.full(trajectory.n, np.inf)
    result = findings.result(problem, tolerances, deviation, np.inf, begin)
    return replace(result, goal_error=np.inf, speed_error=np.inf)


class Findings(NamedTuple):
    """Comparison of a replay with its problem.

    Attributes:
        replay: The replay.
        items: Deviations from the goals of the segments, in position ("goal") and
            velocity ("speed"), and the worst violation, or least slack, of each kind of
            limit, clearance included.
        distance: Least distance of the collision pairs [m]; infinite without pairs.
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
        """The verification; the caller adds a defect and feedback torques.

        Args:
            problem: The problem.
            tolerances: The tolerances.
            deviation: Largest distance of each joint from the plan, shape (n,) [rad or
                m].
            growth: Amplification of errors along the motion.
            begin: Start of the computation, by ``time.perf_counter`` [s].
        """
        # The worst of each kind, over all segments.
        kinds = dict.fromkeys(item.kind for item in self.items)
        each = ([item for item in self.items if item.kind == kind] for kind in kinds)
        worst = {items[0].kind: max(items, key=lambda x: x.share) for items in each}
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
    """Compare a replay with the goals, the limits and the obstacles of its segments.

    Args:
        stages: The segments of the motion.
        replay: The motion.
        torque: Torques of the motion, as polynomials between their jumps.
        tolerances: The tolerances.
        checkers: Collision checkers of the segments.
    """
    limits: list[LimitViolation] = []
    ends: list[LimitViolation] = []
    distance, before = np.inf, stages[0].problem.a_start
    for stage, checker in zip(stages, checkers, strict=True):
        problem, (section, pieces) = stage.problem, stage.section(replay, torque)
        if not section.t.size:
            lost = replay.duration, np.inf, "m or rad", np.inf, True
            ends.append(stage.named(LimitViolation("goal", "the arm", *lost)))
            continue
        # After the motion the arm has no acceleration.
        ends_here = section.complete and stage is stages[-1]
        outside = np.stack([before, np.full_like(before, 0.0 if ends_here else np.nan)])
        worst = limit_violations(problem, section, pieces, tolerances.limits, outside)
        if section.complete and not ends_here and stage.begin < stage.end:
            q, v, u, way = section.q, section.v, section.u, section.way
            dynamics = RobotDynamics(problem.robot)
            (before,) = dynamics.forward_along(q[-1:], v[-1:], u[-1:], way[-1:])
        nearest = nearest_pair(problem, section, checker, tolerances.contact)
        if nearest is not None:
            worst.append(nearest[0])
            distance = min(distance, nearest[1].distance)
        limits += map(stage.named, [*worst, *stage.timeliness])
        ends += map(stage.named, goal_misses(stage, section, tolerances))
    return Findings(replay, [*ends, *limits], distance)


def _checkers(
    stages: Sequence[Stage], checker: CollisionChecker | None, geometry: Geometry
) -> list[CollisionChecker]:
    """Collision checkers of the segments, with the geometry of a verification."""
    if checker is not None and len(stages) == 1:
        return [checker]
    own = [stage.problem.checker for stage in stages]
    if geometry == "convex":
        return own
    return [replace(item, geometry=geometry) for item in own]
