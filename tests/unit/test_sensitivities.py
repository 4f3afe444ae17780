"""Sensitivities of the duration: time scaling, differences of plans, tables, cycles."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import invoke

import tominpmp as tm
from tominpmp.exceptions import ProblemError
from tominpmp.sensitivities.analysis import analyse
from tominpmp.sensitivities.records import Sensitivities, Sensitivity

ROOT = str(Path(__file__).resolve().parents[2])
if ROOT not in sys.path:
    sys.path.insert(0, ROOT)

from benchmarks.sensitivities import FINE, difference, planned_as  # noqa: E402

START = (0.5, 1.7, -1.7)
JOINTS = tm.JointGoal([1.2, 0.8, -0.4])
TIP = tm.PositionGoal("tip", (4, 1, 0))
OBSTACLE = tm.Scene([tm.Sphere("O", radius=0.5, position=(3.2, 3.2, 0))])
CONTROLLER = tm.MotionLimits(acceleration=20.0, jerk=300.0, effort_rate=300.0)
CURVE = tm.MotionLimits(effort_curves={"joint3": tm.EffortCurve.droop(2.5, 4.0)})


@cache
def arm(**changes: Any) -> tm.Robot:
    return tm.load_robot("planar3r").with_changes(**changes)


@cache
def planned(case: str) -> tm.Solution:
    weightless = {"gravity": (0.0, 0.0, 0.0)}
    free = arm(damping=0.0, **weightless)
    loaded = arm().with_payload(tm.Payload(0.02, "tip", com=(0.1, 0.0, 0.0)))
    lopsided = arm().with_changes(effort=[(-30.0, 20.0), (-5.0, 9.0), (-2.0, 3.0)])
    problems: dict[str, Any] = {
        "free": lambda: tm.Problem(free, START, JOINTS),
        "slow": lambda: tm.Problem(
            arm(damping=0.0, velocity=1.0, **weightless), START, JOINTS
        ),
        "controller": lambda: tm.Problem(free, START, JOINTS, motion_limits=CONTROLLER),
        "gravity": lambda: tm.Problem(arm(damping=0.0), START, JOINTS),
        "damped": lambda: tm.Problem(arm(), START, JOINTS, motion_limits=CONTROLLER),
        "rubbing": lambda: tm.Problem(arm(friction=0.3), START, JOINTS),
        "curve": lambda: tm.Problem(arm(), START, JOINTS, motion_limits=CURVE),
        "loaded": lambda: tm.Problem(loaded, START, JOINTS),
        "lopsided": lambda: tm.Problem(lopsided, START, JOINTS),
        "obstacle": lambda: tm.Problem(arm(**weightless), START, TIP, OBSTACLE, 0.1),
    }
    # Beside an obstacle T of plans on 32 intervals is no smooth function of the margin:
    # their differences vary by 3 % with the step.
    intervals = 48 if case == "obstacle" else 32
    return tm.plan(problems[case](), intervals=intervals, **FINE).raise_if_failed()


def values(case: str, kind: str) -> dict[str, float]:
    return {s.subject: s.value for s in planned(case).sensitivities.of(kind)}


@pytest.mark.parametrize("case", ["free", "slow", "controller"])
def test_sensitivities_of_limits_satisfy_time_scaling(case: str) -> None:
    found = planned(case).sensitivities
    powers = {"velocity": 1, "effort": 2, "acceleration": 2, "jerk": 3}
    powers["effort rate"] = 3
    total = sum(power * found.total(kind) for kind, power in powers.items())
    assert total == pytest.approx(-1.0, abs=1e-6)
    assert found.balance == pytest.approx(0.0, abs=1e-6)
    worth = [s.value for kind in powers for s in found.of(kind)]
    assert max(worth) <= 1e-6 and min(worth) < -0.1


@pytest.mark.parametrize(
    "case", ["gravity", "damped", "rubbing", "curve", "loaded", "lopsided"]
)
def test_gravity_damping_friction_and_curves_satisfy_time_scaling(case: str) -> None:
    found = planned(case).sensitivities
    assert found.balance == pytest.approx(0.0, abs=1e-6)
    parts = {"gravity": "gravity", "damped": "damping", "rubbing": "friction"}
    parts |= {"curve": "speed of effort curve", "loaded": "gravity"}
    parts["lopsided"] = "effort"  # the middle of the range scales, too
    assert abs(found.total(parts[case])) > 1e-3


def test_jumps_of_friction_are_no_part_of_torque_rates() -> None:
    # Regression: rates across the reversal of a joint counted with the jump of its
    # friction, which the limits of torque rates leave out.
    slow = tm.MotionLimits(effort_rate=30.0)
    problem = tm.Problem(arm(friction=0.3), START, JOINTS, motion_limits=slow)
    quick = {"effort": "quick", "refine": None, "starts": 1}
    found = tm.plan(problem, intervals=12, **quick).sensitivities
    assert found.total("friction") > 0.1 and found.total("effort rate") < -0.01
    assert found.balance == pytest.approx(0.0, abs=1e-6)


def test_effort_curves_with_both_sides_active_satisfy_time_scaling() -> None:
    # Far from the optimum, torques at one side of a curve trade with the other side.
    robot = tm.load_robot("ur5", limits="urdf")
    motors = zip(robot.joint_names, (60.0, 100.0, 45.0), strict=False)
    curves = {
        name: tm.EffortCurve([0.0, 1.5, 3.14], [most, most, 0.3 * most])
        for name, most in motors
    }
    problem = tm.Problem(
        robot,
        [0.0, -0.4, 1.0, -0.5, 0.5, 0.0],
        tm.JointGoal([1.6, -1.4, -0.9, 0.3, -0.4, 1.0]),
        motion_limits=tm.MotionLimits(effort_curves=curves),
    )
    early = tm.plan(problem, intervals=20, refine=None, starts=1, max_iterations=8)
    assert early.sensitivities.promise > 0.005
    assert early.sensitivities.balance == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("case", "kind", "subject", "steps"),
    [
        ("loaded", "effort", "joint3", 1.0),
        ("loaded", "payload", "payload", 10.0),
        ("obstacle", "obstacle", "O", 1.0),
        ("obstacle", "goal", "frame tip", 1.0),
        ("obstacle", "margin", "", 1.0),
        ("slow", "velocity", "joint3", 1.0),
    ],
)
def test_sensitivities_match_differences_of_plans(
    case: str, kind: str, subject: str, steps: float
) -> None:
    solution = planned(case)
    (item,) = solution.sensitivities.of(kind, subject)
    by_plans = difference(solution.problem, solution, item, steps)
    assert by_plans is not None
    assert item.value == pytest.approx(by_plans, rel=0.05)


def test_sensitivity_of_the_margin_is_the_margin_times_that_of_clearance() -> None:
    found = planned("obstacle").sensitivities
    (clearance,), (margin,) = found.of("clearance", "O"), found.of("margin")
    assert clearance.value > 0.01
    assert margin.value == pytest.approx(0.1 * clearance.value)


def test_sensitivity_of_a_zero_margin_is_per_metre() -> None:
    problem = replace(planned("obstacle").problem, margin=0.0)
    found = analyse(problem, planned("obstacle").trajectory)
    assert [s.unit for s in found.of("margin")] == ["1/m"]


def test_kind_and_subject_must_be_texts() -> None:
    wrong: Any = np.zeros(3)
    found = planned("obstacle").sensitivities
    with pytest.raises(ProblemError, match=r"^kind is .*, expected a text or None$"):
        found.of(wrong)
    with pytest.raises(ProblemError, match=r"^subject is .*, expected a text or None$"):
        found.of("goal", wrong)


def test_vector_of_a_sensitivity_is_a_read_only_copy() -> None:
    vector = np.ones(3)
    item = Sensitivity("goal", None, "goal", 1.0, vector=vector)
    vector[0] = 5.0
    assert item.vector is not None
    assert item.vector.tolist() == [1.0, 1.0, 1.0]
    assert not item.vector.flags.writeable


def test_base_sensitivity_opposes_goal_and_obstacle() -> None:
    found = planned("obstacle").sensitivities
    (goal,), (obstacle,) = found.of("goal"), found.of("obstacle")
    together = np.array(goal.vector) + np.array(obstacle.vector)
    assert np.linalg.norm(together) > 0.01
    np.testing.assert_allclose(found.base[:3], -together, atol=1e-6)


def test_turning_the_base_is_turning_gravity_the_other_way() -> None:
    """The expected value is a difference of two plans in which gravity is turned."""
    solution, step = planned("gravity"), 0.01
    x, y, _ = solution.problem.robot.gravity
    logarithms = []
    for angle in (-step, step):
        c, s = np.cos(-angle), np.sin(-angle)
        turned = arm(damping=0.0, gravity=(c * x - s * y, s * x + c * y, 0.0))
        problem = replace(solution.problem, robot=turned)
        found = tm.plan(problem, start=solution, **planned_as(solution))
        logarithms.append(np.log(found.raise_if_failed().T))
    expected = (logarithms[1] - logarithms[0]) / (2.0 * step)
    assert abs(expected) > 1e-3
    assert solution.sensitivities.base[5] == pytest.approx(expected, rel=0.02)


def test_table_and_plot_list_the_largest_effects(tmp_path: Path) -> None:
    found = planned("obstacle").sensitivities
    lines = found.table(3).splitlines()
    assert len(lines) == 5 and "more of less effect" in lines[-1]
    assert lines[1].startswith(found[0].label)
    effects = [abs(item.effect) for item in found]
    assert effects == sorted(effects, reverse=True)
    pytest.importorskip("matplotlib")
    figure = found.plot(tmp_path / "bars.png", most=4)
    assert (tmp_path / "bars.png").stat().st_size > 1000
    assert len(figure.axes[0].patches) == 4
    with pytest.raises(tm.ProblemError, match="most is 0"):
        found.plot(most=0)


def test_sensitivities_of_a_cycle_are_weighted_by_durations() -> None:
    one, other = (planned(case).sensitivities for case in ("free", "slow"))
    cycle = Sensitivities.of_cycle([one, other])
    assert cycle.T == pytest.approx(one.T + other.T)
    assert cycle.balance == pytest.approx(0.0, abs=1e-6)
    expected = one.T * one.total("effort") + other.T * other.total("effort")
    assert cycle.total("effort") == pytest.approx(expected / cycle.T)
    longer = Sensitivities.of_cycle([one], 2.0 * one.T)
    assert longer.total("effort") == pytest.approx(0.5 * one.total("effort"))
    with pytest.raises(tm.ProblemError, match="expected at least"):
        Sensitivities.of_cycle([one], 0.5 * one.T)
    with pytest.raises(tm.ProblemError, match="at least one motion"):
        Sensitivities.of_cycle([])
    with pytest.raises(tm.ProblemError, match="parts is"):
        Sensitivities.of_cycle([1.0])  # type: ignore[list-item]
    with pytest.raises(tm.ProblemError, match="parts is"):
        Sensitivities.of_cycle(range(10**15))  # type: ignore[arg-type]
    resting = Sensitivities(0.0, (), 0.0, np.zeros(6))
    assert Sensitivities.of_cycle([resting]).T == 0.0
    with pytest.raises(tm.ProblemError, match="T is 'long'"):
        Sensitivities.of_cycle([one], "long")  # type: ignore[arg-type]
    with pytest.raises(tm.ProblemError, match="names"):
        Sensitivities.of_cycle([one, one], names=["pick"])
    with pytest.raises(tm.ProblemError, match="names is 5"):
        Sensitivities.of_cycle([one], names=5)  # type: ignore[arg-type]
    with pytest.raises(tm.ProblemError, match="parts is None"):
        Sensitivities.of_cycle(None)  # type: ignore[arg-type]


def test_goals_of_a_cycle_are_separate_records() -> None:
    one = planned("obstacle").sensitivities
    cycle = Sensitivities.of_cycle([one, one], names=["pick", "place"])
    assert {s.subject for s in cycle.of("goal")} == {"pick", "place"}
    (obstacle,), (single,) = cycle.of("obstacle"), one.of("obstacle")
    assert obstacle.value == pytest.approx(single.value)


def test_analyse_rejects_a_wrong_problem_and_a_missing_motion() -> None:
    solution = planned("free")
    with pytest.raises(tm.ProblemError, match="problem is 3"):
        analyse(3, solution.trajectory)  # type: ignore[arg-type]
    failed = replace(solution, trajectory=None, feasible=False)
    with pytest.raises(tm.ProblemError, match="there is no motion"):
        _ = failed.sensitivities


def test_sensitivity_is_a_record_with_its_limit() -> None:
    item = planned("free").sensitivities[0]
    assert isinstance(item, Sensitivity) and item == replace(item)
    assert item.joint == item.subject and item.limit and item.limit_unit


@pytest.mark.parametrize(
    ("kind", "subject", "label"),
    [
        ("velocity", "y", "y: velocity"),
        ("payload", "load", "load: mass"),
        ("clearance", "ear", "ear: clearance"),
        ("speed of frame tip", "frame tip", "speed of frame tip"),
        ("goal", "goal", "goal"),
        ("gravity", "", "gravity"),
    ],
)
def test_label_of_a_sensitivity_has_its_subject(
    kind: str, subject: str, label: str
) -> None:
    """Regression: a subject whose name consists of letters of the kind was left out."""
    assert Sensitivity(kind, None, subject, 0.1).label == label


def test_command_line_reports_sensitivities(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    words = "plan planar3r --start 0.5 1.7 -1.7 --goal 1.2 0.8 -0.4 --no-output"
    words += " --intervals 8 --refine none --starts 1 --sensitivities"
    picture = tmp_path / "bars.svg"
    result = invoke([*words.split(), str(picture)])
    assert result.exit_code == 0, result.output
    assert "held by" in result.output and "effort, 1 % more: -" in result.output
    assert not re.search(r"more: \S+e-\d\d ms", result.output)  # rounding
    assert picture.stat().st_size > 1000


def test_alternative_goals_have_the_records_of_the_goal_reached() -> None:
    solution = planned("free")
    assert solution.trajectory is not None
    goal = tm.AnyGoal([JOINTS, tm.JointGoal([3.0, -1.0, 1.0])])
    found = analyse(replace(solution.problem, goal=goal), solution.trajectory)
    assert found == solution.sensitivities
    assert {item.joint for item in found.of("goal")} == {"joint1", "joint2", "joint3"}


def test_joint_region_goal_has_records_of_its_joints() -> None:
    width, step = 0.05, 0.02
    solutions = [
        tm.plan(
            tm.Problem(arm(), START, tm.JointRegionGoal({"joint3": x}, width)), **FINE
        )
        for x in (-0.4 - step, -0.4, -0.4 + step)
    ]
    by_plans = np.log(solutions[2].T / solutions[0].T) / (2.0 * step)
    (item,) = solutions[1].sensitivities.of("goal")
    assert (item.joint, item.unit, item.limit) == ("joint3", "1/rad", -0.4)
    assert item.value == pytest.approx(by_plans, rel=0.05)


def test_goals_of_several_arms_have_records_of_joints_and_frames() -> None:
    both = tm.combine_robots([("a", arm(), (0, 0, 0)), ("b", arm(), (0, 12, 0))])
    goals = [JOINTS.prefixed("a/", arm()), tm.PositionGoal("b/tip", (4, 13, 0))]
    problem = tm.Problem(both, (*START, *START), tm.AllGoals(goals))
    quick = {"effort": "quick", "refine": None}
    found = tm.plan(problem, **quick).sensitivities.of("goal")
    joints = {f"a/joint{k}" for k in (1, 2, 3)}
    assert {item.joint for item in found} == joints | {None}
    assert max(abs(item.value) for item in found) > 0.1


def test_segment_ends_of_a_motion_without_segments_are_ignored() -> None:
    solution = planned("free")
    motion = solution.trajectory
    assert motion is not None
    recorded = replace(motion, segment_ends=motion.t[[4, -1]])
    assert analyse(solution.problem, recorded) == solution.sensitivities


def test_path_constraints_have_records() -> None:
    solution = planned("free")
    assert solution.trajectory is not None
    state = solution.trajectory(np.linspace(0.0, solution.T, 200))
    ready = tm.ToolSpeed("tip", 1.0).on(solution.problem.robot)
    fastest = float(np.max(ready.measure_rows(state.q, state.v, state.a)))
    limit = tm.ToolSpeed("tip", fastest)
    problem = replace(solution.problem, constraints=(limit,))
    found = analyse(problem, solution.trajectory)
    (record,) = found.of("speed of frame tip")
    assert record.unit == "" and record.limit == fastest
    assert record.value <= 0.0 and np.all(np.isfinite(found.base))
