"""Lower bounds of arms with one joint: the minimum itself, whatever limits it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from optimum_cases import ROD, pendulum_cases, swing_cases
from sample_arms import DOWNWARD, make_arm, slide
from scipy.integrate import solve_ivp, trapezoid
from scipy.optimize import brentq, linprog

from tominpmp.bounds import lower_bound
from tominpmp.bounds.one_joint import OneJoint
from tominpmp.bounds.single_joint import single_joint_time
from tominpmp.goals import JointGoal
from tominpmp.motion_limits import EffortCurve, MotionLimits
from tominpmp.planner.planning import plan
from tominpmp.problem import Problem
from tominpmp.robot import Robot
from tominpmp.stopping import Stop

MASS, FORCE = 2.0, 10.0


def rail(limits: MotionLimits | None = None, **changes: object) -> Problem:
    robot = make_arm(slide(MASS), effort=FORCE)
    if changes:
        robot = robot.with_changes(**changes)  # type: ignore[arg-type]
    goal = JointGoal(np.ones(1))
    return Problem(robot, np.zeros(1), goal, motion_limits=limits)


def by_peak(
    up: Callable[[np.ndarray], np.ndarray],
    down: Callable[[np.ndarray], np.ndarray],
    most: float,
) -> float:
    """Minimum time over 1 m from rest to rest by quadrature over the speed."""

    def parts(peak: float) -> tuple[float, float]:
        v = np.linspace(0.0, peak, 40_001)
        slowness = 1.0 / up(v) + 1.0 / down(v)
        return float(trapezoid(v * slowness, v)), float(trapezoid(slowness, v))

    return parts(brentq(lambda v: parts(v)[0] - 1.0, 1e-6, most))[1]


def test_every_limit_of_a_rail_gives_its_closed_form() -> None:
    push = FORCE / MASS
    assert lower_bound(rail(MotionLimits(effort_scale=0.5))).T == pytest.approx(
        2.0 * math.sqrt(2.0 / push)
    )
    assert lower_bound(rail(MotionLimits(acceleration=1.0))).T == pytest.approx(2.0)
    jerk = lower_bound(rail(MotionLimits(jerk=30.0), effort=1e6)).T
    assert jerk == pytest.approx((32.0 / 30.0) ** (1.0 / 3.0))
    both = MotionLimits(acceleration=1.0, jerk=4.0)
    # The acceleration rises for 1/4 s, stays t, falls: (t + 1/4)(t + 1/2) = 1 m.
    ramp, plateau = 0.25, 0.5 * (-0.75 + math.sqrt(0.0625 + 4.0))
    assert lower_bound(rail(both)).T == pytest.approx(4 * ramp + 2 * plateau)
    dry = 2.0 / math.sqrt(1.0 / (1.0 / (push - 1.5) + 1.0 / (push + 1.5)) * 2.0)
    assert lower_bound(rail(friction=3.0)).T == pytest.approx(dry)


def test_torque_rates_and_jerks_bend_the_motions_of_rails() -> None:
    rate = lower_bound(rail(MotionLimits(effort_rate=60.0), effort=1e6)).T
    assert rate == pytest.approx((32.0 / 30.0) ** (1.0 / 3.0))
    # Force and its rate: 5 m/s^2 after 1/6 s, as for an acceleration limit.
    both = lower_bound(rail(MotionLimits(effort_rate=60.0))).T
    push, jerk = FORCE / MASS, 30.0
    ramp = push / jerk
    plateau = 0.5 * (-3.0 * ramp + math.sqrt(ramp**2 + 4.0 / push))
    assert both == pytest.approx(4 * ramp + 2 * plateau)
    # More friction takes longer, and a bound remains one where it is viscous.
    dry = lower_bound(rail(MotionLimits(effort_rate=60.0), friction=2.0)).T
    assert dry > both
    viscous = lower_bound(rail(MotionLimits(effort_rate=60.0), damping=1.0)).T
    assert 0.9 * both < viscous


def farthest(
    T: float, push: float, drag: float, friction: float, limits: tuple[float, ...]
) -> float:
    """Way of a mass from rest to rest in a time, by a linear program of its jerks.

    Args:
        T: The time.
        push: Force per mass at rest; it falls with the speed.
        drag: Viscous friction per mass.
        friction: Dry friction per mass.
        limits: Speed without force, jerk, and rate of the force per mass.
    """
    N, (end, jerk, rate) = 80, limits
    h, rows = T / N, np.eye(N)
    a, v, q = np.zeros((3, N + 1, N))
    for k in range(N):
        a[k + 1] = a[k] + h * rows[k]
        v[k + 1] = v[k] + h * a[k] + 0.5 * h**2 * rows[k]
        q[k + 1] = q[k] + h * v[k] + 0.5 * h**2 * a[k] + h**3 / 6.0 * rows[k]
    force, droop = a + drag * v, push / end * v
    steps = np.diff(force, axis=0)
    upper = np.vstack([force + droop, droop - force, steps, -steps, -v])
    room = [push - friction, push + friction, h * rate, h * rate, 0.0]
    done = linprog(
        -q[-1],
        upper,
        np.repeat(room, [N + 1, N + 1, N, N, N + 1]),
        np.stack([a[-1], v[-1]]),
        np.zeros(2),
        (-jerk, jerk),
    )
    return float(-done.fun)


@pytest.mark.parametrize(
    ("jerk", "rate", "drag", "friction"),
    [(30.0, 1e4, 0.0, 0.0), (30.0, 1e4, 1.5, 0.5), (1e4, 40.0, 1.5, 0.5)],
)
def test_jerks_and_torque_rates_beside_friction_and_curves_are_exact(
    jerk: float, rate: float, drag: float, friction: float
) -> None:
    """They were 0.73 to 0.95 of it: no more than the least of both bounds alone."""
    limits = MotionLimits(
        jerk=jerk,
        effort_rate=MASS * rate,
        effort_curves={"joint1": EffortCurve.droop(FORCE, 1.6)},
    )
    problem = rail(limits, damping=MASS * drag, friction=MASS * friction)
    T, push = lower_bound(problem).T, FORCE / MASS
    rest = push, drag, friction, (1.6, jerk, rate)
    assert farthest(T, *rest) < 1.0 < farthest(1.002 * T, *rest)


def test_friction_helps_to_brake_a_mass_that_hardly_holds_itself() -> None:
    """With 27.8 N for 27.4 N of weight: lifted and falling, beside planned motions."""
    robot = make_arm(
        slide(27.4 / 9.81, (0.0, 1.0, 0.0)),
        effort=27.834,
        gravity=DOWNWARD,
        damping=0.824,
        position_lower=-1e3,
        position_upper=1e3,
    )
    limits = MotionLimits(effort_rate=274.0, jerk=210.0)
    for way, planned in ((1.0, 4.41801), (-1.0, 3.14443)):
        goal = JointGoal(np.array([way]))
        found = lower_bound(Problem(robot, np.zeros(1), goal, motion_limits=limits)).T
        assert 0.95 * planned < found < planned


def test_torque_over_speed_gives_the_time_by_quadrature() -> None:
    droop = EffortCurve.droop(FORCE, 1.4)
    limits = MotionLimits(effort_curves={"joint1": droop})
    push = FORCE / MASS

    def force(v: np.ndarray) -> np.ndarray:
        return np.maximum(push * (1.0 - v / 1.4), 1e-9)

    T = by_peak(force, force, 1.39)
    assert lower_bound(rail(limits)).T == pytest.approx(T, rel=1e-6)
    power = EffortCurve.power(8.0, 6.0, 3.0)
    limits = MotionLimits(effort_curves={"joint1": power}, acceleration=3.5)

    def up(v: np.ndarray) -> np.ndarray:
        return np.minimum(3.5, (power(v)[0] - 0.6 * v - 1.0) / MASS)

    def down(v: np.ndarray) -> np.ndarray:
        return np.minimum(3.5, (power(v)[0] + 0.6 * v + 1.0) / MASS)

    found = lower_bound(rail(limits, friction=1.0, damping=0.6)).T
    assert found == pytest.approx(by_peak(up, down, 2.0), rel=1e-6)


def test_curves_are_about_no_torque_where_limits_are_not() -> None:
    """They end at the no-load speed, whatever the middle of the limits is."""
    robot = make_arm(slide(MASS), effort=np.array([[-3.0, FORCE]]))
    limits = MotionLimits(effort_curves={"joint1": EffortCurve.droop(FORCE, 1.4)})
    problem = Problem(robot, np.zeros(1), JointGoal([1.0]), motion_limits=limits)
    push, brake = FORCE / MASS, 3.0 / MASS

    def up(v: np.ndarray) -> np.ndarray:
        return np.maximum(push * (1.0 - v / 1.4), 1e-9)

    def down(v: np.ndarray) -> np.ndarray:
        return np.minimum(brake, up(v))

    least = by_peak(up, down, 1.39)
    assert lower_bound(problem).T == pytest.approx(least, rel=1e-6)
    solution = plan(problem)
    assert solution.success, solution.message
    assert least <= solution.T * (1.0 + 1e-6) < 1.002 * least


@pytest.mark.parametrize("case", pendulum_cases(), ids=str)
def test_pendulum_that_its_torque_lifts(case: object) -> None:
    found = lower_bound(case.problem()).T  # type: ignore[attr-defined]
    least = 0.98 if "moving" in str(case) else 0.998
    assert least * case.minimum <= found <= case.minimum  # type: ignore[attr-defined]


@pytest.mark.parametrize("case", swing_cases(), ids=str)
def test_pendulum_that_has_to_swing(case: object) -> None:
    found = lower_bound(case.problem()).T  # type: ignore[attr-defined]
    assert 0.9 * case.minimum <= found <= case.minimum  # type: ignore[attr-defined]


def test_bound_that_is_cut_short_is_what_is_known(monkeypatch) -> None:
    def stop() -> None:
        raise Stop(requested=False)

    robot = make_arm(ROD, effort=8.0, gravity=DOWNWARD, velocity=20.0)
    problem = Problem(robot, [-np.pi / 2], JointGoal([np.pi / 2]))
    best = lower_bound(problem).T
    monkeypatch.setattr("tominpmp.bounds.phase_plane.check", stop)
    assert np.pi / 20.0 <= lower_bound(problem).T < best  # what its speed allows


def test_speed_limit_that_is_reached_at_once_makes_no_way_longer() -> None:
    """A light rod past its goal and back, at its speed limit nearly all the time."""
    robot = make_arm(ROD, effort=600.0, gravity=DOWNWARD, velocity=0.86)
    problem = Problem(robot, np.array([0.73]), JointGoal([-0.22], [0.05]))
    assert 0.95 / 0.86 <= lower_bound(problem).T < 0.95 / 0.86 + 3e-3
    straight = Problem(robot, np.array([0.73]), JointGoal([-0.22]))
    assert 0.95 / 0.86 <= lower_bound(straight).T < 0.95 / 0.86 + 2e-3


def test_wall_in_the_way_of_a_swing_makes_it_no_shorter() -> None:
    case = swing_cases()[0]
    free = case.problem()
    wall = free.robot.with_changes(position_lower=-0.5 * math.pi - 0.55)
    found = lower_bound(Problem(wall, free.q_start, free.goal)).T
    assert found >= lower_bound(free).T * (1.0 - 1e-9)


def random_arm(rng: np.random.Generator, heavy: bool) -> OneJoint:
    """Any arm with one joint and limits of any kind, but for jerk and torque rate."""
    effort = -float(rng.uniform(2.0, 9.0)), float(rng.uniform(2.0, 9.0))
    curve = None
    if rng.uniform() < 0.4:
        speeds = np.concatenate([[0.0], np.cumsum(rng.uniform(0.3, 2.0, 2))])
        curve = EffortCurve(speeds, rng.uniform(1.0, 9.0, 3))
    weight = (0.0, 0.0, 0.0)
    if heavy:
        weight = tuple(float(w) for w in rng.normal(size=3) * (0.5, 3.0, 3.0))
    return OneJoint(
        mass=float(rng.uniform(0.3, 2.0)),
        damping=float(rng.choice([0.0, rng.uniform(0.0, 2.0)])),
        friction=float(rng.choice([0.0, rng.uniform(0.0, 1.5)])),
        weight=weight,  # type: ignore[arg-type]
        effort=effort,
        curve=curve,
        position=(-math.inf, math.inf),
        velocity=math.inf,
        acceleration=math.inf,
        jerk=math.inf,
        effort_rate=math.inf,
    )


def pushed(
    arm: OneJoint, q: float, v: float, sign: float, T: float
) -> tuple[float, float, float] | None:
    """Where full torque one way brings it, how fast it is then, and when."""
    constant, cosine, sine = arm.weight

    def rate(_: float, x: np.ndarray) -> list[float]:
        load = constant + cosine * math.cos(x[0]) + sine * math.sin(x[0])
        way = math.copysign(1.0, side)
        load += arm.damping * x[1] + arm.friction * way
        a = (float(arm.torque(np.array(abs(x[1])), sign)) - load) / arm.mass
        return [x[1], a]

    def turn(_: float, x: np.ndarray) -> float:
        return float(x[1]) if abs(x[1]) > 1e-12 or _ > 1e-6 else 1.0

    turn.terminal = True  # type: ignore[attr-defined]
    t = 0.0
    for _ in range(3):
        side = v if v != 0.0 else sign
        if v == 0.0 and rate(0.0, np.array([q, 0.0]))[1] * sign <= 0.0:
            return None
        done = solve_ivp(rate, (0.0, T - t), [q, v], events=turn, rtol=1e-9, atol=1e-11)
        t, q, v = t + done.t[-1], float(done.y[0, -1]), float(done.y[1, -1])
        if done.status == 0:
            return q, v, t
        v = 0.0
    return None


@pytest.mark.parametrize("heavy", [False, True])
def test_no_bang_bang_motion_beats_the_bound(
    heavy: bool, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    shares = []
    for _ in range(30 if heavy else 60):
        arm = random_arm(rng, heavy)
        q = start = float(rng.uniform(-3.0, 3.0))
        v = speed = float(rng.choice([0.0, rng.normal()]))
        sign, total = float(rng.choice([-1.0, 1.0])), 0.0
        for _ in range(int(rng.integers(1, 4))):
            end = pushed(arm, q, v, sign, float(rng.exponential(0.4)))
            if end is None:
                break
            q, v, total, sign = end[0], end[1], total + end[2], -sign
        if total < 1e-2:
            continue
        with monkeypatch.context() as patch:
            patch.setattr(OneJoint, "of", lambda _, arm=arm: arm)
            ends = np.array([start, q]), np.array([speed, v])
            found = single_joint_time(None, *ends, True)  # type: ignore[arg-type]
        assert found is not None
        assert found <= total * (1.0 + 1e-6)
        shares.append(found / total)
    # Many of them are the fastest there are.
    assert np.mean(np.array(shares) > 0.98) > 0.25


def test_swings_know_curves_that_rise_again(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A dip in the torque was filled up by what is higher beyond it: 0.81 of T."""
    arm = replace(
        random_arm(rng, True),
        mass=1.0,
        damping=0.0,
        friction=0.3,
        weight=(0.0, 2.0, 0.0),
        effort=(-9.0, 9.0),
        curve=EffortCurve([0.0, 0.8, 1.6, 3.0], [9.0, 3.5, 8.5, 5.0]),
    )
    first = pushed(arm, -1.0, 0.0, 1.0, 0.5)
    assert first is not None
    last = pushed(arm, *first[:2], -1.0, 0.1)
    assert last is not None
    T = first[2] + last[2]
    monkeypatch.setattr(OneJoint, "of", lambda _: arm)
    ends = np.array([-1.0, last[0]]), np.array([0.0, last[1]])
    found = single_joint_time(None, *ends, True)  # type: ignore[arg-type]
    assert found is not None
    assert 0.99 * T < found < T


def test_arm_that_cannot_hold_itself_has_a_bound_that_holds() -> None:
    robot: Robot = make_arm(ROD, effort=2.0, gravity=DOWNWARD)
    level = Problem(
        robot,
        np.array([-0.5 * math.pi]),
        JointGoal(np.array([0.0]), np.array([1e-9])),
    )
    assert 0.5 < lower_bound(level).T < 10.0
