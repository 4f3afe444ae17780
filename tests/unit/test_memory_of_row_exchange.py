"""Row exchange between nodes takes little memory, for any number of collision pairs."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.transcription.blocks import SampledRows
from tominpmp.transcription.bspline import InverseTranscription
from tominpmp.transcription.exchange import (
    MOST_NUMBERS,
    MOST_SAMPLES,
    Inspection,
    _samples,
    between_samples,
    exchanged,
    most_instants,
)
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram
from tominpmp.verification import polynomials as pieces
from tominpmp.verification.polynomials import Pieces

MEGABYTE = 1e6


def crowded(count: int) -> tm.Problem:
    """A UR5 among moving balls, which are all about equally near."""
    arm = tm.load_robot("ur5", limits="urdf")
    angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    balls = [
        tm.Sphere(
            f"ball{k}",
            radius=0.05,
            position=(1.2 * np.cos(angle), 1.2 * np.sin(angle), 0.3),
            motion=tm.ConstantVelocity((0.0, 0.0, 1e-5)),
        )
        for k, angle in enumerate(angles)
    ]
    start = [0.0, -1.2, 1.0, 0.0, 0.5, 0.0]
    goal = tm.JointGoal([2.7, -0.9, 1.2, 0.1, 0.6, 0.1])
    return tm.Problem(arm, start, goal, scene=tm.Scene(balls), margin=0.01)


@pytest.mark.parametrize("duration", [2.0, 2700.0])
def test_row_exchange_takes_less_than_350_megabytes(duration: float) -> None:
    problem = crowded(60)
    system = ProblemFunctions.of(problem)
    assert system.clearance is not None and system.clearance.count > 400
    shares = interval_shares("cosine", 40)
    spline = InverseTranscription(system, shares, duration)
    ends = np.stack([problem.q_start, problem.goal.q])

    def position(times: np.ndarray) -> np.ndarray:
        share = np.clip(times / duration, 0.0, 1.0)[:, None]
        return ends[0] + share**2 * (3.0 - 2.0 * share) * (ends[1] - ends[0])

    start = spline.start(position, duration, np.array([duration]))
    program = NonlinearProgram.of(spline).at(start)
    tracemalloc.start()
    try:
        exchanged(program, start, 1e-3)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 350 * MEGABYTE


def test_tables_of_samples_have_a_bounded_number_of_entries() -> None:
    for pairs in (1, 100, 500, 2000, 10_000):
        most = most_instants(pairs)
        assert 1 <= most <= MOST_SAMPLES
        assert most * pairs <= MOST_NUMBERS
        assert _samples(np.full(40, 1e5), most).size <= most + 4 * 40
    # Ordinary motions among ordinary obstacles are sampled every 2 ms.
    assert most_instants(300) * 2e-3 > 20.0


def test_only_the_worst_instants_are_refined(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = crowded(60)
    system = ProblemFunctions.of(problem)
    monkeypatch.setattr("tominpmp.transcription.exchange.MOST_NUMBERS", 300_000)
    monkeypatch.setattr(
        "tominpmp.transcription.exchange.between_samples",
        lambda m, *_: np.arange(len(m)),
    )
    program = InverseTranscription(system, interval_shares("cosine", 40), 10.0)
    T = np.array([10.0])
    start = program.start(lambda t: np.tile(problem.q_start, (t.size, 1)), 10.0, T)
    spline = program.motion(start)
    assert system.clearance is not None
    looked: list[int] = []

    excess = Inspection.excess

    def counted(self: Inspection, at: Instants, *rest: Any) -> np.ndarray:
        looked.append(at.size)
        return excess(self, at, *rest)

    monkeypatch.setattr(Inspection, "excess", counted)
    rows = SampledRows(program, system.clearance, Instants.of_pairs(()))
    Inspection(rows, spline).worst_instants()
    most = most_instants(system.clearance.count)
    assert len(looked) > 1 and max(looked[1:]) <= most


def test_dips_between_samples_match_their_definition() -> None:
    rng = np.random.default_rng(3)
    missing = rng.normal(size=(200, 7))
    edge = np.zeros((1, 7))
    for tolerance, close in ((0.0, 0.3), (0.5, 1.0), (2.5, np.inf)):
        # Beyond the slack, values are bounds: the rise from there may be a whole step.
        least = np.where(missing > -close, missing, -3.0 * close)
        change = np.abs(np.diff(least, axis=0))
        change = np.maximum(np.vstack([edge, change]), np.vstack([change, edge]))
        dips = (missing + 0.5 * change > tolerance) & (missing > -close)
        expected = np.flatnonzero(np.any(dips, axis=1))
        assert np.array_equal(between_samples(missing, tolerance, close), expected)


def test_curves_are_evaluated_in_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    curve = Pieces.of(
        lambda t: np.stack([np.sin(t), t**2, np.cos(3.0 * t)], axis=1),
        np.linspace(0.0, 2.0, 9),
    )
    times = np.random.default_rng(0).uniform(0.0, 2.0, 1000)
    whole = curve(times)
    monkeypatch.setattr(pieces, "CHUNK", 7)
    assert np.array_equal(curve(times), whole)
    many = np.linspace(0.0, 2.0, 200_000)
    monkeypatch.undo()
    tracemalloc.start()
    try:
        curve(many)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 3 * many.size * 3 * 8
