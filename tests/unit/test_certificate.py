"""The certificate of the minimum principle, compared with extremals known otherwise."""

from __future__ import annotations

import pickle
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from bang_bang import Shooting
from optimum_cases import Case, friction_cases, pendulum_cases, swing_cases
from sample_arms import DOWNWARD, make_arm, rod, slide

from tominpmp.arrays import Array
from tominpmp.certificate.certificate import Certificate
from tominpmp.certificate.dual_program import solve_dual_program
from tominpmp.certificate.limits import LimitRows, limits_of
from tominpmp.certificate.minimum_principle import certify
from tominpmp.certificate.motion import (
    MOST,
    GridMotion,
    Perturbations,
    certificate_grid,
)
from tominpmp.collision.checker import CollisionChecker
from tominpmp.constraints.base import Partials, States
from tominpmp.constraints.orientation import KeepUpright
from tominpmp.constraints.tool_speed import ToolSpeed
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError
from tominpmp.goals.frames import PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.goals.sets import AnyGoal
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import EffortCurve, MotionLimits
from tominpmp.options import Options
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.motion import ConstantVelocity
from tominpmp.scene.obstacles import Sphere
from tominpmp.scene.scene import Scene
from tominpmp.solution import Solution
from tominpmp.status import Status
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.verification.verification import verify

MASS, FORCE = 2.0, 10.0
START = (0.5, 1.7, -1.7)


# -- motions ---------------------------------------------------------------------------


def rail(distance: float = 1.0, **limits: float) -> Problem:
    """A mass on a rail without friction, from rest to rest."""
    robot = make_arm(slide(MASS), effort=FORCE, position_lower=-4, position_upper=4)
    if limits:
        robot = make_arm(slide(MASS), effort=FORCE, **limits)
    return Problem(robot, [0.0], JointGoal([distance]))


def bang_bang_rail(distance: float = 1.0, switch: float = 0.5) -> Trajectory:
    """Full force, and full braking force after the share `switch` of the duration."""
    a = FORCE / MASS
    T = 2.0 * np.sqrt(distance / a)
    t = np.array([0.0, switch * T, T])
    v = np.array([0.0, a * t[1], a * t[1] - a * (T - t[1])])
    q = np.cumsum(np.append(0.0, 0.5 * (v[1:] + v[:-1]) * np.diff(t)))
    u = FORCE * np.array([1.0, -1.0, -1.0])
    return Trajectory(("joint1",), t, q[:, None], v[:, None], u[:, None])


def exact(case: Case, samples: int = 30) -> tuple[Problem, Trajectory, Array]:
    """An extremal by shooting, with its costates at the nodes."""
    shooting = Shooting(case.task, case.structures[0])
    ends = shooting.polish(np.array(case.structures[0].times))
    arcs = shooting.integrate(ends, samples)
    p0 = shooting.costate(arcs)
    begins = np.append(0.0, ends[:-1])
    t, x, u, p = [], [], [], []
    for k, (states, matrices) in enumerate(arcs):
        rows = len(states) if k == len(arcs) - 1 else len(states) - 1
        t.append(np.linspace(begins[k], ends[k], len(states))[:rows])
        x.append(states[:rows])
        u.append(np.tile(shooting.torques[k], (rows, 1)))
        p += [np.linalg.solve(matrix.T, p0) for matrix in matrices[:rows]]
    q, v = np.split(np.concatenate(x), 2, axis=1)
    problem = case.problem()
    motion = Trajectory(
        problem.robot.joint_names, np.concatenate(t), q, v, np.concatenate(u)
    )
    return problem, motion, np.array(p)


def slowed(problem: Problem, motion: Trajectory, factor: float) -> Trajectory:
    """The same path, traversed slower."""
    inverse = RobotDynamics(problem.robot).inverse
    v, a = motion.v / factor, motion.a
    u = inverse(motion.q, v, motion(motion.t).a / factor**2)
    if a is not None:
        a = a / factor**2
    return Trajectory(motion.joint_names, factor * motion.t, motion.q, v, u, a, inverse)


