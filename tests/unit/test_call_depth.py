"""Depth of calls between `tm.plan` and the solver of its linear programs."""

from __future__ import annotations

import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

import tominpmp as tm
from tominpmp.linear_programs import piqp

PACKAGE = str(Path(tm.__file__).parent)
# Calls of the package between `tm.plan` and the solver of the programs.
MOST_CALLS = 8


def own_calls() -> tuple[str, ...]:
    """Names of the functions of the package from ``plan`` to the caller."""
    frame: FrameType | None = sys._getframe(1)
    found: list[str] = []
    while frame is not None:
        if frame.f_code.co_filename.startswith(PACKAGE):
            found.append(frame.f_code.co_name)
        frame = frame.f_back
    return tuple(found[::-1])


@pytest.mark.parametrize(
    "options", [{}, {"effort": "quick"}, {"effort": "quick", "refine": "grid"}]
)
def test_few_calls_lead_from_a_plan_to_its_programs(
    options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: there were 20 to 23 calls."""
    usual, found = piqp.PiqpSolver.solve, set[tuple[str, ...]]()

    def solve(solver: piqp.PiqpSolver, *arguments: Any) -> Any:
        found.add(own_calls())
        return usual(solver, *arguments)

    monkeypatch.setattr(piqp.PiqpSolver, "solve", solve)
    ball = tm.Sphere("ball", radius=0.4, position=(3.0, 1.0, 0.0))
    robot, goal = tm.load_robot("planar3r"), tm.JointGoal((2.0, -1.0, 0.5))
    solution = tm.plan(
        tm.Problem(robot, (0.5, 1.7, -1.7), goal, scene=tm.Scene([ball])),
        tm.Options(intervals=24, **options),
    )
    assert solution.success
    descents = [calls for calls in found if "solve_dual_program" not in calls]
    assert descents and all(calls[:2] == ("plan", "run") for calls in descents)
    assert max(map(len, descents)) <= MOST_CALLS
