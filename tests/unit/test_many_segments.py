"""Motions of many segments: derivatives by their durations, and joined motions."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.problem.sequence import joined
from tominpmp.transcription.bspline import BSplineTranscription
from tominpmp.transcription.curve import SplineMotion
from tominpmp.transcription.problem_functions import ProblemFunctions


@pytest.mark.parametrize("degree", [2, 3, 5])
def test_instant_depends_on_durations_of_near_segments_only(degree: int) -> None:
    """Segments of one interval, as on a clock, next to longer segments."""
    arm = tm.load_robot("planar3r")
    counts = [2, 1, 1, 3, 1, 1, 1, 2, 4]
    goals = [
        tm.Segment(tm.JointGoal([0.6 + 0.1 * k, 1.7, -1.7])) for k in range(len(counts))
    ]
    system = ProblemFunctions.of(tm.Problem(arm, [0.5, 1.7, -1.7], segments=goals))
    shares = np.repeat(np.eye(len(counts)), counts, axis=0)
    shares /= shares.sum(axis=0)
    of = BSplineTranscription(system, shares, degree, tuple(np.cumsum(counts).tolist()))
    rng = np.random.default_rng(0)
    eta = rng.uniform(0.5, 2.0, len(counts))
    z = np.append(rng.normal(size=of.point_unknowns), eta)
    at, step = of.instants(2, "u"), 1e-6

    def values(eta: np.ndarray) -> np.ndarray:
        moved = of.motion(np.append(z[: -eta.size], eta))
        same = SplineMotion(
            motion.points, motion.base, eta, shares, moved.knots, of.near
        )
        return same.values(at, 1)

    motion = of.motion(z)
    near = of.near[motion.knots.first[at.interval]]
    found = motion.by_durations(lambda one: one.values(at, 1), 1, near)
    whole = np.zeros((at.size, arm.n, eta.size))
    np.put_along_axis(whole, near[:, None], found, axis=2)
    for k, change in enumerate(step * np.eye(eta.size)):
        differences = (values(eta + change) - values(eta - change)) / (2.0 * step)
        np.testing.assert_allclose(whole[:, :, k], differences, rtol=1e-5, atol=1e-5)


def test_joined_motions_keep_the_holding_torque_after_their_end() -> None:
    """Regression: the torque was NaN after joined motions of given torques."""
    arm = tm.load_robot("planar3r")
    q = [0.5, 1.7, -1.7], [0.6, 1.6, -1.6], [0.7, 1.5, -1.5]
    alone = [
        tm.plan(tm.Problem(arm, a, tm.JointGoal(b)), method="collocation", intervals=12)
        for a, b in itertools.pairwise(q)
    ]
    motions = [solution.trajectory for solution in alone]
    whole = joined(motions, [0.0, 0.1, 0.0])
    after = motions[-1](motions[-1].duration + 1.0, hold=True).u
    np.testing.assert_allclose(whole(whole.duration + 1.0, hold=True).u, after)


def test_short_segments_on_a_clock_take_little_more_time() -> None:
    """Regression: with a control period of 4 ms a motion of a UR5 took 9.1 % longer.

    The motion of eight segments now takes 2.6 % longer.
    """
    arm, q = tm.load_robot("ur5"), np.array([0.0, -1.2, 1.6, -2.0, -1.57, 0.0])
    x, joint = np.linspace(0.0, 1.0, 9)[:, None], np.arange(6)
    way = 2.0 * x * np.array([0.8, 0.3, -0.4, 0.5, 0.2, 0.3])
    swing = np.array([0.0, 1.0, -1.0, 0.5, 0.3, 1.0])
    way += 0.2 * (np.sin(5.0 * x + joint) - np.sin(joint)) * swing
    segments = [tm.Segment(tm.JointGoal(goal)) for goal in q + way[1:]]
    problem = tm.Problem(arm, q, segments=segments)

    free = tm.plan(problem, max_planning_time=np.inf)
    clocked = tm.plan(problem, control_period=0.004, max_planning_time=np.inf)

    assert clocked.success, clocked.message
    assert clocked.T <= 1.04 * free.T