@cache
def arm(*, limited: bool) -> Robot:
    """The paper's arm, with its limits or with its torque limits alone."""
    if limited:
        return load_robot("planar3r")
    return load_robot(
        "planar3r", position_lower=-100.0, position_upper=100.0, velocity=1000.0
    )


@cache
def planned(method: str = "auto", *, limited: bool = False) -> Solution:
    """A joint motion of the paper's arm, over an obstacle if it is limited."""
    if not limited:
        problem = Problem(arm(limited=False), START, JointGoal((0.9, -1.2, -0.9)))
        options = Options(method=method, starts=1, refine=None)  # type: ignore[arg-type]
        return plan(problem, options)
    scene = Scene([Sphere("O", radius=0.8, position=(4, 0, 0))])
    problem = Problem(arm(limited=True), START, PositionGoal("tip", (4, 1, 0)), scene)
    return plan(problem, Options(starts=1))


@cache
def speed_limited() -> Solution:
    """A motion of an arm at whose optimum speed limits are active."""
    robot = load_robot("ur5", limits="urdf")
    goal = JointGoal((1.0, -0.6, 0.9, -1.5, 0.4, 1.2))
    return plan(Problem(robot, (-0.8, -1.2, 1.2, -1.0, 0.0, 0.0), goal))


def certificate(solution: Solution) -> Certificate:
    found = solution.certificate
    assert found is not None
    return found


# -- against closed forms --------------------------------------------------------------


@pytest.mark.parametrize("distance", [0.01, 1.0, 3.0])
def test_certificate_of_a_double_integrator_matches_the_closed_form(
    distance: float,
) -> None:
    """The costates are p_q = -T / 2d, p_v = p_q (T / 2 - t) for each distance d."""
    found = certify(rail(distance), bang_bang_rail(distance))
    T = 2.0 * np.sqrt(distance * MASS / FORCE)
    assert found.ok, found.message
    assert found.t.size - 1 >= 20  # two intervals would show no time history
    p_q, p_v = found.costates.T
    np.testing.assert_allclose(p_q, -T / (2.0 * distance), rtol=1e-4)
    line = -T / (2.0 * distance) * (0.5 * T - found.t)
    np.testing.assert_allclose(p_v, line, atol=2e-4 * np.max(np.abs(line)))
    middle = 0.5 * (found.t[1:] + found.t[:-1])
    expected = 2.0 * middle / T - 1.0  # in half ranges of the force
    np.testing.assert_allclose(found.switching[:, 0], expected, atol=2e-4)
    assert found.hamiltonian_deviation < 1e-4
    assert np.max(np.abs(found.hamiltonian)) < 1e-4
    assert found.stationarity < 1e-6
    assert found.sign_share == found.saturated_share == found.active_share == 1.0
    assert found.costate_error is not None and found.costate_error < 1e-6


@pytest.mark.parametrize(
    "case", [*pendulum_cases(), swing_cases()[0]], ids=lambda case: case.name
)
def test_costates_of_a_pendulum_match_those_of_a_shooting_method(case: Case) -> None:
    """The shooting method uses no linear program."""
    problem, motion, p = exact(case)
    found = certify(problem, motion)
    assert found.ok, found.message
    nodes = np.searchsorted(found.t, motion.t)
    np.testing.assert_allclose(found.t[nodes], motion.t)
    assert np.max(np.abs(found.costates[nodes] - p)) < 6e-3 * np.max(np.abs(p))
    assert found.hamiltonian_deviation < 6e-3
    assert found.stationarity < 1e-5
    assert found.sign_share == 1.0
    assert found.costate_error is not None and found.costate_error < 1e-3


