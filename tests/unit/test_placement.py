"""Placing a base or goals better by the gradients of the motion times."""

from __future__ import annotations

import pickle
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import tominpmp as tm
from tominpmp.cell.placement import Moves, _checked
from tominpmp.kinematics import RobotKinematics

START = (0.5, 1.7, -1.7)
QUICK: dict[str, Any] = {"intervals": 12, "starts": 1, "refine": None}


@cache
def robot() -> tm.Robot:
    return tm.load_robot("planar3r", gravity=(0.0, 0.0, 0.0))


@cache
def tasks() -> tuple[tm.Problem, ...]:
    goals = [tm.PositionGoal("tip", p) for p in ((4.0, 1.0, 0.0), (3.0, 3.5, 0.0))]
    return tuple(tm.Problem(robot(), START, goal) for goal in goals)


def test_robot_at_moves_the_base_of_a_robot() -> None:
    base = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([1.0, 2.0, 0.3]))
    moved = tm.robot_at(robot(), base)
    q = np.array(START)
    before, after = (RobotKinematics(r).placement(q, "tip") for r in (robot(), moved))
    assert after.isApprox(base * before, 1e-12)
    assert moved.joint_names == robot().joint_names
    again = tm.robot_at(moved, pin.SE3.Identity())
    assert RobotKinematics(again).placement(q, "tip").isApprox(before, 1e-12)


def test_improved_base_placement_shortens_the_tasks() -> None:
    bounds = {"x": (-0.3, 0.3), "yaw": (-0.3, 0.3)}
    found = tm.improve_placement(
        robot(), tasks(), bounds=bounds, most_plans=12, **QUICK
    )
    assert found.T < 0.97 * found.T_before
    assert found.plans <= 12 and found.trials[-1].plans == found.plans
    assert min(trial.T for trial in found.trials) == found.T
    low, high = np.array(list(bounds.values())).T
    assert np.all((found.values >= low - 1e-12) & (found.values <= high + 1e-12))
    assert len(found.solutions) == 2
    again = [tm.plan(s.problem, **QUICK).T for s in found.solutions]
    assert sum(again) == pytest.approx(found.T, rel=5e-3)
    assert "T_before" in repr(found)
    assert pickle.loads(pickle.dumps(found)) == found


def test_goals_can_move_and_tasks_have_weights() -> None:
    found = tm.improve_placement(
        robot(),
        tasks()[:1],
        bounds={"y": (0.0, 0.5)},
        moves="goals",
        weights=[2.0],
        most_plans=6,
        **QUICK,
    )
    goal = found.solutions[0].problem.goal
    assert isinstance(goal, tm.PositionGoal)
    assert goal.position[1] == pytest.approx(1.0 + found.values[0])
    assert found.T <= found.T_before
    assert found.T == pytest.approx(2.0 * found.solutions[0].T)


def test_base_is_not_placed_where_a_task_has_no_motion() -> None:
    far = {"x": (-9.0, 0.0)}
    found = tm.improve_placement(
        robot(), tasks()[:1], bounds=far, most_plans=4, **QUICK
    )
    assert found.T <= found.T_before


def test_placement_where_a_motion_has_no_sensitivities_is_not_the_last_trial(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Regression: the search was lost where the linear program of a motion failed."""
    usual, calls = Moves.gradient, []

    def gradient(moves: Moves, *where: Any) -> Any:
        calls.append(moves)
        if len(calls) == 2:
            raise tm.ProblemError("trajectory of 1 s has no multipliers", "trajectory")
        return usual(moves, *where)

    monkeypatch.setattr(Moves, "gradient", gradient)
    near = {"x": (-0.3, 0.3)}
    found = tm.improve_placement(
        robot(), tasks()[:1], bounds=near, most_plans=3, **QUICK
    )
    known = [np.isfinite(trial.T) for trial in found.trials]
    assert known == [True, False, True] and found.T < found.T_before


def test_search_ends_where_no_time_is_left() -> None:
    """Regression: the same placement was tried until the plans ran out."""
    start = RobotKinematics(robot()).placement(np.array(START), "tip").translation
    goal = tm.PositionGoal("tip", start + np.array([0.0, 0.15, 0.0]))
    task = tm.Problem(robot(), START, goal)
    bounds = {"y": (-1.0, 0.0)}
    found = tm.improve_placement(robot(), [task], bounds=bounds, moves="goals", **QUICK)
    assert found.T == 0.0 and found.plans == 2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"robot": 3}, "robot is 3"),
        ({"tasks": []}, "tasks is"),
        ({"tasks": [3]}, r"tasks\[0\] is 3"),
        ({"bounds": {}}, "bounds is {}"),
        ({"bounds": 3}, "bounds is 3"),
        ({"bounds": {"w": (0, 1)}}, r"bounds\['w'\] is \(0, 1\), expected"),
        ({"bounds": {"x": (0.5, 1)}}, "a range about zero"),
        ({"bounds": {"yaw": (-90.0, 90.0)}}, r"\[-90.0, 90.0\].* within 6\.3"),
        ({"bounds": {"yaw": (-1, 1)}, "moves": "goals"}, "only the base"),
        ({"moves": "table"}, "moves is 'table'"),
        ({"moves": ()}, "moves is"),
        ({"weights": [1.0]}, "weights is"),
        ({"most_plans": 0}, "most_plans is 0"),
        ({"base": "here"}, "base: the base of .* is 'here'"),
        ({"base": (50.0, 0.0, 0.0)}, "goal|number 1 of 2"),
    ],
)
def test_wrong_arguments_are_named_in_the_error(
    changes: dict[str, Any], message: str
) -> None:
    given = {"robot": robot(), "tasks": tasks(), "bounds": {"x": (-1.0, 1.0)}}
    with pytest.raises(tm.ProblemError, match=message):
        tm.improve_placement(**{**given, **QUICK, **changes})


def test_bounds_of_a_rounded_turn_are_taken() -> None:
    """Regression: 6.2832 rad were refused, as they are beyond a turn by rounding."""
    _, low, high = _checked(list(tasks()), {"yaw": (-6.2832, 6.2832)})
    assert (low.item(), high.item()) == (-6.2832, 6.2832)


def test_interrupted_plan_ends_the_search() -> None:
    """Regression: the search used the motion of the interrupted plan, and continued."""
    calls = []

    def second_plan(record: Any) -> bool:
        calls.append(record)
        return [item.iteration for item in calls].count(0) > len(tasks())

    options = tm.Options(**QUICK, callback=second_plan)
    bounds = {"x": (-0.5, 0.5), "y": (-0.5, 0.5)}
    with pytest.raises(KeyboardInterrupt):
        tm.improve_placement(robot(), tasks(), bounds=bounds, options=options)
