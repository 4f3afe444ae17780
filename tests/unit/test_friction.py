"""Dry friction: descriptions, dynamics, closed forms on rails, replay and bounds."""

from __future__ import annotations

import itertools
import math
import pickle
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from replays import integration
from sample_arms import DOWNWARD, GRAVITY, describe, make_arm, rod, slide
from scipy.integrate import solve_ivp

import tominpmp as tm
from tominpmp.arrays import Array
from tominpmp.bounds.lower_bound import lower_bound
from tominpmp.combined_robots import combine_robots
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import OptionsError

# The multi-start search is tested elsewhere.
plan_quickly = partial(tm.plan, effort="quick", refine=None)

MASS, FORCE, FRICTION, WAY = 2.0, 10.0, 3.0, 1.2


def rail_time(
    speed_up: float, brake: float, way: float = WAY, top: float = math.inf
) -> float:
    """Minimum time from rest to rest with these accelerations and a speed limit."""
    apart = 1.0 / speed_up + 1.0 / brake
    peak = math.sqrt(2.0 * way / apart)
    if peak <= top:
        return peak * apart
    return top * apart + (way - 0.5 * top**2 * apart) / top


def viscous_time(push: float, drag: float, friction: float, way: float) -> float:
    """Minimum time of a unit mass with friction of both kinds, from rest to rest."""
    up, down = push - friction, push + friction

    def covered(s: float) -> tuple[float, float]:
        """Distance and duration if the force changes its sign at time s."""
        peak = up / drag * (1.0 - math.exp(-drag * s))
        rest = math.log1p(drag * peak / down) / drag
        speeding = up / drag * s - peak / drag
        return speeding + (peak - down * rest) / drag, s + rest

    low, high = 0.0, 100.0
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if covered(middle)[0] < way else (low, middle)
    return covered(high)[1]


Case = tuple[Callable[[], tm.Robot], float, float]
SLIDE = slide(MASS)
UP = slide(MASS, (0.0, 1.0, 0.0))
CASES: dict[str, Case] = {
    "rail": (
        partial(make_arm, SLIDE, effort=FORCE, friction=FRICTION),
        WAY,
        rail_time((FORCE - FRICTION) / MASS, (FORCE + FRICTION) / MASS),
    ),
    "backwards": (
        partial(make_arm, SLIDE, effort=FORCE, friction=FRICTION),
        -WAY,
        rail_time((FORCE - FRICTION) / MASS, (FORCE + FRICTION) / MASS),
    ),
    "speed limit": (
        partial(make_arm, SLIDE, effort=FORCE, friction=FRICTION, velocity=1.0),
        WAY,
        rail_time((FORCE - FRICTION) / MASS, (FORCE + FRICTION) / MASS, top=1.0),
    ),
    "much": (
        partial(make_arm, SLIDE, effort=FORCE, friction=8.5),
        WAY,
        rail_time(1.5 / MASS, 18.5 / MASS),
    ),
    "upwards": (
        partial(make_arm, UP, effort=40.0, friction=6.0, gravity=DOWNWARD),
        WAY,
        rail_time(34.0 / MASS - GRAVITY, 46.0 / MASS + GRAVITY),
    ),
    "downwards": (
        partial(make_arm, UP, effort=40.0, friction=6.0, gravity=DOWNWARD),
        -WAY,
        rail_time(34.0 / MASS + GRAVITY, 46.0 / MASS - GRAVITY),
    ),
    "viscous, too": (
        partial(make_arm, slide(1.0), effort=5.0, friction=1.0, damping=0.8),
        WAY,
        viscous_time(5.0, 0.8, 1.0, WAY),
    ),
}
METHODS: dict[str, dict[str, str]] = {
    "inverse": {},
    "collocation": {"method": "collocation"},
    "adjoint": {"method": "adjoint"},
    "linear": {"control": "linear"},
    "spline": {"control": "spline"},
}


