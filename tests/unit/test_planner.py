"""Planning end to end: goals, methods, time limits, failures."""

from __future__ import annotations

import warnings
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import tominpmp as tm
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import RobotKinematics
from tominpmp.planner.automatic_options import minimum_time, resolve_options
from tominpmp.transcription.problem_functions import ProblemFunctions

# Other tests cover the search for the best motion.
plan_quickly = partial(tm.plan, effort="quick", refine=None)

START = (0.5, 1.7, -1.7)
OBSTACLE = tm.Scene([tm.Sphere("O", radius=0.8, position=(4, 0, 0))])
REACH = tm.PositionGoal("tip", (4, 1, 0))


@pytest.fixture(scope="module")
def around(planar3r):
    """The paper's problem with the obstacle, planned with default options."""
    problem = tm.Problem(planar3r, START, REACH, scene=OBSTACLE)
    return tm.plan(problem, tm.Options(starts=2))


@pytest.mark.parametrize(
    ("scene", "changes", "expected"),
    [
        (OBSTACLE, {}, (2e-4, True)),
        (OBSTACLE, {"lp_solver": "highs"}, (2e-4, False)),
        (OBSTACLE, {"smoothing": 0.01}, (0.01, False)),
        (tm.Scene(), {}, (2e-4, False)),
    ],
)
def test_weight_of_control_jumps_depends_on_obstacles_and_options(
    planar3r, scene, changes, expected
):
    """Squared jumps among obstacles; in free space torques jump between limits."""
    problem = tm.Problem(planar3r, START, REACH, scene=scene)
    options = resolve_options(problem, tm.Options(**changes))
    system = ProblemFunctions.of(problem)
    least = minimum_time(system, options, 2.0)
    assert (least.jump_weight, least.squared) == expected


def worst(robot, motion, count=3000):
    """Largest relative excess of position, speed and torque on a dense motion."""
    limits = robot.limits
    q, v, a, _ = motion(np.linspace(0, motion.duration, count))
    u = RobotDynamics(robot).inverse(q, v, a)
    return (
        float(np.max([q - limits.position_upper, limits.position_lower - q])),
        float(np.max(np.abs(v) / limits.velocity)) - 1,
        float(np.max(np.abs(u) / limits.effort_upper)) - 1,
    )


def test_default_plan_keeps_all_limits_between_the_nodes(planar3r, around):
    assert around.status is tm.Status.CONVERGED and around.success
    position, velocity, torque = worst(planar3r, around.trajectory)
    assert position <= 1e-9
    assert velocity <= 1e-6
    assert torque <= 2.5e-3
    tip = (
        RobotKinematics(planar3r).placement(around.trajectory.q[-1], "tip").translation
    )
    np.testing.assert_allclose(tip, (4, 1, 0), atol=1e-5)
    np.testing.assert_allclose(around.trajectory.v[-1], 0, atol=1e-9)


