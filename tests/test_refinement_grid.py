"""Refined grids: which intervals are split, and how much shorter the motion gets."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from two_link_cases import CASES

import tominpmp as tm
from tominpmp.options import Tolerances
from tominpmp.transcription.bspline import InverseTranscription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.layout import split_intervals
from tominpmp.transcription.problem_functions import ProblemFunctions

FEW = 8


@cache
def planned(
    family: str, name: str, method: str, refine: str | None, intervals: int = FEW
) -> tm.Solution:
    options = tm.Options(
        method=method,  # type: ignore[arg-type]
        refine=refine,  # type: ignore[arg-type]
        intervals=intervals,
        control="constant",
        starts=1,
    )
    return tm.plan(CASES[family][name].problem(), options)


@pytest.mark.parametrize("method", ["inverse", "collocation"])
@pytest.mark.parametrize(
    ("family", "name"),
    [
        ("rail", "rail, speed limit"),
        ("pendulum", "pendulum, upright"),
        ("level", "rods, friction"),
    ],
)
def test_refinement_of_a_coarse_grid_meets_the_tolerances(
    family: str, name: str, method: str
) -> None:
    """Refined from 8 intervals, the replay meets its tolerances, and T falls."""
    rough = planned(family, name, method, None)
    solution = planned(family, name, method, "grid")
    assert solution.success, solution.message
    assert solution.verification is not None
    assert solution.verification.goal_error <= Tolerances().goal
    assert solution.verification.speed_error <= Tolerances().speed
    case = CASES[family][name]
    assert solution.T >= case.minimum * (1.0 - 1e-4)
    assert solution.trajectory is not None
    assert solution.trajectory.t.size > FEW + 1
    if rough.success:
        assert solution.T <= rough.T * (1.0 + 1e-9)


def test_refinement_halves_the_excess_over_the_minimum_time() -> None:
    """The grid is the best of its size; equal intervals would halve the excess, too."""
    case = CASES["vertical"]["vertical rods"]
    rough = planned("vertical", "vertical rods", "inverse", None)
    solution = planned("vertical", "vertical rods", "inverse", "grid")
    excess = [T / case.minimum - 1.0 for T in (rough.T, solution.T)]
    assert excess[1] < 0.5 * excess[0]


def test_intervals_are_short_where_torques_switch() -> None:
    solution = planned("level", "rods, friction", "inverse", "grid", 20)
    case, motion = CASES["level"]["rods, friction"], solution.trajectory
    assert motion is not None
    h = np.diff(motion.t)
    switches = case.structures[0].times[:-1]
    around = np.searchsorted(motion.t, switches) - 1
    rough = planned("level", "rods, friction", "inverse", None, 20).trajectory
    assert rough is not None
    before = np.diff(rough.t)[np.searchsorted(rough.t, switches) - 1]
    # The intervals around the switches were split more often than the average one.
    assert h.size > 20
    assert np.all(h[around] / before < 20 / h.size)


def test_refinement_of_a_hopeless_problem_raises_no_error() -> None:
    """A joint too weak to lift its link within the limits: no exception, no success."""
    case = CASES["swing"]["pendulum, one swing"]
    robot = case.robot()
    narrow = tm.Problem(
        robot,
        case.task.ends[0][:1],
        tm.JointGoal(case.task.ends[1][:1]),
    )
    options = tm.Options(refine="grid", max_iterations=2, starts=1)
    solution = tm.plan(narrow, options)
    assert solution.message
    if solution.success:
        assert solution.verification is not None
        assert solution.verification.ok


def test_plan_stopped_by_its_callback_is_not_refined() -> None:
    options = tm.Options(refine="grid", callback=lambda record: record.iteration == 2)
    solution = tm.plan(CASES["level"]["rods"].problem(), options)
    assert solution.status is tm.Status.INTERRUPTED
    assert len(solution.history) == 3


# -- splitting of intervals ------------------------------------------------------------


def system_of(family: str, name: str) -> ProblemFunctions:
    return ProblemFunctions.of(CASES[family][name].problem())


@pytest.mark.parametrize("kind", [InverseTranscription, CollocationTranscription])
def test_splitting_intervals_does_not_change_the_motion(
    kind: type[InverseTranscription] | type[CollocationTranscription],
    rng: np.random.Generator,
) -> None:
    """The next solve begins with the solution of the last one."""
    system = system_of("vertical", "vertical rods")
    shares = interval_shares("uniform", FEW)
    transcription = kind(system, shares, 1.3)
    path = rng.normal(size=(FEW + 1, 2))
    path[0] = system.problem.q_start
    s = np.linspace(0.0, 1.3, FEW + 1)
    z = transcription.start(
        lambda t: np.stack([np.interp(t, s, x) for x in path.T], axis=1),
        1.3,
        np.array([1.3]),
    )
    split = np.arange(FEW) % 3 == 0
    finer, start = split_intervals(transcription, z, split)
    before, after = transcription.trajectory(z), finer.trajectory(start)
    assert after.t.size == before.t.size + int(split.sum())
    times = np.linspace(0.0, before.duration, 57)
    if kind is CollocationTranscription:
        times = before.t  # between nodes, the torques determine the motion
    np.testing.assert_allclose(after(times).q, before(times).q, atol=1e-10)
    np.testing.assert_allclose(after(times).v, before(times).v, atol=1e-10)
