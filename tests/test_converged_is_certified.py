"""Motions with the status CONVERGED are certified as locally time-optimal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tominpmp as tm
from tests.schedules import carried_out
from tominpmp.certificate import minimum_principle
from tominpmp.certificate.dwells import no_certificate
from tominpmp.dynamics import RobotDynamics
from tominpmp.planner import optimality
from tominpmp.planner.automatic_options import resolve_options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.optimality import certified
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.planning import _finish
from tominpmp.solvers import exchange
from tominpmp.solvers.loop import solve
from tominpmp.solvers.objective import MinimumTime
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.stopping import Stop
from tominpmp.transcription.layout import Layout
from tominpmp.transcription.problem_functions import ProblemFunctions

START, END = (0.5, 1.7, -1.7), (0.9, -1.2, -0.9)
OPTIONS = tm.Options(intervals=40, control="constant", refine=None, starts=1)


@pytest.fixture(scope="module")
def around():
    """A motion of the paper's arm close past a ball."""
    robot = tm.load_robot("planar3r")
    scene = tm.Scene([tm.Sphere("O", radius=0.8, position=(3.2, 3.2, 0))])
    problem = tm.Problem(robot, START, tm.JointGoal(END), scene=scene)
    return tm.plan(problem, OPTIONS, effort="quick")


@pytest.fixture(scope="module")
def free():
    robot = tm.load_robot("planar3r")
    return tm.plan(tm.Problem(robot, START, tm.JointGoal(END)), OPTIONS)


def slower(solution, factor=1.05):
    """The motion of a solution, slowed down, as a candidate with the status
    CONVERGED.
    """
    motion, inverse = solution.trajectory, RobotDynamics(solution.problem.robot).inverse
    v, a = motion.v / factor, motion.a / factor**2
    u = inverse(motion.q, v, np.vstack([a, a[-1:]]))
    motion = replace(motion, t=factor * motion.t, v=v, a=a, u=u)
    return Candidate(
        tm.Status.CONVERGED,
        True,
        motion,
        motion,
        {},
        tm.verify(solution.problem, motion),
    )


def after_certificate(solution, candidate):
    """The state of a plan whose last stage has examined a candidate."""
    options = resolve_options(solution.problem, OPTIONS)
    state = PlanState(solution.problem, options)
    state.candidates.append(candidate)
    with state.deadline.in_force():
        carried_out(state, certified(state))
    return state


def result_of_last_stage(solution, candidate):
    """The fastest candidate after the last stage."""
    return after_certificate(solution, candidate).incumbent


@pytest.mark.parametrize("name", ["free", "around"])
def test_last_stage_improves_a_motion_until_it_is_certified(name, request):
    solution = request.getfixturevalue(name)
    candidate = slower(solution)
    assert not tm.certify(solution.problem, candidate.trajectory).ok
    state = after_certificate(solution, candidate)
    found = state.incumbent
    assert found.status is tm.Status.CONVERGED
    assert found.verification.ok
    assert found.duration < 1.01 * solution.T
    certificate = tm.certify(
        solution.problem, found.trajectory, verification=found.verification
    )
    assert certificate.ok, certificate.message
    assert state.history  # iterations are accounted for


def test_certified_motion_with_a_considerable_predicted_gain_is_improved(
    free, monkeypatch
):
    """A motion that is 0.7 % too slow is certified, and made faster all the same."""
    candidate = slower(free, 1.007)
    found = result_of_last_stage(free, candidate)
    assert found.status is tm.Status.CONVERGED
    assert found.duration < candidate.duration / 1.005
    monkeypatch.setattr(optimality, "PROMISE", 1.0)
    left = result_of_last_stage(free, candidate)
    assert left.status is tm.Status.CONVERGED
    assert left.duration == candidate.duration


def test_predicted_gain_that_no_round_achieves_ends_as_stalled(free, monkeypatch):
    """A motion with a predicted gain that no iteration achieves is not called an
    optimum.
    """
    monkeypatch.setattr(optimality, "_improved", lambda best, *_: best)
    found = result_of_last_stage(free, slower(free))
    assert found.status is tm.Status.STALLED
    assert "Small changes promise" in found.remark


def test_remark_has_no_infinite_gain_if_the_conditions_cannot_be_evaluated(
    free, monkeypatch
):
    """Regression: "Small changes promise inf % of T", for an arm that moved 1 mrad."""
    monkeypatch.setattr(minimum_principle, "solve_dual_program", lambda *_: None)
    found = result_of_last_stage(free, slower(free))
    assert found.status is tm.Status.STALLED
    assert "inf" not in found.remark
    assert "could not be evaluated" in found.remark


@pytest.mark.parametrize(
    ("cause", "status"),
    [
        (Stop(requested=False), tm.Status.TIME_LIMIT),
        (RuntimeError("no solution"), tm.Status.STALLED),
    ],
)
def test_interrupted_certification_does_not_count_as_converged(
    free, monkeypatch, cause, status
):
    """The callback ends iterations a little before the deadline does."""

    def fails(*_):
        raise cause

    monkeypatch.setattr(optimality, "_examined", fails)
    found = result_of_last_stage(free, slower(free))
    assert found.status is status


