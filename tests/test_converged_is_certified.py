"""What planning calls a locally time-optimal motion, its certificate accepts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tominpmp as tm
from tests.schedules import carried_out
from tominpmp.certificate.dwells import no_certificate
from tominpmp.dynamics import RobotDynamics
from tominpmp.planner import optimality
from tominpmp.planner.automatic_options import resolve_options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.optimality import certified
from tominpmp.planner.plan_state import PlanState
from tominpmp.solvers import exchange
from tominpmp.solvers.loop import solve
from tominpmp.solvers.objective import MinimumTime
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.stopping import Stop
from tominpmp.transcription.layout import Layout
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

START, END = (0.5, 1.7, -1.7), (0.9, -1.2, -0.9)
OPTIONS = tm.Options(intervals=40, control="constant", refine=None, starts=1)


@pytest.fixture(scope="module")
def around():
    """A motion of the paper's arm past a ball, as near as it may."""
    robot = tm.load_robot("planar3r")
    scene = tm.Scene([tm.Sphere("O", radius=0.8, position=(3.2, 3.2, 0))])
    problem = tm.Problem(robot, START, tm.JointGoal(END), scene=scene)
    return tm.plan(problem, OPTIONS, effort="quick")


@pytest.fixture(scope="module")
def free():
    robot = tm.load_robot("planar3r")
    return tm.plan(tm.Problem(robot, START, tm.JointGoal(END)), OPTIONS)


def slower(solution, factor=1.05):
    """The motion of a solution, slowed down, as an attempt that says it converged."""
    motion, inverse = solution.trajectory, RobotDynamics(solution.problem.robot).inverse
    v, a = motion.v / factor, motion.a / factor**2
    u = inverse(motion.q, v, np.vstack([a, a[-1:]]))
    motion = replace(motion, t=factor * motion.t, v=v, a=a, u=u)
    return Candidate(
        "slow",
        tm.Status.CONVERGED,
        True,
        motion,
        motion,
        {},
        tm.verify(solution.problem, motion),
    )


def after_certificate(solution, attempt, **changes):
    """A plan whose last stage has examined an attempt."""
    options = replace(resolve_options(solution.problem, OPTIONS), **changes)
    state = PlanState(solution.problem, options)
    state.candidates.append(attempt)
    with state.deadline.in_force():
        carried_out(state, certified(state))
    return state


def judged(solution, attempt, **changes):
    """What the last stage makes of an attempt."""
    return after_certificate(solution, attempt, **changes).candidates[1:]


@pytest.mark.parametrize("name", ["free", "around"])
def test_a_motion_that_is_none_is_improved_until_it_is_one(name, request):
    solution = request.getfixturevalue(name)
    attempt = slower(solution)
    assert not tm.certify(solution.problem, attempt.trajectory).ok
    state = after_certificate(solution, attempt)
    (found,) = state.candidates[1:]
    assert found.status is tm.Status.CONVERGED
    assert found.verification.ok
    assert found.duration < 1.01 * solution.T
    certificate = tm.certify(
        solution.problem, found.trajectory, verification=found.verification
    )
    assert certificate.ok, certificate.message
    assert state.history  # iterations are accounted for


def test_what_promises_half_of_what_it_may_is_gone_on_with(free, monkeypatch):
    """A motion that is 0.7 % too slow is certified, and made faster all the same."""
    attempt = slower(free, 1.007)
    [found] = judged(free, attempt)
    assert found.status is tm.Status.CONVERGED
    assert found.duration < attempt.duration / 1.005
    monkeypatch.setattr(optimality, "WORTH_A_TRY", 1.0)
    [left] = judged(free, attempt)
    assert left.status is tm.Status.CONVERGED
    assert left.duration == attempt.duration


def test_where_nothing_can_be_gained_it_says_so(free, monkeypatch):
    """A promise that no iteration keeps is not called an optimum."""
    monkeypatch.setattr(optimality, "ROUNDS", 0)
    (found,) = judged(free, slower(free))
    assert found.status is tm.Status.STALLED
    assert "Small changes promise" in found.remark


@pytest.mark.parametrize(
    ("cause", "status"),
    [
        (Stop(requested=False), tm.Status.TIME_LIMIT),
        (RuntimeError("no solution"), tm.Status.STALLED),
    ],
)
def test_a_test_that_is_cut_short_proves_nothing(free, monkeypatch, cause, status):
    """The callback ends iterations a little before the deadline does."""

    def run(settling, attempt):
        raise cause

    monkeypatch.setattr(optimality.CertifiedDescent, "run", run)
    (found,) = judged(free, slower(free))
    assert found.status is status