def test_switching_function_changes_sign_late_with_friction() -> None:
    """The force has the sign of its switching function with friction, too."""
    case = friction_cases()[1]
    found = certificate(plan(case.problem(), Options(refine="switching", starts=1)))
    assert found.ok, found.message
    assert found.stationarity < 1e-5
    assert found.hamiltonian_deviation < 1e-3
    changes = np.flatnonzero(np.diff(np.sign(found.switching[:, 0])) > 0)
    assert changes.size == 1
    assert found.t[changes[0]] > 0.55 * found.t[-1]


def test_switching_function_vanishes_on_the_speed_limit() -> None:
    """On its speed limit the mass needs no force: sigma is zero, and p decreases."""
    speed = 1.0
    problem = rail(1.0, velocity=speed, position_lower=-4, position_upper=4)
    a = FORCE / MASS
    ramp, T = speed / a, 1.0 / speed + speed / a
    t = np.array([0.0, ramp, T - ramp, T])
    v = speed * np.array([0.0, 1.0, 1.0, 0.0])
    q = np.cumsum(np.append(0.0, 0.5 * (v[1:] + v[:-1]) * np.diff(t)))
    u = FORCE * np.array([1.0, 0.0, -1.0, -1.0])
    motion = Trajectory(("joint1",), t, q[:, None], v[:, None], u[:, None])
    found = certify(problem, motion)
    assert found.ok, found.message
    assert found.stationarity < 1e-5
    # dT / dq = -1 / speed, as each metre takes that long.
    np.testing.assert_allclose(found.costates[:, 0], -1.0 / speed, rtol=1e-3)
    cruise = (found.t[:-1] > 1.05 * ramp) & (found.t[1:] < T - 1.05 * ramp)
    np.testing.assert_allclose(found.switching[cruise], 0.0, atol=1e-3)
    limit = next(item for item in found.active if item.kind == "velocity")
    assert limit.name == "joint1"
    assert limit.upper.all()
    # The interval before the limit is reached counts, as it ends on it.
    assert limit.end.max() == pytest.approx(T - ramp)
    assert found.active_share == pytest.approx(1.0)
    assert found.hamiltonian_mean_deviation < 0.02


# -- motions that are not optimal ------------------------------------------------------


@pytest.mark.parametrize("factor", [1.02, 1.05, 1.3])
@pytest.mark.parametrize("at_speed_limits", [False, True])
def test_slowed_motion_fails_with_a_predicted_gain_of_its_slowdown(
    at_speed_limits: bool, factor: float
) -> None:
    """A motion slowed by a share has at least this share as its predicted gain."""
    solution = speed_limited() if at_speed_limits else planned()
    motion = solution.trajectory
    assert motion is not None
    before = certificate(solution).stationarity
    found = certify(solution.problem, slowed(solution.problem, motion, factor))
    assert not found.ok
    assert "does not satisfy the first-order conditions" in found.message
    assert ("velocity" if at_speed_limits else "torque") in found.message
    gained = 1.0 - 1.0 / factor
    # Torques grow with the square of the pace, so that their predicted gain is larger.
    most = 0.5 * (factor**2 - 1.0)
    assert gained - 1e-3 < found.stationarity < most + before + 2e-3


def test_detour_around_a_removed_obstacle_fails() -> None:
    """Without the obstacle the motion could be shorter."""
    solution = planned(limited=True)
    motion = solution.trajectory
    assert motion is not None
    assert certificate(solution).ok, certificate(solution).message
    free = replace(solution.problem, robot=arm(limited=False), scene=Scene([]))
    found = certify(free, motion)
    assert not found.ok
    assert found.stationarity > 0.05


def test_motion_that_brakes_late_is_not_admissible() -> None:
    """The mass ends beyond the goal, and moving."""
    found = certify(rail(), bang_bang_rail(switch=0.55))
    assert not found.ok
    assert "not admissible" in found.message
    assert "joint joint1 ends" in found.message


