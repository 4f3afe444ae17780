"""The judge of random cells: right motions pass, wrong ones of any kind do not."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tominpmp as tm
from benchmarks import cell_cases, random_cells
from benchmarks.cell_judge import Judge
from benchmarks.cell_movement import Movement, read_movement

Change = Callable[[dict[str, Any], dict[str, Any]], None]


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """A case of a Panda with a load beside a ball, and the file of its motion."""
    arm = cell_cases.draw_arm(np.random.default_rng(0), "panda", "free")
    arm.pop("velocity", None)
    arm["payload"] = {"mass": 1.0, "frame": "panda_hand", "com": [0, 0, 0.1]}
    arm["payload"]["radius"] = 0.03
    ball = {"name": "ball", "shape": "sphere", "size": [0.1], "rotation": [0, 0, 0, 1]}
    ball |= {"position": [0.6, 0.0, 0.35], "velocity": [0.0, 0.05, 0.0]}
    q_start = [-0.6, -0.3, 0.0, -2.2, 0.0, 2.0, 0.8]
    q_goal = [0.9, -0.2, 0.0, -2.0, 0.0, 1.8, 0.8]
    case = {
        "arms": [arm],
        "gravity": [0.0, 0.0, -9.81],
        "obstacles": [ball],
        "margin": 0.01,
        "q_start": q_start,
        "v_start": [0.0] * 7,
        "goal": {"kind": "joint", "q": q_goal, "v": [0.0] * 7},
    }
    problem = tm.Problem(
        cell_cases.build_arm(arm),
        q_start,
        tm.JointGoal(q_goal),
        scene=tm.Scene([cell_cases.build_obstacle(ball)]),
        margin=0.01,
    )
    path = tmp_path_factory.mktemp("judge") / "motion.npz"
    random_cells.write_motion(tm.plan(problem).raise_if_failed(), path)
    return case, path


def judge(case: dict[str, Any], path: Path, change: Change | None = None) -> list[str]:
    case = json.loads(json.dumps(case))
    values = vars(read_movement(path)).copy()
    if change is not None:
        change(case, values)
    found = Judge(case, Movement(**values))
    found.run()
    return found.faults


def test_a_right_motion_passes(planned: tuple[dict[str, Any], Path]) -> None:
    assert judge(*planned) == []


def heavier(case: dict[str, Any], _: dict[str, Any]) -> None:
    case["arms"][0]["payload"]["mass"] = 1.1


def rubbing(case: dict[str, Any], _: dict[str, Any]) -> None:
    case["arms"][0]["friction"] = [0.5] * 7


def faster(_: dict[str, Any], values: dict[str, Any]) -> None:
    values["t"] = 0.98 * values["t"]
    values["v"] = values["v"] / 0.98
    if values["a"] is not None:
        values["a"] = values["a"] / 0.98**2


def elsewhere(case: dict[str, Any], _: dict[str, Any]) -> None:
    case["goal"]["q"][3] += 2e-3


def in_the_way(case: dict[str, Any], values: dict[str, Any]) -> None:
    case["obstacles"][0]["position"] = [0.45, 0.1, 0.4]


def quicker_gate(case: dict[str, Any], values: dict[str, Any]) -> None:
    case["obstacles"][0]["velocity"] = [0.0, 0.0, 5.0]
    case["obstacles"][0]["position"] = [0.5, 0.0, -1.0]


def weaker(case: dict[str, Any], _: dict[str, Any]) -> None:
    case["arms"][0]["effort"] = [87, 87, 87, 87, 12, 12, 6]
    case["arms"][0]["effort"][0] = 20


def slower(case: dict[str, Any], _: dict[str, Any]) -> None:
    case["arms"][0]["velocity"] = [2.1] * 7


def jumping(_: dict[str, Any], values: dict[str, Any]) -> None:
    values["q"] = values["q"].copy()
    values["q"][10:] += 1e-4


def accelerating(case: dict[str, Any], _: dict[str, Any]) -> None:
    case["acceleration"] = [5.0] * 7


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (heavier, "torque"),
        (rubbing, "torque"),
        (faster, "torque"),
        (elsewhere, "goal"),
        (in_the_way, "room"),
        (quicker_gate, "room"),
        (weaker, "effort"),
        (slower, "velocity"),
        (jumping, "jump"),
        (accelerating, "acceleration"),
    ],
)
def test_a_wrong_motion_is_refuted(
    planned: tuple[dict[str, Any], Path], change: Change, word: str
) -> None:
    assert word in " ".join(judge(*planned, change))


@pytest.mark.slow
def test_a_short_campaign(tmp_path: Path) -> None:
    arguments = ["--count", "3", "--seed", "11", "--kinds", "free,friction,two_arms"]
    arguments += ["--csv", str(tmp_path / "a.csv"), "--folder", str(tmp_path)]
    assert random_cells.main(arguments) == 0
