"""Warm starts: a former motion as the initial guess of a plan."""

from __future__ import annotations

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tominpmp.initial_guess.warm_start import warm_start
from tominpmp.kinematics import RobotKinematics
from tominpmp.planner import plan_state, starts, work
from tominpmp.stopping import Stop, check
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

START, END = (0.5, 1.7, -1.7), (0.9, -1.2, -0.9)
# The first grid suffices to see the effect of a warm start.
QUICK = {"effort": "quick", "refine": None}
POST = tm.Scene([tm.Sphere("O", radius=0.8, position=(4, 0, 0))])


@pytest.fixture(scope="module")
def free(planar3r):
    problem = tm.Problem(planar3r, START, tm.JointGoal(END))
    return tm.plan(problem, effort="quick")


@pytest.fixture(scope="module")
def stepped(free):
    """The same motion with constant accelerations on the intervals."""
    return tm.plan(free.problem, tm.Options(control="constant", refine=None))


@pytest.fixture(scope="module")
def around(planar3r):
    """The paper's problem with its obstacle."""
    problem = tm.Problem(planar3r, START, tm.PositionGoal("tip", (4, 1, 0)), scene=POST)
    return tm.plan(problem, tm.Options(starts=1, **QUICK))


def test_warm_start_of_the_same_problem_halves_the_iterations(free):
    # Without refinement, which takes as many iterations as from another guess.
    again = tm.plan(free.problem, start=free, refine=None)
    assert again.success and again.iterations <= free.iterations / 2
    assert again.T <= free.T * (1 + 1e-12)


def test_former_motion_is_represented_within_rounding(stepped):
    system = ProblemFunctions.of(stepped.problem)
    guess = warm_start(system, stepped.trajectory)
    assert guess.bend is None and guess.duration == stepped.T
    # On the grid of the motion, and on a finer grid that splits its intervals.
    for intervals in (stepped.trajectory.t.size - 1, 57):
        transcription, z = guess.iterate(system, intervals, "cosine", 2)
        program = NonlinearProgram.of(transcription).at(z)
        motion = program.trajectory(z)
        assert motion.t.size == intervals + 1
        expected = stepped.trajectory(motion.t)
        np.testing.assert_allclose(motion.q, expected.q, atol=1e-12)
        np.testing.assert_allclose(motion.v, expected.v, atol=1e-9)
        # Between the nodes, torques may exceed their limits by this share.
        assert np.max(program.rows.violation(program.evaluate(z))) <= 2.1e-3


@pytest.mark.parametrize("control", ["linear", "spline"])
def test_former_splines_are_represented_within_rounding(free, control):
    options = tm.Options(control=control, intervals=24, refine=None)
    solution = tm.plan(free.problem, options)
    system = ProblemFunctions.of(free.problem)
    guess = warm_start(system, solution.trajectory)
    degree = 3 if control == "linear" else 5
    transcription, z = guess.iterate(system, 24, "cosine", degree)
    times = np.linspace(0, solution.T, 300)
    expected = solution.trajectory(times).q
    np.testing.assert_allclose(
        transcription.trajectory(z)(times).q, expected, atol=1e-7
    )


def test_bent_guess_meets_the_new_start_and_goal(planar3r, free):
    rng = np.random.default_rng(1)
    v_start = rng.uniform(-0.2, 0.2, 3)
    problem = tm.Problem(
        planar3r,
        np.add(START, rng.uniform(-0.1, 0.1, 3)),
        tm.JointGoal(np.add(END, rng.uniform(-0.1, 0.1, 3))),
        v_start=v_start,
    )
    guess = warm_start(ProblemFunctions.of(problem), free.trajectory)
    T, h = guess.duration, 1e-6
    ends = guess.position(np.array([0.0, h, T - h, T]))
    np.testing.assert_allclose(ends[0], problem.q_start, atol=1e-12)
    np.testing.assert_allclose(ends[3], problem.goal.q, atol=1e-12)
    np.testing.assert_allclose((ends[1] - ends[0]) / h, v_start, atol=1e-3)
    np.testing.assert_allclose((ends[3] - ends[2]) / h, 0, atol=1e-3)