def test_message_has_the_instant_of_a_torque_below_its_limit() -> None:
    """For 0.1 s the force is half of the force of the other intervals."""
    problem, T = rail(), 1.0
    t = np.linspace(0.0, T, 41)
    share = np.where(t < 0.5, 1.0, -1.0)
    weak = (t >= 0.1) & (t < 0.2)
    share[weak] *= 0.5
    a = 4.0 * share / 0.9
    h = np.diff(t)
    v = np.append(0.0, np.cumsum(a[:-1] * h))
    q = np.append(0.0, np.cumsum(v[:-1] * h + 0.5 * a[:-1] * h**2))
    problem = Problem(problem.robot, [0.0], JointGoal([q[-1]], [v[-1]]))
    u = MASS * a
    robot = make_arm(
        slide(MASS), effort=float(np.abs(u).max()), position_lower=-4, position_upper=4
    )
    problem = replace(problem, robot=robot)
    found = certify(
        problem, Trajectory(("joint1",), t, q[:, None], v[:, None], u[:, None])
    )
    assert not found.ok
    assert "torque of joint joint1" in found.message
    when = float(found.message.split("most at ")[1].split(" s")[0])
    assert 0.1 < when < 0.2
    inside = (found.t[:-1] > 0.099) & (found.t[1:] < 0.201)
    assert not found.obeys[inside].any()
    assert found.obeys[~inside].mean() > 0.9


# -- planned motions -------------------------------------------------------------------


@pytest.mark.parametrize("method", ["inverse", "collocation", "adjoint"])
def test_converged_motion_of_every_method_is_certified(method: str) -> None:
    """A converged motion satisfies the first-order conditions, whatever the method."""
    solution = planned(method)
    found = certificate(solution)
    assert found.ok, found.message
    assert found.message.startswith("The motion satisfies the first-order conditions")
    assert found.stationarity < 3e-3
    assert found.sign_share > 0.97
    assert found.saturated_share > 0.9
    assert found.hamiltonian_mean_deviation < 0.06
    assert found.costate_error is not None and found.costate_error < 0.05
    assert certificate(solution) is found  # computed once
    # The optimum of finer grids is within the gain that the certificate predicts.
    other = min(planned(name).T for name in ("inverse", "collocation", "adjoint"))
    assert solution.T * (1.0 - found.grid_gain - 2e-3) < other


def test_mean_of_the_hamiltonian_is_zero() -> None:
    """The duration is free, so that the mean of H is zero."""
    for solution in (planned(), planned(limited=True), speed_limited()):
        found = certificate(solution)
        mean = np.average(found.hamiltonian, weights=np.diff(found.t))
        assert abs(mean) < 1e-4


def test_predicted_gain_is_the_sum_over_the_multipliers() -> None:
    """By duality, the predicted gain is the sum of multiplier times slack."""
    solution = planned(limited=True)
    assert solution.trajectory is not None
    motion = GridMotion.of(ProblemFunctions.of(solution.problem), solution.trajectory)
    found = solve_dual_program(motion)
    assert found is not None
    given = found.multipliers
    assert np.all(given.value >= 0.0)
    assert np.all(given.slack >= 0.0)
    assert found.predicted_gain == pytest.approx(float(given.predicted_gain.sum()))
    assert given.of("effort").sum() + given.of("clearance").sum() > 100


def test_active_speed_limits_are_listed_in_the_certificate() -> None:
    """An industrial arm is limited by its speeds, which explain its torques."""
    found = certificate(speed_limited())
    assert found.ok, found.message
    assert found.active_share > 0.95
    assert "velocity" in {item.kind for item in found.active}
    assert found.sign_share > 0.95
    for item in found.active:
        assert item.begin.shape == item.end.shape == item.multiplier.shape
        assert np.all(item.begin < item.end)
        assert np.all(item.multiplier > 0.0)


def test_joint_without_a_motor_satisfies_the_conditions() -> None:
    """A passive joint has no switching function that it could contradict."""
    robot = make_arm(
        slide(1.0),
        rod(0.5, 1.0),
        effort={"joint1": 10.0, "joint2": 0.0},
        gravity=DOWNWARD,
        position_lower=-10.0,
        position_upper=10.0,
        velocity=100.0,
    )
    hanging = -0.5 * np.pi
    problem = Problem(robot, (0.0, hanging), JointGoal((0.5, hanging)))
    found = certificate(plan(problem, Options(starts=1)))
    assert found.ok, found.message
    assert found.obeys[:, 1].all()
    assert np.max(np.abs(found.switching[:, 0])) > 0.1


