"""The table of the demo marks motions that were cut off or violate a constraint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tominpmp as tm
from examples import paper_demo


@pytest.fixture(scope="module")
def solution() -> tm.Solution:
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, paper_demo.START, tm.JointGoal([0.6, 1.6, -1.6]))
    return tm.plan(problem, intervals=8, starts=1, refine=None)


def test_cut_off_and_violating_motions_are_marked(
    solution: tm.Solution,
) -> None:
    T = f"{solution.T:.4f}"
    cut = replace(solution, status=tm.Status.TIME_LIMIT)
    broken = replace(cut, feasible=False)
    assert paper_demo.row(solution)[0] == T
    assert paper_demo.row(cut)[0] == f"{T}+"
    # Not infinite: also an infeasible motion has a duration.
    assert paper_demo.row(broken)[0] == f"{T}*+"
    assert paper_demo.row(replace(broken, trajectory=None))[0] == "none*+"
    # The labels of the figures say the same.
    assert paper_demo.label("penalty", solution) == "penalty"
    text = paper_demo.label("penalty", broken)
    assert text == "penalty, goal or limits violated, cut off"


def test_different_local_optima_of_a_row_get_letters(
    solution: tm.Solution, capsys: pytest.CaptureFixture[str]
) -> None:
    """Regression: 0.8600 and 1.0455 stood in one row, as if one of them were wrong."""
    motion = solution.trajectory
    assert motion is not None
    turned = replace(motion, q=motion.q + np.array([0.0, 0.0, 2.0 * paper_demo.APART]))
    other = replace(solution, trajectory=turned)
    case, gravity = paper_demo.CASES[1], "none"
    found = {
        (c, g, m): other if (c, g, m) == (case, gravity, "collocation") else solution
        for g in paper_demo.GRAVITIES
        for c in paper_demo.CASES
        for m in paper_demo.METHODS
    }
    paper_demo.print_table(paper_demo.Console(width=160), found, 20.0)
    lines = capsys.readouterr().out.splitlines()
    T = f"{solution.T:.4f}"
    marked = [line for line in lines if f"{T} a (" in line]
    assert len(marked) == 1 and case in marked[0] and gravity in marked[0]
    assert marked[0].count(f"{T} a (") == 3 and marked[0].count(f"{T} b (") == 1
    assert "local optima" in "".join(lines)
    assert any(f"{case}, gravity {gravity}: a ends with" in line for line in lines)


def test_table_explains_its_marks(
    solution: tm.Solution, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = [
        (c, g, m)
        for g in paper_demo.GRAVITIES
        for c in paper_demo.CASES
        for m in paper_demo.METHODS
    ]
    console = paper_demo.Console(width=160)
    cut = replace(solution, status=tm.Status.TIME_LIMIT, feasible=False, violations={})
    paper_demo.print_table(console, dict.fromkeys(keys, solution), 20.0)
    assert "*" not in capsys.readouterr().out
    paper_demo.print_table(console, dict.fromkeys(keys, cut), 20.0)
    text = capsys.readouterr().out
    assert "cut off after 20 s" in text and "violated" in text