def test_bent_guess_keeps_position_limits(planar3r):
    lower = planar3r.limits.position_lower
    start = np.maximum(START, lower + 0.02)
    first = tm.plan(
        tm.Problem(planar3r, start, tm.JointGoal((lower[0], -1.0, 0.3))), **QUICK
    )
    goal = tm.JointGoal((lower[0] + 0.3, -1.0, 0.3))
    problem = tm.Problem(planar3r, (lower[0], *start[1:]), goal)
    guess = warm_start(ProblemFunctions.of(problem), first.trajectory)
    assert np.all(guess.q >= lower)
    assert tm.plan(problem, start=first, **QUICK).success


def test_warm_start_for_another_goal_needs_fewer_iterations(around):
    goal = tm.PositionGoal("tip", (4, 1.15, 0))
    problem = replace(around.problem, goal=goal)
    cold = tm.plan(problem, tm.Options(starts=1, **QUICK))
    warm = tm.plan(problem, tm.Options(starts=1, **QUICK), start=around)
    assert warm.success and warm.verification.ok
    assert warm.T <= cold.T * 1.002
    assert warm.iterations < cold.iterations


def test_warm_start_avoids_a_changed_obstacle(around):
    """The former motion would collide with the larger obstacle."""
    scene = tm.Scene([tm.Sphere("O", radius=1.0, position=(4, -0.2, 0))])
    problem = replace(around.problem, scene=scene)
    tight = replace(around.problem, scene=scene, margin=0.05)
    for changed in (problem, tight):
        warm = tm.plan(changed, start=around, effort="quick")
        assert warm.success
        assert warm.verification.min_clearance >= changed.margin - 1e-5


def test_replanning_in_motion_follows_the_rest_of_the_optimum(planar3r, free):
    """Bellman: the rest of an optimal motion is the optimal motion for the rest."""
    at = 0.4 * free.T
    state = free.trajectory(at)
    problem = tm.Problem(planar3r, state.q, tm.JointGoal(END), v_start=state.v)
    guess = warm_start(ProblemFunctions.of(problem), free.trajectory)
    assert guess.duration == pytest.approx(free.T - at, abs=1e-9)
    warm = tm.plan(problem, start=free)
    assert warm.success
    assert warm.T <= free.T - at + 1e-6
    assert warm.T >= 0.98 * (free.T - at)


@pytest.mark.parametrize("frame", [False, True])
def test_replanning_shortly_before_the_end_uses_the_rest(planar3r, free, frame):
    """Regression: the guess for the last 2 % of the duration was the whole motion, bent
    by its full length.
    """
    at = 0.98 * free.T
    state, goal = free.trajectory(at), tm.JointGoal(END)
    if frame:
        place = RobotKinematics(planar3r).placement(np.array(END), "tip")
        goal = tm.PositionGoal("tip", place.translation)
    problem = tm.Problem(planar3r, state.q, goal, v_start=state.v)
    guess = warm_start(ProblemFunctions.of(problem), free.trajectory)
    assert guess.duration == pytest.approx(free.T - at, abs=1e-9)
    warm = tm.plan(problem, start=free)
    assert warm.success
    assert warm.T <= (free.T - at) * (1.0 + 1e-4)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.9])
def test_replanning_with_constant_accelerations_uses_the_rest(share):
    """Regression: the rest of the motion had the torques of the whole motion: too many
    rows.
    """
    arm = make_arm(slide(1.0), effort=np.array([1.0]))
    options = tm.Options(control="constant", effort="quick", refine=None)
    problem = tm.Problem(arm, [0.0], tm.JointGoal([1.0]))
    first = tm.plan(problem, options)
    state = first.trajectory(share * first.T)
    rest = replace(problem, q_start=state.q, v_start=state.v)
    again = tm.plan(rest, options, start=first)
    assert again.success, again.message
    assert again.T <= (1.0 - share) * first.T * (1.0 + 1e-4)


