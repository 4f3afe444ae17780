"""Certificates of motions over micrometres or within microseconds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.kinematics import RobotKinematics
from tominpmp.linear_programs.highs import HighsSolver

START = np.array([0.5, 1.7, -1.7])
WAY = np.array([1.0, -0.6, 0.3])


def goal_at(share: float) -> tm.Problem:
    goal = tm.JointGoal(START + share * WAY)
    return tm.Problem(tm.load_robot("planar3r"), START, goal)


@pytest.mark.parametrize("share", [2e-6, 1e-5])
def test_converged_motion_over_micrometres_is_certified(share: float) -> None:
    solution = tm.plan(goal_at(share), effort="quick")
    assert solution.status is tm.Status.CONVERGED, solution.message
    certificate = solution.certificate
    assert certificate is not None
    assert certificate.ok, certificate.message
    # T grows with the root of the distance where no speed limit is reached.
    assert solution.T / np.sqrt(share) == pytest.approx(0.8, rel=0.5)


def test_slow_motion_over_micrometres_fails() -> None:
    problem = goal_at(2e-6)
    motion = tm.plan(problem, effort="quick").trajectory
    assert motion is not None
    assert motion.inverse_dynamics is not None
    slow = replace(motion, t=1.05 * motion.t, v=motion.v / 1.05)
    slow = slow.with_torques(motion.inverse_dynamics)
    certificate = tm.certify(problem, slow)
    assert not certificate.ok
    assert certificate.stationarity > 0.01


def test_programs_of_small_motions_need_no_simplex_method(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("the interior-point method has failed")

    monkeypatch.setattr(HighsSolver, "solve", refuse)
    panda = tm.load_robot("panda")
    start = np.array([0.3, -0.4, 0.2, -1.5, 0.1, 1.6, 0.4, 0.02])
    way = 1e-4 * np.array([0.6, 0.6, 0.0, -0.4, -0.9, -0.9, 0.8, -0.2])
    goal = tm.JointGoal(start + way)
    solution = tm.plan(tm.Problem(panda, start, goal), max_planning_time=np.inf)
    assert solution.status is tm.Status.CONVERGED, solution.message


KINOVA = np.array([-1.1, 0.92, 0.43, -1.4, 0.62, 1.3])


@pytest.mark.parametrize("direction", [(0.6, 0.0, 0.8), (-0.8, 0.6, 0.0)])
def test_position_a_tenth_of_a_millimetre_away_needs_no_simplex_method(
    direction: tuple[float, ...],
) -> None:
    """Regression: the unit of the duration was that of the control points, so that the
    interior-point method failed: the simplex method took 17 000 pivots and more.
    """
    kinova = tm.load_robot("kinova")
    frame = kinova.frame_names[-1]
    there = RobotKinematics(kinova).placement(KINOVA, frame).translation
    goal = tm.PositionGoal(frame, there + 1e-4 * np.array(direction))
    solution = tm.plan(tm.Problem(kinova, KINOVA, goal), max_planning_time=np.inf)
    assert solution.status is tm.Status.CONVERGED, solution.message
    assert sum(record.pivots for record in solution.history) < 2000


def test_programs_of_a_light_gripper_need_no_simplex_method() -> None:
    """Regression: interior points failed without refinement of the linear systems, and
    in a certificate with it: the simplex method took 24 000 pivots, and 16 s.
    """
    z1 = tm.load_robot("z1")
    start = np.array([-0.17, 0.7, -2.3, -0.56, -0.26, 1.4, -0.4])
    way = 1e-4 * np.array([-0.8, -0.5, 0.6, 0.2, -0.8, -0.1, 0.0])
    frame = z1.frame_names[-1]
    goal = tm.PoseGoal(frame, RobotKinematics(z1).placement(start + way, frame))
    solution = tm.plan(tm.Problem(z1, start, goal), max_planning_time=np.inf)
    assert solution.status is tm.Status.CONVERGED, solution.message
    assert sum(record.pivots for record in solution.history) < 2000


def test_certificate_of_a_light_gripper_moves_by_few_displacements() -> None:
    """Regression: with 100 displacements the certificate's program was not solved."""
    start = np.array([-0.54, 2.35, -1.75, 0.53, 0.6, -0.36, -0.84])
    way = 1e-4 * np.array([0.6, 0.6, 0.9, 0.5, 0.0, 0.6, 1.0])
    problem = tm.Problem(tm.load_robot("z1"), start, tm.JointGoal(start + way))
    solution = tm.plan(problem, effort="quick", max_planning_time=np.inf)
    assert solution.status is tm.Status.CONVERGED, solution.message


def test_small_motion_is_not_compared_with_detours() -> None:
    """Regression: detours of 2 rad, of several seconds, followed a motion of 1 ms."""
    kinova = tm.load_robot("kinova")
    way = 1e-4 * np.array([0.4, -0.9, 0.1, -0.5, 0.8, -0.9])
    problem = tm.Problem(kinova, KINOVA, tm.JointGoal(KINOVA + way))
    solution = tm.plan(problem, max_planning_time=np.inf)
    assert solution.status is tm.Status.CONVERGED, solution.message
    assert max(record.duration for record in solution.history) < 0.1


@pytest.mark.parametrize("method", ["collocation", "adjoint"])
def test_torques_as_unknowns_of_a_small_motion_are_in_shares(method: str) -> None:
    """Regression: in units of the displacement, T was up to 80 % longer."""
    solution = tm.plan(goal_at(1e-4), method=method)
    assert solution.status is tm.Status.CONVERGED, solution.message
    assert len(solution.history) <= 30


def test_small_motion_of_continuous_joints_takes_no_whole_turn() -> None:
    # On a fine grid rounding of positions breaks the limits; a coarse one keeps them.
    kinova = tm.load_robot("kinova")
    start = np.array([0.0, 1.41015237, 1.16580628, 0.0, 1.26179939, 0.0])
    way = 1e-6 * np.array([3.53, -8.78, 1.11, -4.57, 7.59, -8.72])
    goal = tm.JointGoal(start + way)
    solution = tm.plan(tm.Problem(kinova, start, goal), max_planning_time=np.inf)
    assert solution.success, solution.message
    assert solution.T < 6e-4


@pytest.mark.parametrize("way", [2e-6, 2e-5])
def test_converged_motion_within_microseconds_is_certified(way: float) -> None:
    strong = tm.load_robot("planar3r", effort=[1e5, 1e5, 1e5])
    goal = tm.JointGoal(START + way)
    solution = tm.plan(tm.Problem(strong, START, goal), effort="quick")
    assert solution.status is tm.Status.CONVERGED, solution.message
    assert 0.0 < solution.T < 1e-4
    certificate = solution.certificate
    assert certificate is not None
    assert certificate.ok, certificate.message
    assert certificate.stationarity < 0.01


def test_motion_of_zero_duration_is_certified() -> None:
    solution = tm.plan(goal_at(0.0))
    certificate = solution.certificate
    assert certificate is not None
    assert certificate.ok, certificate.message
    assert "no change can shorten" in certificate.message
