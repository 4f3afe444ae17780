"""The table of the demo says of each motion what it is, on a slow machine too."""

from __future__ import annotations

from dataclasses import replace

import pytest

import tominpmp as tm
from examples import paper_demo


@pytest.fixture(scope="module")
def solution() -> tm.Solution:
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, paper_demo.START, tm.JointGoal([0.6, 1.6, -1.6]))
    return tm.plan(problem, intervals=8, starts=1, refine=None)


def test_what_was_cut_off_or_violates_something_is_marked(
    solution: tm.Solution,
) -> None:
    T = f"{solution.T:.4f}"
    cut = replace(solution, status=tm.Status.TIME_LIMIT)
    broken = replace(cut, feasible=False)
    assert paper_demo.row(solution)[0] == T
    assert paper_demo.row(cut)[0] == f"{T}+"
    # Not infinite: the best motion there is has a duration.
    assert paper_demo.row(broken)[0] == f"{T}*+"
    assert paper_demo.row(replace(broken, trajectory=None))[0] == "none*+"
    # The figures say so, too.
    assert paper_demo.label("penalty", solution) == "penalty"
    said = paper_demo.label("penalty", broken)
    assert said == "penalty, goal or limits violated, cut off"


def test_the_marks_are_explained(
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
    said = capsys.readouterr().out
    assert "not done after 20 s" in said and "violated" in said