@pytest.mark.parametrize("count", [50, 400])
def test_certificate_of_many_nodes_uses_a_coarser_grid(count: int) -> None:
    """The result is the same on the coarser grid."""
    whole = bang_bang_rail()
    t = np.linspace(0.0, whole.duration, 2 * count + 1)
    state = whole(t)
    motion = Trajectory(("joint1",), t, state.q, state.v, state.u)
    grid, joined = certificate_grid(motion)
    assert joined == (2 * count > MOST)
    assert 20 <= grid.size - 1 <= MOST
    assert np.min(np.abs(grid - whole.t[1])) < 1e-9
    found = certify(rail(), motion, verification=verify(rail(), whole))
    assert found.ok, found.message
    assert found.stationarity < 1e-4
    assert found.hamiltonian_deviation < 2e-2


def test_certificate_of_a_goal_set_uses_the_reached_goal() -> None:
    """Both goals of the set are joint goals."""
    problem = rail()
    goals = AnyGoal([JointGoal([2.0]), JointGoal([1.0])])
    found = certify(Problem(problem.robot, [0.0], goals), bang_bang_rail())
    assert found.ok, found.message


def test_goal_set_may_have_goals_with_different_numbers_of_rows() -> None:
    """A goal of a frame has another number of rows than a goal of joints."""
    problem = rail()
    goals = AnyGoal([PositionGoal("tip", (-0.5, 0.0, 0.0)), JointGoal([1.0])])
    found = certify(Problem(problem.robot, [0.0], goals), bang_bang_rail())
    assert found.ok, found.message


# -- limits as rows --------------------------------------------------------------------


