"""Grid refinement: by default, T is close to that of the continuous-time problem."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from stacked_rows import stacked

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tominpmp.dynamics import RobotDynamics
from tominpmp.planner import candidate, descent
from tominpmp.planner.finer_grid import _round_ends, intervals_to_halve
from tominpmp.solvers.iterate import Iterate
from tominpmp.solvers.loop import Loop
from tominpmp.solvers.objective import MinimumTime
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.adjoint import AdjointTranscription
from tominpmp.transcription.exchange import times_of_rows, with_rows_at
from tominpmp.transcription.grid import (
    delayed_shares,
    interval_shares,
    segmented_shares,
)
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.layout import HALVED_SHARE, Layout, split_intervals
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

START, GOAL = (0.5, 1.7, -1.7), (0.5, 1.0, 1.0)
# T on a grid four times finer may be smaller by this share.
CONTINUUM = 5e-3
MODES = {
    "auto": {},
    "constant": {"control": "constant"},
    "linear": {"control": "linear"},
    "spline": {"control": "spline"},
}
LIMITED = tm.MotionLimits(acceleration=15.0, jerk=500.0)
RATED = tm.MotionLimits(effort_rate=2000.0)


def planar(**more):
    return tm.Problem(tm.load_robot("planar3r"), START, tm.JointGoal(GOAL), **more)


@cache
def planned(mode: str, limits: tm.MotionLimits | None, refine: str | None):
    return tm.plan(planar(motion_limits=limits), refine=refine, **MODES[mode])


CASES = [
    ("auto", None),
    ("constant", None),
    ("linear", None),
    ("spline", None),
    ("auto", LIMITED),
    ("auto", RATED),
]


@pytest.mark.parametrize(("mode", "limits"), CASES)
def test_grid_four_times_finer_gains_little_time(mode, limits):
    solution = planned(mode, limits, "auto")
    assert solution.success
    N = 4 * solution.options.intervals
    problem = planar(motion_limits=limits)
    finer = tm.plan(problem, start=solution, intervals=N, refine=None, **MODES[mode])
    assert finer.success
    assert solution.T <= finer.T * (1.0 + CONTINUUM)


@pytest.mark.parametrize(("mode", "limits"), CASES)
def test_refined_motion_is_never_slower_than_on_the_first_grid(mode, limits):
    search, solution = planned(mode, limits, None), planned(mode, limits, "auto")
    assert solution.T <= search.T
    assert solution.verification.ok
    assert search.trajectory.t.size == search.options.intervals + 1
    if solution.T < search.T:
        assert solution.trajectory.t.size > search.trajectory.t.size


LAYOUTS = {
    "constant": (2, interval_shares("cosine", 12), [1.3], ()),
    "constant, two lengths": (2, delayed_shares(9, 0.3), [1.1, 1.4], ()),
    "linear": (3, interval_shares("cosine", 12), [1.3], ()),
    "smooth": (5, interval_shares("cosine", 12), [1.3], ()),
    "states": (0, interval_shares("cosine", 12), [1.3], ()),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_representing_and_splitting_an_iterate_keeps_its_motion(name, rng):
    degree, shares, eta, ends = LAYOUTS[name]
    problem = planar(v_start=(0.1, -0.2, 0.3))
    system = ProblemFunctions.of(problem)
    of = Layout(degree, shares, np.array(eta), ends).transcription(system)
    z = np.append(rng.normal(size=of.size - len(eta)), eta)
    if degree == 0:
        way = np.subtract(GOAL, START)
        z = of.start(lambda t: START + t[:, None] * way, 1.0, np.array(eta))
    split_keeps_motion(of, z, system)


def test_representing_and_splitting_segments_keeps_their_motion(rng):
    middle = tm.Segment(tm.JointGoal((0.5, 1.2, 0.0)), stop=False)
    last = tm.Segment(tm.JointGoal(GOAL))
    problem = tm.Problem(tm.load_robot("planar3r"), START, segments=[middle, last])
    system = ProblemFunctions.of(problem)
    counts, durations = np.full(2, 9), np.array([0.7, 0.6])
    for degree in (2, 3, 5):
        shares = segmented_shares("cosine", counts, durations, degree > 2)
        layout = Layout(degree, shares, np.array([1.2, 1.5]), (9, 18))
        of = layout.transcription(system)
        z = np.append(rng.normal(size=of.size - 2), layout.eta)
        finer = split_keeps_motion(of, z, system)
        first = finer.trajectory(split_intervals(of, z, every_third(of))[1])
        assert finer.segment_ends == (12, 24)
        np.testing.assert_allclose(
            first.segment_ends, of.trajectory(z).segment_ends, rtol=1e-12
        )


def every_third(of):
    return np.arange(of.intervals) % 3 == 1


def split_keeps_motion(of, z, system):
    """Represent an iterate again and split its intervals, which keeps its motion."""
    motion = of.trajectory(z)
    program, start = Layout.of(of, z).represented(system, motion)
    again = program.transcription
    np.testing.assert_allclose(start, z, atol=1e-9)
    finer, split = split_intervals(again, start, every_third(of))
    assert finer.intervals == of.intervals + every_third(of).sum()
    assert finer.shares.shape[1] == of.shares.shape[1]
    times = np.linspace(0.0, motion.duration * (1 - 1e-12), 301)
    fine = finer.trajectory(split)
    assert fine.duration == pytest.approx(motion.duration, rel=1e-12)
    atol = 1e-9
    np.testing.assert_allclose(fine(times).q, motion(times).q, atol=atol)
    np.testing.assert_allclose(fine(times).v, motion(times).v, atol=10 * atol)
    return finer


def test_intervals_at_the_speed_limit_are_not_halved():
    rail = make_arm(slide(1.0), effort=10.0, velocity=0.5)
    problem = tm.Problem(rail, [0.0], tm.JointGoal([1.0]))
    solution = tm.plan(problem, refine=None)
    system = ProblemFunctions.of(problem)
    layout = Layout.of_motion(solution.trajectory)
    program, z = layout.represented(system, solution.trajectory)
    of = program.transcription
    split, speed = intervals_to_halve(of, z), solution.trajectory.v[:, 0]
    rides = (speed[1:] > 0.4999) & (speed[:-1] > 0.4999)
    assert rides.any()
    assert not split[rides].any()


def test_refined_knots_stay_on_the_control_period():
    solution = tm.plan(planar(), control_period=0.01)
    ticks = solution.trajectory.t / 0.01
    assert solution.success
    np.testing.assert_allclose(ticks, np.rint(ticks), atol=1e-9)
    assert solution.T <= planned("auto", None, "auto").T + 0.02


def test_refined_motion_of_segments_is_faster():
    middle = tm.Segment(tm.JointGoal((0.5, 1.2, 0.0)), stop=False)
    last = tm.Segment(tm.JointGoal(GOAL))
    problem = tm.Problem(tm.load_robot("planar3r"), START, segments=[middle, last])
    search, solution = tm.plan(problem, refine=None), tm.plan(problem)
    assert solution.success
    assert solution.T < search.T
    assert len(solution.segments) == 2


WAYS = {"passed": ((0.9, 0.6, -0.4), False), "stopped at": ((0.9, 1.2, -0.4), True)}


@pytest.mark.parametrize("name", WAYS)
def test_grid_four_times_finer_gains_little_time_with_segments(name):
    way, stop = WAYS[name]
    ways = [tm.Segment(tm.JointGoal(way), stop=stop), tm.Segment(tm.JointGoal(GOAL))]
    problem = tm.Problem(tm.load_robot("planar3r"), START, segments=ways)
    solution = tm.plan(problem)
    finer = tm.plan(problem, start=solution, intervals=4 * solution.options.intervals)
    assert solution.success
    assert solution.T <= finer.T * (1.0 + CONTINUUM)


def test_intervals_with_unused_torque_are_halved():
    solution = planned("constant", None, None)
    motion, problem = solution.trajectory, solution.problem
    system = ProblemFunctions.of(problem)
    program, z = Layout.of_motion(motion).represented(system, motion)
    of = program.transcription
    split, h = intervals_to_halve(of, z), np.diff(motion.t)
    # Torques at the ends of the intervals, by the dynamics of the robot alone.
    ends = (slice(0, -1), slice(1, None))
    limit = problem.robot.limits.effort_upper
    first, last = (
        RobotDynamics(problem.robot).inverse(motion.q[k], motion.v[k], motion.a) / limit
        for k in ends
    )
    at_limit = np.maximum(np.abs(first), np.abs(last)) > 0.98
    lost = h * np.max(np.where(at_limit, 0.5 * np.abs(last - first), 0.0), axis=1)
    assert lost[split].sum() >= HALVED_SHARE * lost.sum()
    # If a torque jumps around an interval, the loss is of second order in its length.
    mean = 0.5 * (first + last)
    around = np.vstack([mean[:1], mean, mean[-1:]])
    jump = 0.5 * np.max(np.abs(around[2:] - around[:-2]), axis=1)
    lost = np.maximum(lost, h**2 / h.sum() * jump)
    assert lost[split].min() >= lost[~split].max()


class OneRow:
    """A program of one row, which a slower motion satisfies or not."""

    def __init__(self, curable: bool) -> None:
        one = np.ones(1)
        part = "clearance", -np.inf * one, 0.0 * one, [0]
        self.rows = stacked([part])
        self.curable = curable
        self.cost = np.ones(1)

    def stretch(self, z, factor):
        return z * factor

    def slower(self, z, factor, values):
        z = self.stretch(z, factor)
        return z, self.evaluate(z)

    def evaluate(self, z):
        return np.array([1e-4 - (z[0] - 1.0 if self.curable else 0.0)])


def status_of_round(program, **values):
    """The status of a round with a least gain of 0.003 s, after one iteration."""
    first = Iterate.of(program, np.ones(1), 1.0)
    loop = Loop(program, MinimumTime.of(tm.Options()), first)
    values = dict.fromkeys(IterationRecord.__dataclass_fields__, 0) | values
    loop.history = [IterationRecord(**values)]
    return _round_ends(3e-3)(loop)


def test_refinement_round_ends_at_once_without_predicted_gain():
    values = {"predicted": 1e-3, "violation": 1e-4}
    assert status_of_round(OneRow(False), **values) is Status.CONVERGED
    assert status_of_round(OneRow(True), predicted=1e-2, violation=0.0) is None


def test_restoration_by_slowing_down_needs_few_evaluations():
    """Regression: the restoration took eight evaluations, each of all distances."""
    program, z = OneRow(True), np.ones(1)
    iterate = Iterate.of(program, z, 1.0)
    evaluations = []
    evaluate = program.evaluate
    program.evaluate = lambda z: evaluations.append(z) or evaluate(z)
    slower = MinimumTime.of(tm.Options()).slowed(program, iterate)
    assert slower.violation <= 1e-6
    assert 1.0 < slower.duration <= 1.0 + 1.05e-4
    assert len(evaluations) <= 3


# -- active rows of distances ----------------------------------------------------------


def test_finer_grid_keeps_the_active_rows_of_distances():
    """Without these rows, the motion passed through obstacles between the nodes, and
    found the rows anew.
    """
    box = tm.Box("box", size=(0.3, 0.3, 1.0), position=(-2.0, -2.0, 0.0))
    problem = planar(scene=tm.Scene([box]))
    motion = tm.plan(problem, control="constant", refine=None, starts=1).trajectory
    system = ProblemFunctions.of(problem)
    plain, z = Layout.of_motion(motion).represented(system, motion)
    of = plain.transcription
    (index,) = (k for k, b in enumerate(plain.blocks) if b.name == "clearance")
    between = Instants(np.array([3, 20]), np.array([0.3, 0.85]))
    block = plain.blocks[index]
    blocks = list(plain.blocks)
    blocks[index] = replace(block, fixed=block.fixed.joined(between))
    times = times_of_rows(replace(plain, blocks=tuple(blocks)), z)
    required = between.times(of.motion(z).h)
    assert np.all(np.isin(np.round(required, 12), np.round(times["clearance"], 12)))

    split = np.zeros(of.intervals, dtype=bool)
    split[[3, 19, 20]] = True
    finer, there = split_intervals(of, z, split)
    regular = NonlinearProgram.of(finer).at(there)
    found = with_rows_at(regular, there, times)
    count = found.blocks[index].fixed.size - regular.blocks[index].fixed.size
    assert count == between.size  # the instants of the grid have rows already
    own = found.blocks[index].fixed.times(finer.motion(there).h)
    for time in required:
        assert np.min(np.abs(own - time)) < 1e-9
    assert with_rows_at(found, there, times).rows.size == found.rows.size


# -- transcriptions and replays --------------------------------------------------------


def test_transcription_without_refinement_is_planned(monkeypatch):
    def own_program(system, options, guess):
        shares = interval_shares("uniform", options.intervals)
        of = AdjointTranscription(system, shares, guess.duration, substeps=4)
        z = of.pack(np.zeros((options.intervals, system.n)), np.array([guess.duration]))
        return NonlinearProgram.of(of).at(z), z

    monkeypatch.setattr(descent, "first_program", own_program)
    solution = tm.plan(planar(), method="collocation", intervals=20)
    assert solution.success, solution.message
    assert solution.trajectory.t.size == 21


def test_descent_is_replayed_once_for_all_its_grids(monkeypatch):
    usual, replays = candidate.verify, []

    def counted(problem, trajectory, *arguments, **named):
        replays.append(trajectory.t.size - 1)
        return usual(problem, trajectory, *arguments, **named)

    monkeypatch.setattr(candidate, "verify", counted)
    solution = tm.plan(planar(), control="linear", starts=1, effort="quick")
    finest = solution.trajectory.t.size - 1
    assert finest > solution.options.intervals
    assert replays == [finest]