@pytest.mark.parametrize("ticks", [1, 2, 5])
def test_replanning_on_a_clock_takes_no_longer_than_the_rest(ur5, ticks):
    """Regression: the rest of a former motion was no candidate, as the time at which it
    begins was rounded. A motion from rest takes four periods or more.
    """
    period, goal = 0.004, tm.JointGoal([0.9, -1.2, 1.3, 0.5, 0.5, 0.0])
    problem = tm.Problem(ur5, [0.0, -1.5, 1.0, 0.0, 0.5, 0.0], goal)
    options = tm.Options(effort="quick", control_period=period)
    former = tm.plan(problem, options)
    state = former.trajectory(former.T - ticks * period)
    rest = replace(problem, q_start=state.q, v_start=state.v)
    again = tm.plan(rest, options, start=former)
    assert again.success and again.verification.ok
    assert again.T == pytest.approx(ticks * period, abs=1e-15)


@pytest.mark.parametrize(
    "changes",
    [
        {"control": "constant"},
        {"control": "linear"},
        {"control": "spline"},
        {"method": "collocation"},
    ],
)
def test_the_rest_of_a_motion_of_any_degree_is_a_candidate(free, changes, monkeypatch):
    options = tm.Options(**changes, **QUICK)
    # Between the rows torques may exceed their limits more than the rest may.
    reserve = tm.MotionLimits(effort_scale=0.99)
    former = tm.plan(replace(free.problem, motion_limits=reserve), options)

    def stopped(*given, **named):
        raise Stop(False)

    monkeypatch.setattr(plan_state, "solve", stopped)
    for share in (1e-3, 0.37, 0.999):
        state = former.trajectory(share * former.T)
        rest = replace(free.problem, q_start=state.q, v_start=state.v)
        again = tm.plan(rest, options, start=former)
        assert again.success, again.message
        assert again.T == pytest.approx((1.0 - share) * former.T, abs=1e-9)
        times = np.linspace(0.0, again.T, 40)
        expected = former.trajectory(share * former.T + times).q
        np.testing.assert_allclose(again.trajectory(times).q, expected, atol=1e-8)


def test_motion_back_to_the_start_is_guessed_from_the_whole_motion(planar3r, free):
    """At the end of a motion nothing of the motion remains, and its goal is another
    one.
    """
    rest = np.full(3, 1e-3)
    for q in (np.array(END), END + rest, free.trajectory(0.99 * free.T).q):
        problem = tm.Problem(planar3r, q, tm.JointGoal(START))
        guess = warm_start(ProblemFunctions.of(problem), free.trajectory)
        assert guess.duration == free.T


@pytest.mark.parametrize("method", ["collocation", "adjoint"])
def test_warm_start_works_with_other_methods(around, method):
    options = tm.Options(method=method, starts=1, **QUICK)
    first = tm.plan(around.problem, options)
    goal = tm.PositionGoal("tip", (4, 1.05, 0))
    problem = replace(around.problem, goal=goal)
    warm = tm.plan(problem, options, start=first)
    assert warm.success
    assert warm.iterations < first.iterations


def test_warm_start_with_wider_limits_is_never_slower(planar3r, free):
    faster = planar3r.with_changes(effort=1.05 * planar3r.limits.effort_upper)
    problem = tm.Problem(faster, START, tm.JointGoal(END))
    warm = tm.plan(problem, tm.Options(intervals=8), start=free)
    assert warm.success and warm.T <= free.T + 1e-9


def test_former_motion_is_returned_if_no_plan_is_faster(planar3r, free):
    """The grid is too coarse for any motion as fast as the former motion."""
    fine = tm.plan(free.problem, tm.Options(intervals=60, **QUICK))
    warm = tm.plan(free.problem, tm.Options(intervals=10, **QUICK), start=fine)
    coarse = tm.plan(free.problem, tm.Options(intervals=10, **QUICK))
    assert coarse.T > fine.T
    assert warm.success and warm.T <= fine.T