def slid(case: Case, **options: object) -> tm.Solution:
    """Plan the motion of a case on a rail."""
    problem = tm.Problem(case[0](), [0.0], tm.JointGoal([case[1]]))
    chosen = {"effort": "quick", "refine": None, **options}
    return tm.plan(problem, tm.Options(**chosen))  # type: ignore[arg-type]


@cache
def slid_by(name: str, method: str) -> tm.Solution:
    """Plan the motion of a case on a rail by a method."""
    return slid(CASES[name], **METHODS[method])


def integrated_end(solution: tm.Solution, gravity: float = 0.0) -> tuple[float, float]:
    """Final position and velocity of a mass under the forces of a motion.

    Dry friction follows Coulomb's law. Each interval between nodes and stops is
    integrated with one sign of the velocity; at a stop the mass stays if friction
    holds it.
    """
    motion, robot = solution.trajectory, solution.problem.robot
    assert motion is not None
    F, k = float(robot.friction[0]), float(robot.damping[0])
    mass, x, end = MASS, np.zeros(2), motion.duration
    nodes = motion.t.tolist()
    for begin, last in itertools.pairwise(nodes):
        t = begin

        def force(time: float, inside: float = last - 1e-9 * end) -> float:
            return float(motion(min(time, inside)).u[0]) - mass * gravity

        while t < last:
            way = np.sign(x[1])
            if abs(x[1]) < 1e-7:
                free = force(t + 1e-6 * end)
                x[1], way = 0.0, np.sign(free)
                if abs(free) <= F:
                    break

            def rate(time: float, x: Array, way: float = way) -> list[float]:
                return [x[1], (force(time) - F * way - k * x[1]) / mass]

            def stop(time: float, x: Array, way: float = way) -> float:
                return float(way * x[1] + 1e-9)

            stop.terminal, stop.direction = True, -1.0  # type: ignore[attr-defined]
            found = solve_ivp(rate, (t, last), x, events=stop, rtol=1e-9, atol=1e-11)
            x, t = found.y[:, -1], float(found.t[-1])
    return float(x[0]), float(x[1])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", CASES)
def test_duration_on_a_rail_with_friction_matches_the_closed_form(
    name: str, method: str
) -> None:
    case, solution = CASES[name], slid_by(name, method)
    assert solution.success, solution.message
    assert -1e-6 < solution.T / case[2] - 1.0 < 5e-3
    bound = lower_bound(solution.problem).T
    assert bound <= case[2]
    assert bound > 0.99 * case[2] or name == "viscous, too"


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["rail", "upwards", "much"])
def test_independent_integration_ends_at_the_goal(name: str, method: str) -> None:
    solution = slid_by(name, method)
    q, v = integrated_end(solution, GRAVITY if name == "upwards" else 0.0)
    assert q == pytest.approx(CASES[name][1], abs=2e-4)
    assert v == pytest.approx(0.0, abs=2e-3)


def test_message_says_that_a_motor_cannot_overcome_its_friction() -> None:
    with pytest.warns(tm.TominpmpWarning, match="its dry friction of 12 takes all"):
        robot = make_arm(SLIDE, effort=FORCE, friction=12.0)
    problem = tm.Problem(robot, [0.0], tm.JointGoal([WAY]))
    few = tm.Options(starts=1, intervals=8, max_iterations=3)
    solution = plan_quickly(problem, few)
    assert not solution.success
    assert "cannot overcome its dry friction of 12 N" in solution.message


def test_goal_must_be_held_by_the_motor_without_friction() -> None:
    robot = make_arm(UP, effort=15.0, friction=10.0, gravity=DOWNWARD)
    with pytest.raises(tm.ProblemError, match="friction is not counted on"):
        tm.Problem(robot, [0.0], tm.JointGoal([-WAY]))


def test_friction_is_read_from_urdf_and_overridden(tmp_path: Path) -> None:
    path = tmp_path / "rail.urdf"
    text = describe([SLIDE]).replace("<limit", '<dynamics friction="0.7"/><limit', 1)
    path.write_text(text, encoding="utf-8")
    robot = tm.load_robot(path)
    assert robot.friction.tolist() == [0.7]
    other = tm.load_robot(path, friction={"joint1": 0.9})
    assert other.friction.tolist() == [0.9]
    assert other != robot
    assert robot.with_changes(friction=0.9).friction.tolist() == [0.9]
    assert pickle.loads(pickle.dumps(other)) == other
    with pytest.raises(OptionsError, match="friction"):
        tm.load_robot(path, friction=-1.0)


