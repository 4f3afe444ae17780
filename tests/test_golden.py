"""The golden set: its problems, its judge, its runs and its comparisons."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest

import tominpmp as tm
from benchmarks import ablation, golden, golden_cases, golden_fresh
from benchmarks.cell_arms import inverse
from benchmarks.cell_movement import Movement
from benchmarks.golden_compare import Allowed, Comparison
from benchmarks.golden_judge import Leg, judge, shape
from benchmarks.golden_problems import arm, asked, joint, task
from benchmarks.golden_runner import (
    COLUMNS,
    DIED,
    OVER,
    Row,
    Rows,
    groups_of,
    items,
    measure,
    read_rows,
    run,
)
from benchmarks.random_cells import CHEBYSHEV

START, END = np.array([0.5, 1.7, -1.7]), np.array([1.0, 1.0, -1.0])
SOON = {"effort": "quick", "intervals": 16, "refine": None}


def row(name: str, **columns: object) -> Row:
    """A row of a run."""
    usual = {"group": "goals", "part": "tuned", "seed": "0", "fingerprint": "x"}
    usual |= {"status": "CONVERGED", "success": "True", "T": "1", "programs": "10"}
    usual |= {"seconds": "2", "promise": "0.001", "revision": "abc", "name": name}
    empty = dict.fromkeys(COLUMNS, "")
    return empty | usual | {key: str(value) for key, value in columns.items()}


def compared(before: list[Row], after: list[Row]) -> Comparison:
    """The comparison of two runs."""
    first, second = ({(r["group"], r["name"]): r for r in x} for x in (before, after))
    return Comparison(first, second)


# -- problems --------------------------------------------------------------------------


@pytest.mark.parametrize("part", ["tuned", "fresh"])
def test_names_of_golden_problems_are_unique(part: str) -> None:
    names = [(item.group, item.name) for item in items(part, seed=3)]
    assert len(set(names)) == len(names)
    assert {group for group, _ in names} == set(groups_of(part)) - {"clutter", "fetch"}


def test_tuned_part_has_every_group_and_constraint() -> None:
    counts = {group: 0 for group in golden_cases.GROUPS}
    for item in items("tuned"):
        counts[item.group] += 1
    assert counts["optima"] == 36
    assert counts["goals"] + counts["goals x 4"] == 60
    assert sum(counts.values()) >= 150
    kinds = {rule for rule, _, _ in _rules()}
    assert kinds >= {"tool_speed", "upright", "keep_away", "coupling"}


def _rules() -> list[tuple[str, ...]]:
    names = [name for name, _ in golden_cases.rules(golden_cases.Source())]
    return [(*name.split(" "), "", "")[:3] for name in names]


def test_fingerprint_identifies_a_problem() -> None:
    one, other = (golden_cases.goal_task("planar3r", 0) for _ in range(2))
    assert one.fingerprint == other.fingerprint
    assert golden_cases.goal_task("planar3r", 1).fingerprint != one.fingerprint
    faster = golden_cases.goal_task("planar3r", 0, speed_factor=4.0)
    assert faster.fingerprint != one.fingerprint


def test_fresh_problems_are_determined_by_the_seed() -> None:
    prints = [
        golden_fresh.scene_task(seed, "iiwa14", 0).fingerprint for seed in (1, 1, 2)
    ]
    assert prints[0] == prints[1] != prints[2]


def test_combined_problem_has_a_motion_without_faults() -> None:
    golden_task = golden_fresh.combined_task(1, 3)
    solution = tm.plan(golden_task.problem, **SOON)
    assert solution.success, solution.message
    assert golden_task.judged(solution).faults == ()


def test_combined_problem_starts_without_self_collision() -> None:
    # Regression: links touched at the first configuration, from which no path leads.
    assert golden_fresh.combined_task(20261126, 5).problem.checker.pairs


def test_slow_motion_of_a_combined_problem_keeps_accelerations() -> None:
    case, slow = golden_fresh.combined_case(20261126, 16)
    goals = [case["q_start"], *(leg["goal"]["q"] for leg in case["legs"])]
    # The peak of a polynomial of degree five from rest to rest.
    peaks = 10.0 / np.sqrt(3.0) * np.abs(np.diff(goals, axis=0))
    assert slow >= np.sum(np.sqrt(np.max(peaks / case["acceleration"], axis=1)))


# -- the judge -------------------------------------------------------------------------


def test_judge_compares_continuous_joints_modulo_a_turn() -> None:
    own = arm("kinova")
    start = np.array([0.0, 2.9, 1.3, -2.1, 1.4, 0.0])
    goal = start + np.array([6.0, 0.0, 0.0, 0.2, 0.0, 0.0])
    solution = tm.plan(task(asked(own, start, joint(goal))).problem, **SOON)
    assert solution.trajectory.q[-1, 0] < 0.0
    found = judge(asked(own, start, joint(goal)), solution)
    assert found.faults == ()
    wrong = judge(asked(own, start, joint(goal + 0.1)), solution)
    assert "goal" in " ".join(wrong.faults)


def plain(**more: object) -> dict[str, object]:
    """A joint goal of the planar arm."""
    return asked(arm("planar3r"), START, joint(END)) | more


@pytest.fixture(scope="module")
def solution() -> tm.Solution:
    """A motion of the planar arm."""
    return tm.plan(task(plain()).problem, **SOON)


def test_judge_accepts_a_planned_motion(solution: tm.Solution) -> None:
    verdict = task(plain()).judged(solution)
    assert verdict.faults == ()
    assert -0.01 < verdict.excess < 5e-3


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"effort": 0.97}, "effort"),
        ({"velocity": 0.01}, "velocity"),
        ({"damping": 1.2}, "torque"),
        ({"friction": 0.05}, "torque"),
    ],
)
def test_judge_refutes_a_motion_for_another_arm(
    solution: tm.Solution, change: dict[str, float], word: str
) -> None:
    case = plain()
    own = dict(case["arms"][0])
    for name, factor in change.items():
        values = np.array(own["effort" if name in ("damping", "friction") else name])
        own[name] = (values * factor * (0.01 if name == "damping" else 1.0)).tolist()
    found = judge({**case, "arms": [own]}, solution).faults
    assert any(word in fault for fault in found), found


@pytest.mark.parametrize(
    ("more", "word"),
    [
        ({"legs": [{"goal": joint(END + 0.01)}]}, "goal missed"),
        ({"q_start": (START + 0.01).tolist()}, "start"),
        ({"acceleration": [1.0] * 3}, "acceleration"),
        ({"effort_rate": [1.0] * 3}, "torque rate"),
        ({"period": 0.0123}, "clock"),
        ({"legs": [{"goal": joint(END), "arrival": [9.0, 10.0]}]}, "arrives"),
        ({"legs": [{"goal": joint(END), "dwell": 0.3}]}, "stay"),
        (
            {"obstacles": [shape("sphere", (0.5,), position=(2.0, 2.5, 0.0))]},
            "room",
        ),
        (
            {"rules": [{"kind": "tool_speed", "frame": "tip", "limit": 0.5}]},
            "tool_speed",
        ),
        (
            {
                "rules": [
                    {
                        "kind": "stable",
                        "frame": "tip",
                        "center": [0.0, 0.1, 0.0],
                        "friction": 0.1,
                        "support": 0.01,
                        "mass": 1.0,
                    }
                ]
            },
            "stable",
        ),
    ],
)
def test_judge_refutes_a_motion_for_another_problem(
    solution: tm.Solution, more: dict[str, object], word: str
) -> None:
    found = judge(plain(**more), solution).faults
    assert any(word in fault for fault in found), found


def test_judge_ignores_reversals_by_rounding() -> None:
    case = asked(arm("planar3r", friction=0.1), START, joint(END))
    case |= {"v_start": [0.1] * 3, "effort_rate": [500.0] * 3}
    t, v = np.array([0.0, 0.1]), np.array([case["v_start"], [-5e-7] * 3])
    q = np.array([START, START + 0.01 / 3.0])
    still = np.zeros((1, CHEBYSHEV.size, 3))
    move = Movement(t, q, v, None, t, CHEBYSHEV, still, held=False)
    leg = Leg(case, move, 0.0, last=True)
    moved = inverse(leg.members, *move.state(0, CHEBYSHEV)[:3])
    move = dataclasses.replace(move, u=(moved + leg.plant.friction)[None])
    leg = Leg(case, move, 0.0, last=True)
    leg.limits_and_torques()
    leg.replay()
    assert leg.faults == []


def test_judge_refutes_motions_faster_than_a_known_optimum() -> None:
    golden_task = golden_cases.optimum("rail", "rail")
    found = measure(golden_task)
    assert found["success"] and found["faults"] == ""
    solution = tm.plan(golden_task.problem)
    motion = solution.trajectory
    assert motion is not None
    quicker = dataclasses.replace(motion, t=0.9 * motion.t)
    refuted = golden_task.judged(dataclasses.replace(solution, trajectory=quicker))
    assert any("minimum" in fault for fault in refuted.faults)
    assert any("limits off" in fault for fault in refuted.faults)


# -- runs ------------------------------------------------------------------------------


def test_run_writes_each_row_once_and_repeats_crashed_problems(tmp_path: Path) -> None:
    path = tmp_path / "golden.csv"
    selected = [
        x for x in items("tuned", ["optima"]) if x.name in ("rail", "two rails")
    ]
    shown: list[Row] = []
    for _ in range(2):
        run(selected, Rows(path, "abc"), "abc", jobs=2, show=shown.append)
    known = read_rows(path)
    assert len(shown) == len(known) == 2
    assert {one["name"]: one["status"] for one in known.values()} == {
        "rail": "CONVERGED",
        "two rails": "CONVERGED",
    }
    with pytest.raises(SystemExit, match="revision abc"):
        Rows(path, "def")
    with path.open(newline="") as file:
        lines = list(csv.reader(file))
    lines[1][COLUMNS.index("status")] = f"{DIED} -9"
    with path.open("w", newline="") as file:
        csv.writer(file).writerows(lines)
    assert len(Rows(path, "abc").rows) == 1


def test_problem_beyond_the_time_limit_is_ended(tmp_path: Path) -> None:
    (selected, *_) = items("tuned", ["goals"])
    rows = Rows(tmp_path / "golden.csv", "abc")
    run([selected], rows, "abc", limit=0.2)
    (found,) = rows.rows.values()
    assert found["status"] == OVER and found["success"] == "False"


# -- comparisons -----------------------------------------------------------------------


def test_equal_runs_are_within_every_limit() -> None:
    rows = [row("a"), row("b", T=2)]
    limits = Allowed(t_median=0.0, t_max=0.0, programs=1.0, seconds=1.0, promise=0.0)
    comparison = compared(rows, rows)
    assert comparison.beyond(limits) == []
    assert "| goals | 2 | 2 -> 2 | +0.000 %" in comparison.report()


@pytest.mark.parametrize(
    ("after", "limits", "word"),
    [
        ({"T": 1.01}, {"t_max": 0.005}, "T, most"),
        ({"T": 1.01}, {"t_median": 0.001}, "T, median"),
        ({"programs": 12}, {"programs": 1.05}, "programs"),
        ({"seconds": 3}, {"seconds": 1.2}, "processor time"),
        ({"promise": 0.01}, {"promise": 0.001}, "promise"),
        ({"success": False}, {}, "lost"),
        ({"faults": "effort off"}, {}, "lost"),
        ({"fingerprint": "y"}, {}, "changed"),
        ({"name": "c"}, {}, "changed"),
        ({"objective": 2.0}, {"objective_max": 0.5}, "objective"),
    ],
)
def test_worse_run_is_beyond_its_limit(
    after: dict[str, object], limits: dict[str, float], word: str
) -> None:
    before = [row("a", objective=1.0), row("b")]
    other = {"objective": 1.0} | after
    comparison = compared(before, [row(**{"name": "a"} | other), row("b")])
    if "T" in after and "t_median" in limits:
        comparison = compared([row("a")], [row("a", **after)])
    beyond = comparison.beyond(Allowed(**limits))
    assert len(beyond) == 1 and word in beyond[0]


def test_compare_command_reports_and_exits_with_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for path, T in zip(paths, (1.0, 1.01), strict=True):
        rows = Rows(path, "abc")
        rows.add(row("slow one", T=T))
        rows.add(row("other"))
    words = ["compare", *map(str, paths)]
    assert golden.main(words) == 0
    assert golden.main([*words, "--t-max", "0.005"]) == 1
    out = capsys.readouterr().out
    assert "+1.000 % (slow one)" in out
    assert "BEYOND ITS LIMIT: T, most: 0.01, and 0.005 is allowed" in out


# -- ablation --------------------------------------------------------------------------


@pytest.mark.parametrize("name", ablation.VARIANTS)
def test_every_ablation_variant_switches_an_existing_part(name: str) -> None:
    golden_task = golden_cases.optimum("rail", "rail")
    with ablation.switched(name, golden_task) as changed:
        assert changed.options == {
            **golden_task.options,
            **ablation.VARIANTS[name].options,
        }


def test_ablation_restores_the_planner() -> None:
    golden_task = golden_cases.optimum("rail", "rail")
    before = measure(golden_task, judged=False)
    with ablation.switched("one descent", golden_task) as changed:
        measure(changed, judged=False)
    after = measure(golden_task, judged=False)
    assert after["T"] == before["T"] and after["programs"] == before["programs"]


def test_ablation_table_has_every_variant_beside_the_planner() -> None:
    rows = [row("a"), row("b")]
    rows += [row("a", variant="quick", T=1.02, programs=5), row("b", variant="quick")]
    assert "| quick | +1.00 (2.0) / 0.75 | +1.00 (2.0) / 0.75 |" in ablation.table(rows)