def test_motion_keeps_clear_of_the_obstacle(planar3r, around):
    kinematics = RobotKinematics(planar3r)
    motion = around.trajectory
    for q in motion(np.linspace(0, motion.duration, 400)).q:
        joints = [
            kinematics.placement(q, frame).translation
            for frame in ("link1", "link2", "link3", "tip")
        ]
        for a, b in pairwise(joints):
            s = np.clip((np.array([4, 0, 0]) - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            assert np.linalg.norm(a + s * (b - a) - (4, 0, 0)) > 0.8 - 2e-3


def test_replaying_the_torques_ends_at_the_goal(planar3r, around):
    """The torques, integrated by SciPy through ABA, yield the planned motion."""
    motion, dynamics = around.trajectory, RobotDynamics(planar3r)

    def rate(t, x):
        return dynamics.forward(x[None], motion(t).u[None])[0]

    x = np.concatenate([motion.q[0], motion.v[0]])
    for begin, end in zip(motion.t[:-1], motion.t[1:], strict=True):
        span = (begin, np.nextafter(end, 0))
        x = solve_ivp(rate, span, x, method="DOP853", rtol=1e-9, atol=1e-10).y[:, -1]
    np.testing.assert_allclose(x[:3], motion.q[-1], atol=1e-5)
    np.testing.assert_allclose(x[3:], motion.v[-1], atol=1e-4)


def test_at_every_instant_a_motor_is_saturated(planar3r):
    """This is the result of Sontag and Sussmann that the paper quotes."""
    free = planar3r.with_changes(position_lower=-20, position_upper=20)
    options = tm.Options(intervals=75, smoothing=0.0, starts=1)
    solution = plan_quickly(tm.Problem(free, START, REACH), options)
    motion = solution.trajectory
    middles = 0.5 * (motion.t[1:] + motion.t[:-1])
    ends = np.stack([motion.t[:-1], middles, motion.t[1:] - 1e-12])
    load = np.abs(motion(ends.ravel()).u) / planar3r.limits.effort_upper
    saturated = load.max(axis=1).reshape(3, -1).max(axis=0) > 0.99
    assert saturated.mean() >= 0.95


@pytest.mark.parametrize(
    "goal",
    [
        tm.JointGoal((1.2, 0.3, 0.4), v=(0.2, -0.1, 0.3)),
        tm.PositionGoal("tip", (4, 1, 0), v=(0.3, 0.5, 0.0)),
    ],
    ids=["joint", "tip"],
)
def test_velocities_at_start_and_goal_are_met(planar3r, goal):
    v_start = (0.3, -0.2, 0.1)
    problem = tm.Problem(planar3r, START, goal, v_start=v_start)
    solution = plan_quickly(problem, tm.Options(starts=1))
    assert solution.success, solution.message
    motion = solution.trajectory
    np.testing.assert_allclose(motion.v[0], v_start)
    residual = goal.residual(RobotKinematics(planar3r), motion.q[-1], motion.v[-1])
    np.testing.assert_allclose(residual.value, 0, atol=2e-5)


def test_pose_goal_is_reached():
    robot = tm.load_robot("ur5", limits="urdf")
    start = np.array([0.0, -1.2, 1.2, -0.5, -0.8, 0.3])
    pose = RobotKinematics(robot).placement(start + 0.4, "tool0")
    solution = plan_quickly(
        tm.Problem(robot, start, tm.PoseGoal("tool0", pose)), tm.Options(starts=2)
    )
    assert solution.success, solution.message
    reached = RobotKinematics(robot).placement(solution.trajectory.q[-1], "tool0")
    assert reached.isApprox(pose, 1e-4)


def test_plan_with_mimic_joints_keeps_torque_limits():
    robot = tm.load_robot("panda", limits="urdf")
    start = np.array([0, -0.5, 0, -2, 0, 1.6, 0.8, 0.01])
    shift = np.append(np.full(7, 0.3), 0.02)
    problem = tm.Problem(robot, start, tm.JointGoal(start + shift))
    solution = tm.plan(problem)
    assert solution.success, solution.message
    assert worst(robot, solution.trajectory)[2] <= 2.5e-3


def test_smoothing_reduces_the_variation_of_controls(planar3r):
    problem = tm.Problem(planar3r, START, tm.JointGoal((1.2, 0.3, 0.4)))

    def variation(smoothing):
        options = tm.Options(control="linear", smoothing=smoothing)
        solution = plan_quickly(problem, options)
        a = solution.trajectory(solution.trajectory.t).a
        return np.abs(np.diff(a, 2, axis=0)).sum(), solution.T

    rough, fastest = variation(0.0)
    smooth, slower = variation(3e-3)
    assert smooth < 0.8 * rough
    assert fastest <= slower * 1.001


def test_same_seed_gives_the_same_motion(planar3r):
    problem = tm.Problem(planar3r, START, REACH)
    one, two = (plan_quickly(problem, tm.Options(starts=2, seed=3)) for _ in range(2))
    np.testing.assert_array_equal(one.trajectory.q, two.trajectory.q)


def test_callback_sees_progress_and_can_stop(planar3r):
    records = []

    def stop(record):
        records.append(record)
        return len(records) >= 10

    problem = tm.Problem(planar3r, START, tm.JointGoal((2.5, -1.0, 1.0)))
    solution = plan_quickly(problem, tm.Options(callback=stop, tolerance=1e-9))
    assert solution.status is tm.Status.INTERRUPTED
    assert len(records) == 10 == solution.iterations
    assert solution.success  # a coarse motion is a success, too
    assert worst(planar3r, solution.trajectory)[1] <= 1e-6


def test_callback_that_is_neither_true_nor_false_raises_its_error(planar3r):
    problem = tm.Problem(planar3r, START, tm.JointGoal((2.5, -1.0, 1.0)))
    with pytest.raises(ValueError, match="truth value"):
        plan_quickly(problem, callback=lambda record: np.zeros(2))


def test_time_limit_returns_the_best_iterate_so_far(planar3r, clock):
    def slow(record):
        clock.advance(550.0)  # no time is left for a replay

    problem = tm.Problem(planar3r, START, REACH, scene=OBSTACLE)
    options = tm.Options(max_planning_time=500.0, tolerance=1e-9, callback=slow)
    solution = plan_quickly(problem, options)
    assert solution.status is tm.Status.TIME_LIMIT
    assert solution.iterations == 1
    assert solution.trajectory is not None
    assert not solution.success
    with pytest.raises(tm.PlanningFailed) as caught:
        solution.raise_if_failed()
    assert caught.value.solution is solution


def test_plan_without_time_has_the_status_time_limit():
    problem = tm.Problem(tm.load_robot("planar3r"), START, REACH, scene=OBSTACLE)
    solution = plan_quickly(problem, tm.Options(max_planning_time=1e-6))
    assert solution.status is tm.Status.TIME_LIMIT
    assert solution.iterations <= 1
    # The initial guess, slowed down, is a motion, or the plan has no motion.
    assert not solution.success or solution.verification.ok


def test_interruption_returns_a_solution(planar3r):
    def interrupt(record):
        if record.iteration == 3:
            raise KeyboardInterrupt

    problem = tm.Problem(planar3r, START, tm.JointGoal((2.5, -1.0, 1.0)))
    solution = plan_quickly(problem, tm.Options(callback=interrupt, tolerance=1e-9))
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.trajectory is not None


def test_goal_behind_a_wall_is_infeasible_with_a_reason():
    robot = tm.load_robot("planar3r")
    ring = [
        tm.Sphere(
            f"S{i}", radius=0.5, position=(4 + 0.9 * np.cos(a), 1 + 0.9 * np.sin(a), 0)
        )
        for i, a in enumerate(np.linspace(0, 2 * np.pi, 12, endpoint=False))
    ]
    problem = tm.Problem(robot, START, REACH, scene=tm.Scene(ring))
    solution = plan_quickly(
        problem, tm.Options(starts=1, max_iterations=12, intervals=20)
    )
    assert not solution.success
    assert solution.status is not tm.Status.CONVERGED
    assert any(word in solution.message for word in ("overlap", "goal", "from"))


def test_pose_without_a_configuration_is_refused(planar3r):
    kinematics = RobotKinematics(planar3r)
    pose = kinematics.placement(np.array(START), "tip")
    pose.translation = pose.translation + np.array([0, 0, 0.5])  # out of the plane
    problem = tm.Problem(planar3r, START, tm.PoseGoal("tip", pose))
    with pytest.raises(tm.ProblemError, match="no configuration within"):
        plan_quickly(problem)


def test_passive_joints_need_collocation(planar3r):
    passive = planar3r.with_changes(effort={"joint3": 0.0}, gravity=(0, 0, 0))
    problem = tm.Problem(passive, START, tm.JointGoal((0.6, 1.7, -1.7)))
    assert resolve_options(problem, tm.Options()).method == "collocation"
    with pytest.raises(tm.OptionsError, match="joint3"):
        resolve_options(problem, tm.Options(method="inverse"))


def test_unknown_solver_is_refused_before_planning(planar3r):
    problem = tm.Problem(planar3r, START, tm.JointGoal((0.6, 1.7, -1.7)))
    with pytest.raises(tm.SolverNotFound):
        plan_quickly(problem, tm.Options(lp_solver="nonesuch"))


def test_initial_control_of_wrong_shape_is_refused(planar3r):
    problem = tm.Problem(planar3r, START, REACH)
    options = tm.Options(method="adjoint", initial_control=np.zeros((3, 2)))
    with pytest.raises(tm.OptionsError, match="initial_control"):
        plan_quickly(problem, options)


def test_plan_raises_no_numerical_warnings(planar3r):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plan_quickly(tm.Problem(planar3r, START, tm.JointGoal((1.0, 0.5, 0.0))))


@pytest.mark.parametrize(
    ("options", "among"),
    [
        ({"control": "constant"}, "piecewise constant accelerations on 40 intervals"),
        ({"control": "linear"}, "piecewise linear accelerations on 40 intervals"),
        ({"control": "spline"}, "piecewise cubic accelerations on 40 intervals"),
        ({"method": "collocation"}, "piecewise constant torques on 40 intervals"),
    ],
)
def test_message_names_the_requested_grid_of_the_optimum(planar3r, options, among):
    problem = tm.Problem(planar3r, START, tm.JointGoal([1.5, 1.0, -0.7]))
    coarse = tm.plan(problem, refine=None, **options)
    assert coarse.status is tm.Status.CONVERGED
    assert f"motion was found among {among}. T = " in coarse.message


def test_message_names_no_grid_if_no_grid_was_requested(planar3r):
    problem = tm.Problem(planar3r, START, tm.JointGoal([1.5, 1.0, -0.7]))
    assert "among" not in tm.plan(problem).message