def test_motions_of_segments_are_put_to_the_test_too(free):
    """One that is slowed down is improved, or said to leave something."""
    segments = [
        tm.Segment(tm.JointGoal([0.7, 0.3, -1.2])),
        tm.Segment(tm.JointGoal(END)),
    ]
    problem = tm.Problem(free.problem.robot, START, segments=segments)
    solution = tm.plan(problem, OPTIONS)
    motion = solution.trajectory
    slow = replace(
        motion,
        t=1.05 * motion.t,
        v=motion.v / 1.05,
        a=motion.a / 1.05**2,
        segment_ends=1.05 * motion.segment_ends,
    ).with_torques(motion.inverse_dynamics, motion.segment_dynamics)
    verification = tm.verify(problem, slow)
    assert verification.ok
    attempt = replace(
        slower(free),
        trajectory=slow,
        initial=slow,
        verification=verification,
        layout=Layout.of_motion(slow, segments),
    )
    assert not tm.certify(problem, slow).ok
    (found,) = judged(solution, attempt)
    accepted = tm.certify(problem, found.trajectory, verification=found.verification)
    assert (found.status is tm.Status.CONVERGED) == accepted.ok
    assert accepted.ok or "Small changes promise" in found.remark
    assert found.duration < 1.01 * solution.T


def test_an_iteration_limit_is_no_convergence(free):
    solution = tm.plan(free.problem, replace(OPTIONS, max_iterations=2))
    converged = solution.status is tm.Status.CONVERGED
    assert not converged or solution.certificate.ok, solution.certificate.message
    assert converged or not solution.success or "promise" in solution.message


def test_the_message_of_a_plan_says_how_much_is_promised(monkeypatch, free):
    monkeypatch.setattr(optimality, "tolerance_of", lambda options: 1e-12)
    monkeypatch.setattr(optimality, "ROUNDS", 0)
    solution = tm.plan(free.problem, OPTIONS)
    assert solution.success
    assert solution.status is tm.Status.STALLED
    assert "Small changes promise" in solution.message


def test_thorough_asks_for_a_tenth():
    thorough = replace(OPTIONS, effort="thorough")
    assert optimality.tolerance_of(thorough) == 0.1 * optimality.tolerance_of(OPTIONS)


@pytest.mark.parametrize("method", ["collocation", "adjoint", "penalty"])
def test_other_methods_are_judged_too(free, method):
    options = tm.Options(method=method, intervals=24, starts=1)
    solution = tm.plan(free.problem, options)
    converged = solution.status is tm.Status.CONVERGED
    assert solution.success
    assert not converged or solution.certificate.ok, solution.certificate.message


@pytest.mark.parametrize("seed", [2, 5])
def test_random_clutter(seed):
    """Boxes around a UR5: success is not refuted."""
    rng = np.random.default_rng(seed)
    robot = tm.load_robot("ur5", limits="urdf")
    ends = ((-1.2, -1.1, 1.2, -1.0, -1.5, 0.0), (1.0, -1.3, 1.4, -1.2, -1.5, 0.6))
    boxes = []
    while len(boxes) < 5:
        angle, away = rng.uniform(-1.0, 1.0), rng.uniform(0.35, 0.8)
        place = (away * np.cos(angle), away * np.sin(angle), rng.uniform(0.0, 0.7))
        box = tm.Box(
            f"box{len(boxes)}", size=tuple(rng.uniform(0.1, 0.3, 3)), position=place
        )
        try:
            tm.Problem(robot, ends[0], tm.JointGoal(ends[1]), tm.Scene([*boxes, box]))
        except tm.ProblemError:
            continue
        boxes.append(box)
    problem = tm.Problem(robot, ends[0], tm.JointGoal(ends[1]), tm.Scene(boxes))
    solution = tm.plan(problem)
    assert solution.success
    if solution.status is tm.Status.CONVERGED:
        assert solution.certificate.ok, solution.certificate.message
    else:
        assert "Small changes promise" in solution.message


def test_rounds_that_run_out_are_no_convergence(around, monkeypatch):
    """They were: the motion had settled on rows that were not all that it needed."""
    monkeypatch.setattr(exchange, "EXTENSIONS", 1)
    options = resolve_options(around.problem, OPTIONS)
    of, z = Layout.of_motion(around.trajectory).represented(
        ProblemFunctions.of(around.problem), around.trajectory
    )
    looks = exchange.RowExchange(revise=lambda program, z: (program, z))
    result = solve(
        NonlinearProgram.of(of).at(z),
        MinimumTime.of(options, 1e-4),
        z,
        *trust_regions(options),
        exchange=looks,
    )
    assert result.status is tm.Status.ITERATION_LIMIT


def test_a_grid_that_is_the_limit_is_named(free):
    """Of few intervals, which may not be split: so the message says."""
    solution = tm.plan(free.problem, replace(OPTIONS, intervals=12))
    assert solution.success
    assert solution.status is not tm.Status.CONVERGED
    assert "on a grid finer than its 12 intervals" in solution.message


def test_dwells_among_moving_obstacles_are_not_called_optimal():
    """They have no certificate, so that no motion with them is called optimal."""
    moves = tm.ConstantVelocity((0.1, 0.0, 0.0))
    gate = tm.Sphere("gate", radius=0.1, position=(0.0, 5.0, 0.0), motion=moves)
    there, back = tm.JointGoal((0.6, 1.6, -1.6)), tm.JointGoal(START)
    segments = [tm.Segment(there, dwell=0.1), tm.Segment(back)]
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, START, segments=segments, scene=tm.Scene([gate]))
    found = tm.plan(problem, OPTIONS, intervals=20)
    assert found.success, found.message
    assert found.status is tm.Status.STALLED
    assert f"{no_certificate(problem).capitalize()}." in found.message
    with pytest.raises(tm.ProblemError, match="dwells among moving obstacles"):
        _ = found.certificate