def test_certification_that_keeps_only_a_slower_motion_does_not_count_as_converged(
    free, monkeypatch
):
    """Regression: the certificate had failed, and the motion was called optimal."""
    kept = replace(slower(free, 1.1), status=tm.Status.NUMERICAL_FAILURE)
    monkeypatch.setattr(optimality, "_examined", lambda *_: kept)
    found = result_of_last_stage(free, slower(free))
    assert found.status is tm.Status.STALLED


@pytest.mark.parametrize(
    ("factor", "status"), [(1.007, tm.Status.CONVERGED), (1.05, tm.Status.STALLED)]
)
def test_stopped_improvement_leaves_an_accepted_motion_certified(
    free, monkeypatch, factor, status
):
    """Regression: a motion that the certificate had accepted was changed further, for
    0.05 % of T, and the plan ended with the status TIME_LIMIT.
    """

    def stops(self, *_arguments, **_keywords):
        raise Stop(requested=False)

    monkeypatch.setattr(PlanState, "solve", stops)
    state = after_certificate(free, slower(free, factor))
    assert state.incumbent.status is status
    ended = status if status is tm.Status.CONVERGED else tm.Status.TIME_LIMIT
    assert _finish(state, tm.Status.TIME_LIMIT).status is ended


def test_last_stage_examines_motions_of_segments(free):
    """A motion that is slowed down is improved, or its message has the
    predicted gain.
    """
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
    candidate = replace(
        slower(free),
        trajectory=slow,
        initial=slow,
        verification=verification,
        layout=Layout.of_motion(slow, segments),
    )
    assert not tm.certify(problem, slow).ok
    found = result_of_last_stage(solution, candidate)
    accepted = tm.certify(problem, found.trajectory, verification=found.verification)
    assert (found.status is tm.Status.CONVERGED) == accepted.ok
    assert accepted.ok or "Small changes promise" in found.remark
    assert found.duration < 1.01 * solution.T


def test_iteration_limit_is_no_convergence(free):
    solution = tm.plan(free.problem, replace(OPTIONS, max_iterations=2))
    converged = solution.status is tm.Status.CONVERGED
    assert not converged or solution.certificate.ok, solution.certificate.message
    assert converged or not solution.success or "promise" in solution.message


def test_message_of_a_stalled_plan_has_the_predicted_gain(monkeypatch, free):
    monkeypatch.setattr(optimality, "tolerance_of", lambda options: 1e-12)
    monkeypatch.setattr(optimality, "_improved", lambda best, *_: best)
    solution = tm.plan(free.problem, OPTIONS)
    assert solution.success
    assert solution.status is tm.Status.STALLED
    assert "Small changes promise" in solution.message


def test_tolerance_of_thorough_plans_is_a_tenth():
    thorough = replace(OPTIONS, effort="thorough")
    assert optimality.tolerance_of(thorough) == 0.1 * optimality.tolerance_of(OPTIONS)


@pytest.mark.parametrize("method", ["collocation", "adjoint", "penalty"])
def test_other_methods_converge_to_certified_motions(free, method):
    options = tm.Options(method=method, intervals=24, starts=1)
    solution = tm.plan(free.problem, options)
    converged = solution.status is tm.Status.CONVERGED
    assert solution.success
    assert not converged or solution.certificate.ok, solution.certificate.message


@pytest.mark.parametrize("seed", [2, 5])
def test_plans_among_random_boxes_are_certified_or_stalled(seed):
    """Boxes around a UR5: a converged motion is certified."""
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


def test_exhausted_row_exchange_is_no_convergence(around, monkeypatch):
    """Regression: an exhausted row exchange counted as convergence, though the motion
    had settled on an incomplete set of rows.
    """
    monkeypatch.setattr(exchange, "EXTENSIONS", 1)
    options = resolve_options(around.problem, OPTIONS)
    program, z = Layout.of_motion(around.trajectory).represented(
        ProblemFunctions.of(around.problem), around.trajectory
    )
    row_exchange = exchange.RowExchange(revise=lambda program, z: (program, z))
    result = solve(
        program,
        MinimumTime.of(options, 1e-4),
        z,
        *trust_regions(options),
        exchange=row_exchange,
    )
    assert result.status is tm.Status.ITERATION_LIMIT


def test_message_names_a_grid_that_limits_the_motion(free):
    """The grid has few intervals, which may not be split; the message says this."""
    solution = tm.plan(free.problem, replace(OPTIONS, intervals=12))
    assert solution.success
    assert solution.status is not tm.Status.CONVERGED
    assert "on a grid finer than its 12 intervals" in solution.message


def test_dwells_among_moving_obstacles_end_as_stalled():
    """Dwells among moving obstacles have no certificate, so that the status is not
    CONVERGED.
    """
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