@pytest.mark.parametrize("period", [None, 0.004])
def test_the_rest_of_several_segments_is_a_candidate(monkeypatch, period):
    """Speeds rule the motion; its torques follow from the load, which has changed."""
    ur5 = tm.load_robot("ur5")
    q = np.array([0.0, -1.2, 1.2, -1.5, -1.5, 0.0])

    def problem(mass, state):
        load = tm.Payload(frame="tool0", mass=mass)
        end = tm.JointGoal(q + np.array([0.5, 0.3, -0.3, 0.2, 0.4, 0.5]))
        ways = [tm.Segment(end, stop=True, dwell=0.1, payload=load)]
        ways.append(tm.Segment(tm.JointGoal(q)))
        return tm.Problem(ur5, state.q, segments=ways, v_start=state.v)

    options = tm.Options(control_period=period, **QUICK)
    former = tm.plan(problem(1.0, SimpleNamespace(q=q, v=0.0 * q)), options)

    def stopped(*given, **named):
        raise Stop(False)

    monkeypatch.setattr(plan_state, "solve", stopped)
    for passed in (0.0, 0.1, 0.3):
        state = former.trajectory(passed)
        again = tm.plan(problem(0.5, state), options, start=former)
        assert again.success, again.message
        assert again.T == pytest.approx(former.T - passed, abs=1e-9)
        assert np.max(np.abs(again.trajectory.u[0] - state.u)) > 0.1


@pytest.mark.parametrize("requested", [False, True])
def test_former_motion_is_returned_after_a_stop(free, monkeypatch, requested):
    """Regression: with little planning time there was no motion, or a slower one."""

    def stopped(*given, **named):
        raise Stop(requested)

    monkeypatch.setattr(plan_state, "solve", stopped)
    solution = tm.plan(free.problem, start=free)
    assert solution.success and solution.T == free.T
    ended = tm.Status.INTERRUPTED if requested else tm.Status.TIME_LIMIT
    assert solution.status is ended


def test_former_motion_beyond_a_new_limit_is_not_returned(ur5):
    """The replay tolerates its excess of 0.4 %, because of which it is the faster
    motion.
    """
    start, end = [0.0, -1.5, 1.0, 0.0, 0.5, 0.0], [1.2, -1.2, 1.3, 0.5, 0.5, 0.0]
    former, again = (
        tm.Problem(ur5, start, tm.JointGoal(end), motion_limits=limits)
        for limits in (tm.MotionLimits(acceleration=a) for a in (5.0, 4.98))
    )
    warm = tm.plan(again, start=tm.plan(former))
    assert warm.verification.worst["acceleration"].share < 1e-4


def test_too_fast_recording_needs_no_more_iterations_than_a_slow_one(ur5):
    """Regression: from a third of its duration, a descent took three times as many
    iterations.
    """
    limits = tm.MotionLimits(acceleration=15.0)
    ends = (0.0, -1.2, 1.0, -1.0, -1.5, 0.0), (1.4, -0.9, -0.3, 0.4, 0.6, 1.8)
    problem = tm.Problem(ur5, ends[0], tm.JointGoal(ends[1]), motion_limits=limits)
    found = tm.plan(problem, effort="quick")
    t = np.linspace(0.0, found.T, 60)
    q, v, a, u = found.trajectory(t)
    slow, fast = (
        tm.plan(
            problem,
            effort="quick",
            start=tm.Samples(ur5.joint_names, c * t, q, v / c, a / c**2, u * np.nan),
        )
        for c in (3.0, 0.3)
    )
    assert fast.success and fast.T <= 1.001 * found.T
    assert fast.iterations <= slow.iterations + 2


def test_warm_start_leaves_time_for_other_guesses(free, clock):
    def slow(record):
        clock.advance(6.0 * (record.start == 0))

    goal = tm.JointGoal((2.9, 1.2, 0.9))
    problem = tm.Problem(free.problem.robot, START, goal)
    limits = {"effort": "quick", "max_planning_time": 10.0}
    solution = tm.plan(problem, start=free, callback=slow, **limits)
    assert solution.success and solution.status is not tm.Status.TIME_LIMIT


def test_slow_repairs_of_iterates_leave_time_for_the_former_motion(
    free, clock, monkeypatch
):
    """Regression: iterates were repaired first, and the former motion was lost."""

    def slow(*_):
        clock.advance(1000.0)
        check()
        yield

    monkeypatch.setattr(work, "_slower_motions", slow)
    stop = {"callback": lambda _: clock.advance(10.0), "max_planning_time": 10.0}
    again = tm.plan(free.problem, start=free, **stop)
    assert again.success
    assert again.status is tm.Status.TIME_LIMIT
    assert again.T == free.T


