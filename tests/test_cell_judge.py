"""The judge of random cells accepts right motions and refutes wrong motions."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tominpmp as tm
from benchmarks import cell_cases, random_cells
from benchmarks.cell_judge import Judge
from benchmarks.cell_movement import Movement, read_movement
from tominpmp.dynamics import RobotDynamics

Change = Callable[[dict[str, Any], dict[str, Any]], None]
# The rules of the judge do not depend on the number of intervals.
QUICK = {"effort": "quick", "refine": None}


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """A case of a Panda with a payload beside a ball, and the file of its motion."""
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
    # With constant accelerations, a jump of positions is reported as a jump.
    solution = tm.plan(problem, control="constant", **QUICK)
    random_cells.write_motion(solution.raise_if_failed(), path)
    return case, path


def faults_of(
    case: dict[str, Any], path: Path, change: Change | None = None
) -> list[str]:
    case = json.loads(json.dumps(case))
    values = vars(read_movement(path)).copy()
    if change is not None:
        change(case, values)
    found = Judge(case, Movement(**values))
    found.run()
    return found.faults


def test_judge_accepts_a_planned_motion(planned: tuple[dict[str, Any], Path]) -> None:
    assert faults_of(*planned) == []


def heavier(case: dict[str, Any], _: dict[str, Any]) -> None:
    case["arms"][0]["payload"]["mass"] = 1.1


def with_friction(case: dict[str, Any], _: dict[str, Any]) -> None:
    case["arms"][0]["friction"] = [0.5] * 7


def faster(_: dict[str, Any], values: dict[str, Any]) -> None:
    values["t"], values["breaks"] = 0.98 * values["t"], 0.98 * values["breaks"]
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
        (with_friction, "torque"),
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
def test_judge_refutes_a_wrong_motion(
    planned: tuple[dict[str, Any], Path], change: Change, word: str
) -> None:
    assert word in " ".join(faults_of(*planned, change))


def test_judge_does_not_interpolate_over_an_instant_beside_a_node(
    planned: tuple[dict[str, Any], Path],
) -> None:
    """Reversals of joints are instants of this kind: polynomials over the tiny interval
    would consist of rounding errors.
    """

    def divided(_: dict[str, Any], values: dict[str, Any]) -> None:
        k, breaks, u = 20, values["breaks"], values["u"]
        there = np.repeat(Movement(**values).torque(k, np.zeros(1)), u.shape[1], axis=0)
        values["breaks"] = np.insert(breaks, k + 1, breaks[k] + 1e-10)
        values["u"] = np.insert(u, k, there, axis=0)

    def as_a_node(case: dict[str, Any], values: dict[str, Any]) -> None:
        move = Movement(**values)
        divided(case, values)
        found = move.between(20, np.array([1e-10 / np.diff(move.t)[20]]))
        values["t"] = values["breaks"]
        for key, row in zip("qv", found[:2], strict=True):
            values[key] = np.insert(values[key], 21, row[0], axis=0)
        values["a"] = None

    assert faults_of(*planned, divided) == []
    assert "torque" in " ".join(faults_of(*planned, as_a_node))


@pytest.fixture(scope="module")
def gentle(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """An xArm 7, which has dry friction, comes to rest with a bounded jerk."""
    arm = cell_cases.draw_arm(np.random.default_rng(0), "xarm7", "free")
    arm.pop("velocity", None)
    q_start = np.array([0.2, -0.4, 0.1, 0.9, -0.3, 0.7, 0.4])
    q_goal = q_start + np.array([0.5, 0.2, -0.3, 0.12, 0.02, -0.3, 0.2])
    case = {
        "arms": [arm],
        "gravity": [0.0, 0.0, -9.81],
        "obstacles": [],
        "margin": 0.0,
        "q_start": q_start.tolist(),
        "v_start": [0.0] * 7,
        "goal": {"kind": "joint", "q": q_goal.tolist(), "v": [0.0] * 7},
        "acceleration": [8.0] * 7,
        "jerk": [400.0] * 7,
    }
    limits = tm.MotionLimits(acceleration=case["acceleration"], jerk=case["jerk"])
    problem = tm.Problem(
        cell_cases.build_arm(arm), q_start, tm.JointGoal(q_goal), motion_limits=limits
    )
    path = tmp_path_factory.mktemp("gentle") / "motion.npz"
    random_cells.write_motion(tm.plan(problem, **QUICK).raise_if_failed(), path)
    return case, path


def test_judge_accepts_a_jerk_limited_stop_with_friction(
    gentle: tuple[dict[str, Any], Path],
) -> None:
    assert faults_of(*gentle) == []


@pytest.mark.parametrize("duration", [1.5e-5, 4e-6, 1e-6, 3e-7])
@pytest.mark.parametrize("end", ["start", "stop"])
def test_judge_refutes_wrong_friction_for_microseconds(
    gentle: tuple[dict[str, Any], Path], end: str, duration: float
) -> None:
    def reversed_beside_an_end(case: dict[str, Any], values: dict[str, Any]) -> None:
        move, first = Movement(**values), end == "start"
        edge = move.t[0] + duration if first else move.t[-1] - duration
        p = int(np.searchsorted(move.breaks, edge)) - 1
        begin, h = move.breaks[p], np.diff(move.breaks)[p]
        cut = (edge - begin) / h
        halves = [
            move.torque(p, x) for x in (cut * move.share, cut + (1 - cut) * move.share)
        ]
        joint = int(np.argmax(np.abs(move.v[1 if first else -2])))
        sign = np.sign(move.v[1 if first else -2, joint])
        halves[0 if first else 1][:, joint] -= 2.0 * sign
        values["breaks"] = np.insert(move.breaks, p + 1, edge)
        values["u"] = np.concatenate([move.u[:p], halves, move.u[p + 1 :]])

    assert "torque" in " ".join(faults_of(*gentle, reversed_beside_an_end))


def reversing_motion(
    gentle: tuple[dict[str, Any], Path], residual: float, folder: Path
) -> tuple[dict[str, Any], Path]:
    """A motion whose joints all reverse at a node, with a residual velocity there."""
    case = json.loads(json.dumps(gentle[0])) | {"acceleration": None, "jerk": None}
    robot = cell_cases.build_arm(case["arms"][0])
    case["v_start"] = [-0.2] * 7
    t = np.array([0.0, 0.1, 0.2])
    v = np.outer([-0.2, residual, 0.1], np.ones(7))
    h = np.diff(t)[:, None]
    moved = np.cumsum(0.5 * h * (v[1:] + v[:-1]), axis=0)
    q = np.array(case["q_start"]) + np.vstack([np.zeros(7), moved])
    case["goal"] = {"kind": "joint", "q": q[-1].tolist(), "v": v[-1].tolist()}
    draft = tm.Trajectory(robot.joint_names, t, q, v, 0.0 * q, np.diff(v, axis=0) / h)
    motion = draft.with_torques(RobotDynamics(robot).inverse)
    problem = SimpleNamespace(robot=robot)
    path = folder / "turning.npz"
    random_cells.write_motion(SimpleNamespace(trajectory=motion, problem=problem), path)
    return case, path


@pytest.mark.parametrize("residual", [0.0, 5e-9, -5e-9, 9e-8, -9e-8])
def test_judge_accepts_a_reversal_beside_a_node(
    gentle: tuple[dict[str, Any], Path], residual: float, tmp_path: Path
) -> None:
    assert faults_of(*reversing_motion(gentle, residual, tmp_path)) == []


@pytest.mark.parametrize("duration", [1e-6, 3e-7])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_judge_refutes_wrong_friction_beside_a_reversal(
    gentle: tuple[dict[str, Any], Path], side: float, duration: float, tmp_path: Path
) -> None:
    def too_early_or_late(case: dict[str, Any], values: dict[str, Any]) -> None:
        move = Movement(**values)
        edge, p = move.t[1] + side * duration, 0 if side < 0.0 else 1
        cut = (edge - move.breaks[p]) / np.diff(move.breaks)[p]
        halves = [
            move.torque(p, x) for x in (cut * move.share, cut + (1 - cut) * move.share)
        ]
        wrong = 1 if side < 0.0 else 0
        halves[wrong] = halves[wrong] - 2.0 * side * np.array(
            case["arms"][0]["friction"]
        )
        values["breaks"] = np.insert(move.breaks, p + 1, edge)
        values["u"] = np.concatenate([move.u[:p], halves, move.u[p + 1 :]])

    case, path = reversing_motion(gentle, 0.0, tmp_path)
    assert "torque" in " ".join(faults_of(case, path, too_early_or_late))


@pytest.mark.slow
def test_short_campaign_of_random_cells_has_no_faults(tmp_path: Path) -> None:
    arguments = ["--count", "2", "--seed", "11", "--kinds", "free,friction"]
    arguments += ["--csv", str(tmp_path / "a.csv"), "--folder", str(tmp_path)]
    assert random_cells.main(arguments) == 0