def test_every_limit_row_matches_differences(rng: np.random.Generator) -> None:
    """The differences are over accelerations and interval lengths."""
    limits = MotionLimits(
        acceleration=9.0,
        jerk=200.0,
        effort_rate=500.0,
        effort_curves={"joint1": EffortCurve.droop(25.0, 12.0)},
    )
    scene = Scene([Sphere("O", radius=0.8, position=(3.2, 3.2, 0))])
    problem = Problem(
        arm(limited=False),
        START,
        JointGoal((0.9, -1.2, -0.9)),
        scene,
        0.0,
        None,
        limits,
    )
    inverse = RobotDynamics(problem.robot).inverse
    N, n = 40, 3
    h = rng.uniform(0.02, 0.03, N)

    def build(a: Array, h: Array) -> Trajectory:
        q, v = [np.array(START)], [np.zeros(n)]
        for k in range(N):
            q.append(q[-1] + h[k] * v[-1] + h[k] ** 2 * (2.0 * a[k] + a[k + 1]) / 6.0)
            v.append(v[-1] + 0.5 * h[k] * (a[k] + a[k + 1]))
        t = np.append(0.0, np.cumsum(h))
        u = inverse(np.array(q), np.array(v), a)
        return Trajectory(
            problem.robot.joint_names, t, np.array(q), np.array(v), u, a, inverse
        )

    def keyed(rows: LimitRows) -> list[tuple[object, ...]]:
        """Keys of the rows; their instants may move a little."""
        keys, seen = [], Counter[tuple[object, ...]]()
        places = rows.kind, rows.at.interval, rows.subject, np.round(rows.at.share, 3)
        for key in zip(*(part.tolist() for part in places), strict=True):
            seen[key] += 1
            keys.append((*key, seen[key]))
        return keys

    def rooms(motion: GridMotion) -> dict[tuple[object, ...], float]:
        """The slack of each row to its upper bound."""
        rows = limits_of(motion)
        return dict(zip(keyed(rows), rows.upper.tolist(), strict=True))

    checker = CollisionChecker(problem.robot, scene)
    while True:
        # Accelerations are continuous and piecewise linear.
        a = rng.normal(0.0, 2.0, (N + 1, n))
        a[[0, -1]] = 0.0
        base = build(a, h)
        if checker.is_free(base.q[-1], 0.02):  # it is the goal, see below
            break
    speed = ToolSpeed("tip", 1.0)
    tilt = KeepUpright("tip", (1.0, 0.0, 0.0), (1.0, 0.0, 0.0), 1.0)
    states = States(base.t, base.q, base.v, a)
    most = [
        float(item.on(problem.robot).measures(states).max()) for item in (speed, tilt)
    ]
    # The limits are a little above the largest values.
    limited = (
        replace(speed, limit=1.04 * most[0]),
        replace(tilt, tolerance=1.04 * most[1]),
    )
    reached = JointGoal(base.q[-1])  # the final position, which satisfies these limits
    problem = replace(problem, goal=reached, constraints=limited)
    system = ProblemFunctions.of(problem)
    motion = GridMotion.of(system, base)
    assert motion.changes.profile == "ramps"
    rows = limits_of(motion)
    assert set(rows.kind.tolist()) >= {
        "effort",
        "effort rate",
        "effort over speed",
        "jerk",
        "clearance",
        "speed of frame tip",
        "tilt of frame tip",
    }
    step = 1e-6
    da, dh = rng.normal(0.0, 1.0, (N + 1, n)), 0.01 * rng.normal(0.0, 1.0, N)
    da[[0, -1]] = 0.0
    after, before = (
        build(a + step * da, h + step * dh),
        build(a - step * da, h - step * dh),
    )
    dx = np.concatenate([after.q - before.q, after.v - before.v], axis=1)[1:]
    z = np.concatenate([dx.ravel() / (2.0 * step), da.ravel(), dh])
    np.testing.assert_allclose(motion.changes.defects() @ z, 0.0, atol=1e-6)
    high, low = (
        rooms(GridMotion.of(system, after)),
        rooms(GridMotion.of(system, before)),
    )
    compared = 0
    slope = rows.change @ z
    kinds = rows.kind.tolist()
    scale = {k: max(float(np.max(np.abs(slope[rows.of(k)]))), 1.0) for k in kinds}
    for row, key in enumerate(keyed(rows)):
        room = rows.upper[row]
        if np.isfinite(room) and room > 1e-3 and key in high and key in low:
            found = -(high[key] - low[key]) / (2.0 * step)
            tolerance = 2e-4 * scale[kinds[row]]
            assert slope[row] == pytest.approx(found, abs=tolerance), key
            compared += 1
    assert compared > 450  # one row for each node where values are continuous


def test_perturbations_inside_intervals_match_differences(
    rng: np.random.Generator,
) -> None:
    """Positions and velocities inside intervals of constant acceleration."""
    N, n = 6, 2
    a, h = rng.normal(size=(N, n)), rng.uniform(0.1, 0.3, N)

    def states(a: Array, h: Array, share: float) -> tuple[Array, Array, Array, Array]:
        q, v = [np.zeros(n)], [np.ones(n)]
        for k in range(N):
            q.append(q[-1] + h[k] * v[-1] + 0.5 * h[k] ** 2 * a[k])
            v.append(v[-1] + h[k] * a[k])
        x, y, s = np.array(q), np.array(v), share * h[:, None]
        return x, y, x[:-1] + s * y[:-1] + 0.5 * s**2 * a, y[:-1] + s * a

    step, share = 1e-6, 0.3
    da, dh = rng.normal(size=(N, n)), rng.normal(size=N)
    high = states(a + step * da, h + step * dh, share)
    low = states(a - step * da, h - step * dh, share)
    dq, dv, inside, speed = (
        (one - other) / (2.0 * step) for one, other in zip(high, low, strict=True)
    )
    q, v, q_in, v_in = states(a, h, share)
    changes = Perturbations(np.append(0.0, np.cumsum(h)), q, v, "steps")
    dx = np.concatenate([dq, dv], axis=1)[1:]
    z = np.concatenate([dx.ravel(), da.ravel(), dh])
    assert z.size == changes.size
    at = Instants.spread(N, (share,))
    eye, none = np.tile(np.eye(2 * n), (N, 1)), np.zeros((0, n))
    by = Partials(np.repeat(np.arange(N), 2 * n), *np.hsplit(eye, 2))
    inside_it = States(at.times(h), q_in, v_in, none)
    change = changes.pull_back(at, inside_it, by)
    assert sp.issparse(change)
    found = np.hstack([inside, speed]).ravel()
    np.testing.assert_allclose(change @ z, found, atol=1e-7)