def test_no_further_starts_follow_a_motion_near_the_lower_bound():
    ur5, goal = tm.load_robot("ur5"), tm.JointGoal([1.2, -1.2, 1.2, -1.5, -1.4, 0.3])
    box = tm.Box("box", size=(0.1, 0.1, 0.5), position=(0.55, 0.45, 0.15))
    problem = tm.Problem(ur5, [0.0, -1.3, 1.4, -1.6, -1.57, 0.0], goal, [box], 0.01)
    former = tm.plan(problem)
    changed = replace(problem, q_start=problem.q_start + 0.1)
    again = tm.plan(changed, start=former)
    assert again.gap < 0.01
    assert {record.start for record in again.history} == {0}


def test_other_guesses_follow_a_failed_warm_start(planar3r, around, monkeypatch):
    warm_start = starts._warm_start_work

    def fails(*arguments):
        work = warm_start(*arguments)

        def make(*arguments):
            return replace(work.make(*arguments), feasible=False)

        return replace(work, make=make)

    monkeypatch.setattr(starts, "_warm_start_work", fails)
    monkeypatch.setattr(plan_state.PlanState, "recall_former", lambda *_: False)
    problem = tm.Problem(planar3r, START, tm.JointGoal(END))
    again = tm.plan(problem, start=around)
    assert again.success
    assert {record.start for record in again.history} >= {0, 1}


def test_samples_of_a_file_are_a_warm_start(free, tmp_path):
    path = free.export(tmp_path / "motion.npz", dt=0.01, verify=False)
    warm = tm.plan(free.problem, start=tm.load_motion(path))
    assert warm.success
    assert warm.T <= 1.003 * free.T


def test_warm_start_needs_no_torques_of_the_former_motion(planar3r, free):
    """Regression: inverse dynamics of the caller were evaluated, and failed."""

    def failing(*_):
        raise ZeroDivisionError

    former = replace(free.trajectory, inverse_dynamics=failing)
    goal = tm.JointGoal(former.q[-1] + 0.05)
    problem = tm.Problem(planar3r, former.q[0], goal)
    guess = warm_start(ProblemFunctions.of(problem), former)
    np.testing.assert_allclose(guess.q[-1], goal.q, atol=1e-9)


def test_wrong_warm_start_is_rejected(free):
    other = replace(free.trajectory, joint_names=("a", "b", "c"))
    with pytest.raises(tm.ProblemError, match="of a, b, c, expected a motion of joint"):
        tm.plan(free.problem, start=other)
    with pytest.raises(tm.ProblemError, match="start is '"):
        tm.plan(free.problem, start="motion.npz")
    with pytest.raises(tm.ProblemError, match="there is no motion in it"):
        tm.plan(free.problem, start=replace(free, trajectory=None))
    u = free.trajectory.u.copy()
    u[0] = np.nan
    holes = replace(free.trajectory, u=u)
    with pytest.raises(tm.ProblemError, match="not finite numbers"):
        tm.plan(free.problem, start=holes)


def test_former_motion_at_rest_is_a_guess(planar3r):
    """The former motion is at the goal from the beginning, so that the motion there has
    no duration.
    """
    stays = tm.Segment(tm.JointGoal(START), dwell=1.0)
    problem = tm.Problem(planar3r, START, segments=[stays])
    rest = np.zeros((3, 3))
    t, q = np.array([0.0, 0.5, 1.0]), np.tile(START, (3, 1))
    still = tm.Samples(planar3r.joint_names, t, q, rest, rest, rest)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        guess = warm_start(ProblemFunctions.of(problem), still)
    assert guess.durations[0] > 0.0
    np.testing.assert_allclose(guess.q, np.tile(START, (len(guess.t), 1)), atol=1e-12)


def test_warm_start_of_the_adjoint_method_has_no_smoothing(monkeypatch, free):
    """As without a former motion: the total variation is weighed by other methods."""
    seen, own = [], starts.shooting_work

    def watched(system, options, *more):
        seen.append(options.smoothing)
        return own(system, options, *more)

    monkeypatch.setattr(starts, "shooting_work", watched)
    tm.plan(free.problem, start=free, method="adjoint", intervals=20, effort="quick")
    assert seen == [None]
