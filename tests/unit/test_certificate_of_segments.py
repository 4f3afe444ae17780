"""The certificate of motions of several segments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, rod, slide
from tominpmp.certificate.dwells import without_dwells
from tominpmp.dynamics import RobotDynamics

OPTIONS = {"intervals": 40, "control": "constant"}


def on_rail(*segments, **changes):
    return tm.Problem(
        make_arm(slide(2.0), effort=10.0), [0.0], segments=segments, **changes
    )


def at(x, **changes):
    return tm.Segment(tm.JointGoal([x]), **changes)


PROBLEMS = {
    "passed": on_rail(at(0.3), at(1.0)),
    "dwell": on_rail(at(0.3, dwell=0.2), at(1.0)),
    "there and back": on_rail(at(1.0), at(0.4)),
    "load": on_rail(at(0.5), at(1.5, payload=tm.Payload(3.0, "tip"))),
    "slow": on_rail(at(0.5), at(1.0, constraints=(tm.ToolSpeed("tip", 0.5),))),
}


@pytest.fixture(scope="module")
def solutions():
    return {name: tm.plan(problem, **OPTIONS) for name, problem in PROBLEMS.items()}


@pytest.mark.parametrize("name", PROBLEMS)
def test_converged_motions_of_several_segments_are_certified(solutions, name):
    found = solutions[name].certificate
    assert found.ok, found.message
    assert found.stationarity < 0.01
    dwells = sum(segment.dwell for segment in PROBLEMS[name].segments)
    assert found.t[-1] == pytest.approx(solutions[name].T - dwells, abs=1e-9)


def test_certificate_plot_leaves_out_dwells(solutions):
    """Regression: torques after a dwell were drawn later than switching functions."""
    solution = solutions["dwell"]
    figure = solution.plot_certificate()
    torque = figure.axes[0].lines[0].get_xdata()
    assert torque[-1] == pytest.approx(solution.certificate.t[-1], abs=1e-9)


@pytest.mark.parametrize("name", ["passed", "load"])
def test_motion_with_an_unnecessary_stop_fails(solutions, name):
    problem = PROBLEMS[name]
    stopping = [replace(segment, stop=True) for segment in problem.segments]
    slower = tm.plan(on_rail(*stopping), **OPTIONS)
    assert slower.success and slower.T > 1.1 * solutions[name].T
    found = tm.certify(problem, slower.trajectory)
    assert not found.ok
    assert found.stationarity > 0.02
    assert tm.certify(on_rail(*stopping), slower.trajectory).ok


@pytest.mark.parametrize("name", ["passed", "load"])
def test_torques_of_a_recorded_motion_belong_to_their_segment(solutions, name):
    """Regression: torques of a later segment were sought among the intervals.

    The intervals were those of the whole motion, not of the segment.
    """
    recorded = solutions[name].trajectory.sample(0.002)
    assert recorded.segment_ends is not None
    found = tm.certify(PROBLEMS[name], recorded)
    assert found.stationarity < 0.01
    assert solutions[name].T == pytest.approx(found.t[-1])


def test_active_limits_of_a_segment_are_listed(solutions):
    active = {item.kind for item in solutions["slow"].certificate.active}
    assert "speed of frame tip" in active and "effort" in active


def test_motion_that_picks_up_a_payload_is_certified():
    robot = make_arm(
        rod(1.0, 0.5), rod(1.0, 0.5), effort=(8.0, 4.0), gravity=(0.0, 0.0, 0.0)
    )
    segments = [
        tm.Segment(tm.PositionGoal("tip", (0.6, -0.5, 0.0))),
        tm.Segment(tm.JointGoal([-1.57, 0.0]), payload=tm.Payload(0.5, "tip")),
    ]
    problem = tm.Problem(robot, [-0.4, 0.3], segments=segments)
    solution = tm.plan(problem, intervals=40)
    assert solution.success, solution.message
    found = solution.certificate
    assert found.ok, found.message
    assert np.all(np.isfinite(found.costates))
    path = solution.trajectory
    a = None if path.a is None else path.a / 1.05**2
    ends, t, v = 1.05 * path.segment_ends, 1.05 * path.t, path.v / 1.05
    slower = replace(path, t=t, v=v, a=a, segment_ends=ends)
    again = slower.with_torques(path.inverse_dynamics, path.segment_dynamics)
    assert not tm.certify(problem, again).ok


def test_predicted_gain_respects_speed_limits_between_nodes():
    """The lower bound of the light joint is exact: the predicted T is not below it."""
    robot = make_arm(slide(2.0), slide(1e-3), effort=(10.0, 10.0), velocity=(5.0, 1.0))
    segments = [
        tm.Segment(tm.JointGoal([0.02, 0.3]), stop=True),
        tm.Segment(tm.JointGoal([0.1, 1.3])),
    ]
    problem = tm.Problem(robot, [0.0, 0.0], segments=segments)
    options = tm.Options(control="linear", intervals=20, grid="uniform", refine=None)
    solution = tm.plan(problem, options)
    assert solution.success, solution.message
    found = solution.certificate
    least = tm.lower_bound(problem).T
    assert (1.0 - found.stationarity) * solution.T > 0.999 * least


def test_torques_after_a_long_dwell_are_those_of_the_next_segment():
    """Regression: the torques after the dwell were the holding torques within it.

    The dwell has several intervals.
    """
    problem = on_rail(at(0.1, dwell=0.2), at(0.2))
    t = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    q = np.array([0.0, 0.05, 0.1, 0.1, 0.1, 0.15, 0.2])[:, None]
    v = np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.5, 0.0])[:, None]
    u = np.array([10.0, -10.0, 0.0, 0.0, 8.0, -8.0, -8.0])[:, None]
    names, ends = problem.robot.joint_names, np.array([0.4, 0.6])
    motion = tm.Trajectory(names, t, q, v, u, segment_ends=ends)
    _, moving = without_dwells(problem, motion)
    np.testing.assert_allclose(moving.t, [0.0, 0.1, 0.2, 0.3, 0.4], atol=1e-12)
    assert moving.u[:, 0].tolist() == [10.0, -10.0, 8.0, -8.0, -8.0]


def test_torques_before_a_dwell_at_the_end_are_those_of_the_motion():
    """Regression: the last torques were the holding torques of the dwell."""
    problem = on_rail(at(0.1), at(0.2, dwell=0.2))
    t = np.linspace(0.0, 0.4, 5)
    q = np.array([0.0, 0.1, 0.2, 0.2, 0.2])[:, None]
    v = np.array([0.0, 1.0, 0.0, 0.0, 0.0])[:, None]
    names, ends = problem.robot.joint_names, np.array([0.1, 0.4])
    dynamics = RobotDynamics(problem.robot).inverse
    motion = tm.Trajectory(names, t, q, v, 0.0 * q, segment_ends=ends)
    motion = motion.with_torques(dynamics, (dynamics, dynamics))
    _, moving = without_dwells(problem, motion)
    _, last = moving.u[-2:]
    np.testing.assert_allclose(last, moving(np.nextafter(moving.t[-1:], 0.0)).u[0])
    assert last < -1.0


def test_motion_with_too_short_a_dwell_keeps_its_moving_parts():
    """Regression: nodes within the wanted dwell were left out, where the arm moved."""
    problem = on_rail(at(0.1, dwell=0.25), at(0.2))
    t = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    q = np.array([0.0, 0.05, 0.1, 0.1, 0.1, 0.15, 0.2])[:, None]
    v = np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.5, 0.0])[:, None]
    names, ends = problem.robot.joint_names, np.array([0.4, 0.6])
    motion = tm.Trajectory(names, t, q, v, 0.0 * q, segment_ends=ends)
    changed, moving = without_dwells(problem, motion)
    assert moving.q[:, 0].tolist() == [0.0, 0.05, 0.1, 0.15, 0.2]
    np.testing.assert_allclose(moving.t, [0.0, 0.1, 0.2, 0.3, 0.4])
    assert [segment.dwell for segment in changed.segments] == pytest.approx([0.2, 0.0])
