"""The bound that a plan tells: the best there is time for, a quick one in a search."""

from __future__ import annotations

import pytest
from two_link_cases import CASES

import tominpmp as tm
from tominpmp.options import Options
from tominpmp.planner.conclusion import _bound
from tominpmp.planner.progress import Progress
from tominpmp.stopping import Stop


@pytest.fixture(scope="module")
def problem() -> tm.Problem:
    return CASES["level"]["rods"].problem()


def test_a_search_takes_the_quick_bound_and_its_end_the_best(
    problem: tm.Problem,
) -> None:
    progress = Progress(Options())
    best, quick = tm.lower_bound(problem).T, tm.lower_bound(problem, quick=True).T
    assert quick < best
    assert progress.lower_bound(problem).T == quick
    found = _bound(problem, progress)
    assert found is not None
    assert found.T == best


def test_without_time_for_the_best_bound_the_quick_one_is_told(
    problem: tm.Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    progress = Progress(Options())
    quick = progress.lower_bound(problem)

    def late(problem: tm.Problem, known: float) -> None:
        raise Stop(requested=False)

    monkeypatch.setattr("tominpmp.planner.conclusion.lower_bound", late)
    assert _bound(problem, progress) is quick