def test_inverse_dynamics_adds_friction_in_the_direction_of_motion() -> None:
    smooth = make_arm(rod(2.0, 1.0), rod(1.0, 0.8), effort=20.0)
    robot = smooth.with_changes(friction=[1.0, 0.5])
    q, v, a = np.array(
        [
            [[0.3, 0.4]] * 3,
            [[1.0, -2.0], [0.0, 0.0], [0.0, 0.0]],
            [[-3.0, 0.0], [2.0, -1.0], [0.0, 0.0]],
        ]
    )
    added = RobotDynamics(robot).inverse(q, v, a)
    added -= RobotDynamics(smooth).inverse(q, v, a)
    expected = [[1.0, -0.5], [1.0, -0.5], [0.0, 0.0]]
    np.testing.assert_allclose(added, expected, atol=1e-12)


def test_forward_dynamics_at_rest_sticks_or_slides() -> None:
    robot = make_arm(rod(2.0, 1.0), rod(1.0, 0.8), effort=20.0, friction=[1.0, 4.0])
    dynamics, rest = RobotDynamics(robot), np.zeros((2, 2))
    u = np.array([[8.0, 1.0], [0.9, -3.9]])
    a = dynamics.forward_along(rest, rest, u, np.array([[1.0, 0.0], [0.0, 0.0]]))
    # Friction holds the second joint against the first one's motion, or holds both.
    assert a[0, 0] > 0.1
    np.testing.assert_allclose([a[0, 1], *a[1]], 0.0, atol=1e-12)
    moving = dynamics.inverse_along(rest, rest, a, np.array([[1.0, 0.0], [0.0, 0.0]]))
    assert moving[0, 0] == pytest.approx(8.0)
    q, v, u = np.array([[0.2, 0.1]]), np.array([[1.5, -0.7]]), np.array([[3.0, 1.0]])
    a = dynamics.forward_along(q, v, u, np.sign(v))
    np.testing.assert_allclose(dynamics.inverse(q, v, a), u, atol=1e-10)


def test_derivatives_with_friction_match_differences_in_motion(
    rng: np.random.Generator,
) -> None:
    robot = make_arm(rod(2.0, 1.0), rod(1.0, 0.8), effort=20.0, friction=[1.0, 4.0])
    dynamics, step = RobotDynamics(robot), 1e-6
    q, v, a, u = rng.normal(size=(4, 1, 2))
    by = dynamics.inverse_jacobians(q, v, a)
    x = np.hstack([q, v])
    f_x = dynamics.forward_jacobians(x, u).f_x[0]
    for i, change in enumerate(step * np.eye(2)[:, None]):
        for part, args in ((by.tau_q, (1, 0, 0)), (by.tau_v, (0, 1, 0))):
            ends = [
                dynamics.inverse(q + s * args[0] * change, v + s * args[1] * change, a)
                for s in (1.0, -1.0)
            ]
            slope = (ends[0] - ends[1])[0] / (2.0 * step)
            np.testing.assert_allclose(part[0, :, i], slope, atol=1e-6)
    for i, change in enumerate(step * np.eye(4)[:, None]):
        ends = [dynamics.forward(x + s * change, u) for s in (1.0, -1.0)]
        slope = (ends[0] - ends[1])[0] / (2.0 * step)
        np.testing.assert_allclose(f_x[:, i], slope, atol=1e-5)