# -- the record, and the figure --------------------------------------------------------


def test_solution_without_motion_has_no_certificate() -> None:
    failed = Solution(rail(), Options(), Status.INFEASIBLE, "no way", False, None)
    assert failed.certificate is None
    with pytest.raises(ProblemError, match="there is no motion: no way"):
        failed.plot_certificate()


def test_motion_of_another_robot_is_rejected() -> None:
    solution = planned()
    assert solution.trajectory is not None
    with pytest.raises(ProblemError, match="this is a motion of joint1, joint2"):
        certify(rail(), solution.trajectory)


def test_motion_with_nan_is_rejected() -> None:
    motion = bang_bang_rail()
    broken = replace(motion, v=np.full(motion.v.shape, np.nan))
    with pytest.raises(ProblemError, match="not finite numbers"):
        certify(rail(), broken)


def test_failed_motion_is_not_certified() -> None:
    """A motion whose replay failed is not optimal, whatever its multipliers."""
    solution = planned()
    assert solution.verification is not None
    failed = replace(
        solution, verification=replace(solution.verification, ok=False, violations=())
    )
    assert not certificate(failed).ok
    assert "not admissible" in certificate(failed).message


def test_arrays_are_read_only_and_pickled() -> None:
    found = certify(rail(), bang_bang_rail())
    for name in ("t", "costates", "switching", "hamiltonian", "obeys"):
        with pytest.raises(ValueError):
            getattr(found, name)[0] = 0
    assert pickle.loads(pickle.dumps(found)) == found
    assert found.seconds > 0.0


def test_certificate_plot_has_panels_of_joints_limits_and_hamiltonian(
    tmp_path: Path,
) -> None:
    solution = planned(limited=True)
    path = tmp_path / "certificate.png"
    figure = solution.plot_certificate(path)
    assert path.stat().st_size > 10_000
    n = solution.problem.robot.n
    # Two axes for each joint, one panel of the limits, and one of the Hamiltonian.
    assert len(figure.axes) == 2 * n + 2
    labels = [text.get_text() for text in figure.axes[n].get_yticklabels()]
    assert len(labels) == len(certificate(solution).active)
    assert any(label.startswith("effort, joint1") for label in labels)
    for panel in figure.axes[:n]:
        assert panel.get_xlim() == (0.0, pytest.approx(solution.T))


def test_hamiltonian_may_vary_among_moving_obstacles():
    # A ball is still rising out of the way when the arm passes it: H is the cost of
    # waiting.
    robot = load_robot("planar3r")
    ball = Sphere(
        "lift",
        radius=0.3,
        position=(4.5 * np.cos(0.9), 4.5 * np.sin(0.9), 0.0),
        motion=ConstantVelocity(velocity=(0.0, 0.0, 0.1)),
    )
    goal = JointGoal([1.6, 0.0, 0.0])
    problem = Problem(robot, [0.2, 0, 0], goal, Scene([ball]))
    solution = plan(problem, Options(intervals=20, starts=1, smoothing=0.0))
    certificate = solution.certificate
    assert "Hamiltonian is not constant" not in certificate.message
    assert certificate.hamiltonian_deviation > 0.1
