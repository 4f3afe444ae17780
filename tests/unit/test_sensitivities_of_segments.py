"""Sensitivities of the duration of motions with several segments."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import tominpmp as tm
from benchmarks.sensitivities import FINE
from tests.sample_arms import make_arm, slide
from tominpmp.sensitivities.analysis import analyse
from tominpmp.sensitivities.records import Sensitivities, summed

MASS, FORCE, LOAD, STAY = 2.0, 10.0, 3.0, 0.2
FIRST, SECOND = 0.5, 1.0


def planned(*segments: tm.Segment, **changes: Any) -> tm.Solution:
    robot = make_arm(slide(MASS), effort=FORCE)
    problem = tm.Problem(robot, [0.0], segments=segments, **changes)
    return tm.plan(problem, intervals=40, control="constant").raise_if_failed()


def at(x: float, **changes: Any) -> tm.Segment:
    return tm.Segment(tm.JointGoal([x]), **changes)


def value(found: Sensitivities, kind: str, subject: str | None = None) -> float:
    (item,) = found.of(kind, subject)
    return item.value


def test_sensitivities_with_a_payload_picked_up_match_the_formula() -> None:
    load = tm.Payload(LOAD, "tip", name="box")
    last = at(FIRST + SECOND, payload=load)
    solution = planned(at(FIRST, dwell=STAY), last)
    found = solution.sensitivities
    T = solution.T
    light, heavy = MASS / FORCE, (MASS + LOAD) / FORCE
    # T = 2 sqrt(m d / F) on each segment, and the dwell.
    assert T == pytest.approx(
        2 * math.sqrt(light * FIRST) + 2 * math.sqrt(heavy * SECOND) + STAY, rel=2e-3
    )
    assert found.T == T
    assert value(found, "effort") == pytest.approx(-0.5 * (T - STAY) / T, rel=2e-3)
    by_mass = LOAD * math.sqrt(SECOND / (MASS + LOAD) / FORCE) / T
    assert value(found, "payload", "box") == pytest.approx(by_mass, rel=0.01)
    name = solution.problem.robot.joint_names[0]
    by_first, by_second = math.sqrt(light / FIRST), math.sqrt(heavy / SECOND)
    goals = {s.subject: s.value * T for s in found.of("goal")}
    assert goals == {
        f"{name} of segment 1": pytest.approx(by_first - by_second, rel=0.01),
        f"{name} of segment 2": pytest.approx(by_second, rel=0.01),
    }
    # Everything except the dwell scales with time.
    assert found.balance == pytest.approx(STAY / T, abs=1e-6)


def test_via_point_on_the_optimal_path_has_no_sensitivity() -> None:
    found = planned(at(0.3), at(1.0)).sensitivities
    first, second = found.of("goal")
    if first.subject.endswith("2"):
        first, second = second, first
    assert (
        abs(first.value) < 0.04
    )  # not zero, as the switch is inside an interval of the grid
    assert second.value == pytest.approx(0.5, rel=0.02)
    assert found.balance == pytest.approx(0.0, abs=1e-6)


def test_limits_of_each_segment_add_to_the_sensitivities() -> None:
    slow = (tm.ToolSpeed("tip", 0.5),)
    slower = (tm.ToolSpeed("tip", 0.25),)
    solution = planned(
        at(0.5, constraints=slow, stop=True),
        at(1.0, constraints=slower, stop=True),
        at(1.5, motion_limits=tm.MotionLimits(acceleration=1.0)),
    )
    found, T, a = solution.sensitivities, solution.T, FORCE / MASS
    # d / w + w / a at a tool speed w.
    expected = (-0.5 / 0.5 + 0.5 / a) + (-0.5 / 0.25 + 0.25 / a)
    assert value(found, slow[0].name) == pytest.approx(expected / T, rel=0.03)
    (item,) = found.of(slow[0].name)
    assert item.limit is None  # the two segments have different limits
    own = -math.sqrt(0.5 / 1.0) / T
    assert value(found, "acceleration") == pytest.approx(own, rel=0.01)


def test_sensitivity_of_clearance_is_that_of_its_segment() -> None:
    arm = tm.load_robot("planar3r").with_changes(gravity=(0, 0, 0))
    first, second = (0.9, 1.5, -1.5), (0.5, 1.7, -1.7)
    ball = tm.Sphere("O", radius=0.1, position=(4.12, 2.336, 0))
    # On coarser grids, motions end with predicted gains of one to three per cent of T,
    # and their multipliers are not unique.
    goal, options = tm.PositionGoal("tip", (4, 1, 0)), {**FINE, "intervals": 100}
    segments = [
        tm.Segment(tm.JointGoal(second), scene=[], stop=True),
        tm.Segment(goal, scene=[ball]),
    ]
    solution = tm.plan(tm.Problem(arm, first, segments=segments, margin=0.1), **options)
    assert solution.status is tm.Status.CONVERGED
    part = solution.segments[1].trajectory
    one = analyse(tm.Problem(arm, second, goal, [ball], 0.1), part)
    share = part.duration / solution.T
    clearance = value(solution.sensitivities, "clearance", "O")
    assert clearance == pytest.approx(share * value(one, "clearance", "O"), rel=0.05)
    assert clearance > 0.01


def test_sensitivities_reject_arrival_times() -> None:
    solution = planned(at(0.3, arrival=(0.0, 2.0)), at(1.0))
    with pytest.raises(tm.ProblemError, match="segment 1 has arrival times") as caught:
        _ = solution.sensitivities
    assert caught.value.field == "segments[0].arrival"


def test_segment_of_no_duration_has_no_multipliers() -> None:
    robot = make_arm(slide(MASS), effort=FORCE)
    motion = tm.plan(tm.Problem(robot, [0.0], tm.JointGoal([1.0]))).trajectory
    problem = tm.Problem(robot, [0.0], segments=[at(0.0, stop=True), at(1.0)])
    recorded = replace(motion, segment_ends=np.array([0.0, motion.duration]))
    assert tm.verify(problem, recorded).ok
    assert "could not be evaluated" in tm.certify(problem, recorded).message
    with pytest.raises(tm.ProblemError, match="has no multipliers"):
        analyse(problem, recorded)


def test_sensitivities_of_segments_match_differences_of_plans() -> None:
    robot = tm.load_robot("planar3r")
    # On 44 and 48 intervals warm starts end at two optima, 0.3 to 0.8 % apart.
    options = {**FINE, "intervals": 56}

    def problem(mass: float = 0.03, along: float = 0.0, effort: float = 7.0) -> Any:
        arm = robot.with_changes(effort={"joint2": effort})
        load = tm.Payload(mass, "tip", com=(0.1, 0, 0), name="box")
        via = np.array((4.5, 2.0, 0.0)) + along * step
        return tm.Problem(
            arm,
            (0.5, 1.7, -1.7),
            segments=[
                tm.Segment(tm.PositionGoal("tip", via)),
                tm.Segment(tm.JointGoal([1.2, 0.8, -0.4]), payload=load, dwell=0.1),
                tm.Segment(tm.JointGoal([0.8, 1.2, -0.8])),
            ],
        )

    step = np.zeros(3)
    solution = tm.plan(problem(), **options)
    found = solution.sensitivities

    def slope(change: float, **values: tuple[float, float]) -> float:
        ends = [{k: v[i] for k, v in values.items()} for i in (0, 1)]
        times = [tm.plan(problem(**e), start=solution, **options).T for e in ends]
        return math.log(times[1] / times[0]) / (2.0 * change)

    (via,) = found.of("goal", "frame tip of segment 1")
    assert via.vector is not None
    step = via.vector / np.linalg.norm(via.vector)
    assert via.value == pytest.approx(slope(0.01, along=(-0.01, 0.01)), rel=0.05)
    (box,) = found.of("payload", "box")
    assert box.value == pytest.approx(slope(0.05, mass=(0.0285, 0.0315)), rel=0.05)
    (motor,) = found.of("effort", "joint2")
    assert motor.value == pytest.approx(slope(0.02, effort=(6.86, 7.14)), rel=0.05)


def test_sum_over_a_motion_without_segments_changes_nothing() -> None:
    found = planned(at(0.3), at(1.0)).sensitivities
    alone = summed(found)
    assert [item.value for item in alone] == [item.value for item in found]
    assert replace(found[0]).scaled(2.0).value == 2.0 * found[0].value