def test_replay_with_friction_matches_moreau_time_stepping() -> None:
    """The second joint sticks, slides, and sticks again."""
    arm = make_arm(
        rod(2.0, 1.0), rod(1.0, 0.8), effort=[20.0, 10.0], friction=[1.0, 4.0]
    )
    t = np.linspace(0.0, 1.0, 11)
    u = np.column_stack([np.where(t < 0.45, 8.0, -8.0), np.where(t < 0.65, 1.0, -6.0)])
    zero = np.zeros((11, 2))
    motion = tm.Trajectory(arm.joint_names, t, zero, zero, u)
    replay = integration(arm, motion).run(np.zeros(4))
    dynamics, F, h = RobotDynamics(arm, dry=False), arm.friction, 1e-3
    q, v = np.zeros(2), np.zeros(2)
    for k in range(1000):
        middle = q + 0.5 * h * v
        by = dynamics.inverse_jacobians(middle[None], v[None], 0.0 * v[None])
        inverse, pulse = np.linalg.inv(by.tau_a[0]), np.zeros(2)
        free = v + h * inverse @ (u[int(k * h * 10 + 1e-9)] - by.tau[0])
        for _ in range(60):
            for i in range(2):
                slip = free[i] - h * (inverse @ pulse)[i]
                pulse[i] += slip / (h * inverse[i, i])
                pulse[i] = np.clip(pulse[i], -F[i], F[i])
        v = free - h * inverse @ pulse
        q = middle + 0.5 * h * v
    assert replay.complete
    assert np.abs(replay.q[400, 1]) < 1e-8  # held by friction until then
    np.testing.assert_allclose(replay.q[-1], q, atol=2e-4)
    np.testing.assert_allclose(replay.v[-1], v, atol=1e-3)


def test_torque_limits_hold_where_a_joint_with_friction_reverses() -> None:
    """The second joint of a swing reverses its direction."""
    robot = make_arm(
        rod(2.0, 1.0),
        rod(1.0, 0.8),
        effort=[20.0, 6.0],
        friction=[2.0, 0.6],
        velocity=8,
    )
    for method in METHODS.values():
        problem = tm.Problem(robot, [0.0, 0.5], tm.JointGoal([2.0, 0.5]))
        solution = plan_quickly(problem, tm.Options(**method))  # type: ignore[arg-type]
        assert solution.success, solution.message
        motion = solution.trajectory
        assert motion is not None
        times = np.linspace(0.01, 0.99, 99) * motion.duration
        assert np.any(np.diff(np.sign(motion(times).v[:, 1])))
        assert solution.verification is not None
        assert solution.verification.worst["effort"].share < 5e-3


def test_friction_of_zero_gives_the_same_motion() -> None:
    """An override of zero friction changes no bit of the motion."""
    robot = make_arm(rod(2.0, 1.0), rod(1.0, 0.8), effort=[20.0, 6.0])
    motions = []
    for arm in (robot, robot.with_changes(friction=0.0)):
        found = plan_quickly(tm.Problem(arm, [0.0, 0.5], tm.JointGoal([1.0, 0.2])))
        assert found.trajectory is not None
        motions.append(found.trajectory)
    assert motions[0] == motions[1]


@pytest.mark.parametrize("name", CASES)
def test_exact_switching_times_with_friction_match_the_closed_form(name: str) -> None:
    case = CASES[name]
    solution = slid(case, refine="switching")
    assert solution.success, solution.message
    assert solution.T == pytest.approx(case[2], rel=1e-9)


def test_exact_switching_is_skipped_where_a_joint_reverses() -> None:
    robot = make_arm(
        rod(2.0, 1.0), rod(1.0, 0.8), effort=[20.0, 6.0], friction=[2.0, 0.6]
    )
    problem = tm.Problem(robot, [0.0, 0.5], tm.JointGoal([2.0, 0.5]))
    solution = tm.plan(problem, tm.Options(refine="switching"))
    assert solution.success
    assert "turns on the way" in solution.message


def test_combined_robots_keep_the_friction_of_each_arm() -> None:
    left = make_arm(SLIDE, effort=FORCE, friction=FRICTION)
    right = make_arm(SLIDE, effort=FORCE, friction=1.0)
    parts = [("left", left, (0.0, 0.0, 0.0)), ("right", right, (0.0, 3.0, 0.0))]
    robot = combine_robots(parts)
    assert robot.friction.tolist() == [FRICTION, 1.0]
    problem = tm.Problem(robot, [0.0, 0.0], tm.JointGoal([WAY, WAY]))
    solution = plan_quickly(problem)
    assert solution.success
    assert solution.T == pytest.approx(CASES["rail"][2], rel=5e-3)


def test_payload_leaves_the_friction_unchanged() -> None:
    robot = make_arm(SLIDE, effort=FORCE, friction=FRICTION)
    load = tm.Payload(1.0, "tip")
    assert robot.with_payload(load).friction.tolist() == [FRICTION]


def test_mimic_joint_adds_its_friction_to_the_leader(tmp_path: Path) -> None:
    path = tmp_path / "gripper.urdf"
    text = describe([rod(1.0, 0.5), rod(1.0, 0.5)])
    text = text.replace("<limit", '<dynamics friction="0.2"/><limit')
    end = text.rindex("</joint>", 0, text.index('<link name="tip"/>'))
    text = f'{text[:end]}<mimic joint="joint1" multiplier="-2"/>{text[end:]}'
    path.write_text(text, encoding="utf-8")
    robot = tm.load_robot(path)
    assert robot.friction.tolist() == [pytest.approx(0.2 + 2.0 * 0.2)]
    problem = tm.Problem(robot, [0.0], tm.JointGoal([1.0]))
    solution = plan_quickly(problem)
    assert solution.success, solution.message


def test_warm_start_with_friction_keeps_the_duration() -> None:
    """A warm start's torques are those of the motors, including friction."""
    case = CASES["rail"]
    for method in ("inverse", "collocation", "adjoint"):
        first = slid(case, method=method)
        again = plan_quickly(first.problem, tm.Options(method=method), start=first)
        assert again.success, again.message
        assert again.T == pytest.approx(first.T, rel=1e-3)


def test_motion_with_friction_is_certified() -> None:
    solution = slid(CASES["rail"])
    assert solution.certificate is not None
    assert solution.certificate.ok


def test_smoothed_motion_with_friction_is_verified() -> None:
    found = tm.smooth(slid(CASES["upwards"]), 0.05)
    assert found.success
    assert found.verification is not None
    assert found.verification.ok
    assert "Quiet torques" in found.message


def test_friction_survives_a_scenario_file(tmp_path: Path) -> None:
    robot = tm.load_robot("planar3r", friction={"joint1": 0.5})
    q = robot.group_state("start")
    problem = tm.Problem(robot, q, tm.JointGoal(q + 0.3))
    path = tmp_path / "cell.toml"
    tm.save_scenario(path, problem)
    assert "friction" in path.read_text(encoding="utf-8")
    assert tm.load_scenario(path).problem.robot == robot


def test_row_exchange_beside_reversals_ends() -> None:
    """Regression: reversals moved at each step, and the plan used up its time."""
    robot = tm.load_robot("ur5", limits="urdf", friction=5.0)
    robot = robot.with_changes(velocity=4.0 * robot.limits.velocity)
    start, end = [1.7, -0.9, 1.2, -0.8, 1.7, -1.6], [-1.2, -2.1, -1.9, 3.0, -0.7, 0.3]
    goal = tm.JointGoal(end, wrap=False)
    problem = tm.Problem(robot, start, goal, self_collision=False)
    solution = tm.plan(problem, max_planning_time=math.inf)
    assert solution.success and solution.T < 0.41
    assert len(solution.history) < 120


@pytest.mark.parametrize("dry", [99.0, 30.0])
def test_friction_beyond_the_effort_limit_is_told_when_the_robot_is_loaded(dry):
    """Regression: a plan used its whole time before its message said so.

    The gripper of a TALOS has a friction that equals its effort limit.
    """
    words = rf"joint2 cannot move it: its dry friction of {dry:g} takes all .* of 30"
    effort, friction = {"joint2": 30.0, "joint3": 0.0}, {"joint2": dry, "joint3": 1.0}
    with pytest.warns(tm.TominpmpWarning, match=words) as told:
        tm.load_robot("planar3r", effort=effort, friction=friction)
    assert len(told) == 1  # a joint without a motor may be moved by others
