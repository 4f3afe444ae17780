"""Lower bounds of arms with one joint: the minimum time where gravity is uniform."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from optimum_cases import ROD
from sample_arms import DOWNWARD, GRAVITY, Link, make_arm, slide
from scipy.integrate import solve_ivp, trapezoid
from scipy.optimize import brentq, linprog

from tominpmp.bounds.lower_bound import lower_bound
from tominpmp.exceptions import TominpmpWarning
from tominpmp.goals.joints import JointGoal, JointRegionGoal
from tominpmp.motion_limits import EffortCurve, MotionLimits
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot

MASS, FORCE = 2.0, 10.0
# Moment of inertia of a point mass at the end of a rod.
INERTIA = 1e-6


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


def test_bound_of_each_limit_of_a_rail_matches_the_closed_form() -> None:
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


def test_bounds_of_torque_rate_and_jerk_match_the_closed_form() -> None:
    rate = lower_bound(rail(MotionLimits(effort_rate=60.0), effort=1e6)).T
    assert rate == pytest.approx((32.0 / 30.0) ** (1.0 / 3.0))
    # Force and its rate: 5 m/s^2 after 1/6 s, as for an acceleration limit.
    both = lower_bound(rail(MotionLimits(effort_rate=60.0))).T
    push, jerk = FORCE / MASS, 30.0
    ramp = push / jerk
    plateau = 0.5 * (-3.0 * ramp + math.sqrt(ramp**2 + 4.0 / push))
    assert both == pytest.approx(4 * ramp + 2 * plateau)
    # Dry friction takes longer; viscous friction hardly makes the bound smaller.
    dry = lower_bound(rail(MotionLimits(effort_rate=60.0), friction=2.0)).T
    assert dry > both
    rates = MotionLimits(effort_rate=60.0)
    viscous = lower_bound(rail(rates, damping=1.0, velocity=2.0)).T
    assert 0.95 * both < viscous


def farthest(
    T: float, push: float, drag: float, friction: float, limits: tuple[float, ...]
) -> float:
    """Longest way of a mass from rest to rest in a time, by a linear program of jerks.

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
def test_bound_with_jerk_rate_friction_and_curve_is_near_the_optimum(
    jerk: float, rate: float, drag: float, friction: float
) -> None:
    limits = MotionLimits(
        jerk=jerk,
        effort_rate=MASS * rate,
        effort_curves={"joint1": EffortCurve.droop(FORCE, 1.6)},
    )
    problem = rail(limits, damping=MASS * drag, friction=MASS * friction, velocity=1.6)
    T, push = lower_bound(problem).T, FORCE / MASS
    rest = push, drag, friction, (1.6, jerk, rate)
    assert farthest(T, *rest) < 1.0 < farthest(1.12 * T, *rest)


def test_bound_of_a_mass_near_its_largest_weight_is_near_the_optimum() -> None:
    """27.8 N for 27.4 N of weight, upwards and downwards; friction helps to brake."""
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


def test_bound_with_effort_curves_matches_quadrature() -> None:
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


def test_effort_curves_are_symmetric_beside_asymmetric_limits() -> None:
    """Curves end at the no-load speed, whatever the middle of the limits is."""
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


def test_bound_with_a_speed_limit_reached_at_once_is_tight() -> None:
    """A light rod passes its goal and returns, nearly always at its speed limit."""
    robot = make_arm(ROD, effort=600.0, gravity=DOWNWARD, velocity=0.86)
    problem = Problem(robot, np.array([0.73]), JointGoal([-0.22], [0.05]))
    assert 0.95 / 0.86 <= lower_bound(problem).T < 0.95 / 0.86 + 3e-3
    straight = Problem(robot, np.array([0.73]), JointGoal([-0.22]))
    assert 0.95 / 0.86 <= lower_bound(straight).T < 0.95 / 0.86 + 2e-3


def test_bound_with_a_dip_in_the_effort_curve_matches_quadrature() -> None:
    """The dip in the torque counts, although the torque is larger at higher speeds."""
    curve = EffortCurve([0.0, 0.8, 1.6, 3.0], [9.0, 3.5, 8.5, 5.0])
    problem = rail(MotionLimits(effort_curves={"joint1": curve}), friction=0.6)

    def up(v: np.ndarray) -> np.ndarray:
        return (np.minimum(curve(v)[0], FORCE) - 0.6) / MASS

    def down(v: np.ndarray) -> np.ndarray:
        return (np.minimum(curve(v)[0], FORCE) + 0.6) / MASS

    assert lower_bound(problem).T == pytest.approx(by_peak(up, down, 3.0), rel=1e-6)


def test_bound_includes_the_way_past_the_goal_and_back() -> None:
    """The mass is too fast to stop: 1 m/s^2, at 2 m/s, 0.5 m before the goal."""
    robot = make_arm(slide(1.0), effort=1.0)
    problem = Problem(robot, [0.0], JointGoal([0.5]), v_start=[2.0])
    # The mass stops after 2 s and 2 m, and goes back 1.5 m.
    assert lower_bound(problem).T == pytest.approx(2.0 + 2.0 * math.sqrt(1.5))
    from_rest = Problem(robot, [0.0], JointGoal([0.5], [2.0]))
    assert lower_bound(from_rest).T == pytest.approx(2.0 + 2.0 * math.sqrt(1.5))
    limited = Problem(
        robot.with_changes(effort=1e3),
        [0.0],
        JointGoal([0.5]),
        v_start=[2.0],
        motion_limits=MotionLimits(acceleration=1.0),
    )
    assert lower_bound(limited).T == pytest.approx(2.0 + 2.0 * math.sqrt(1.5))


def test_bound_of_a_joint_range_is_the_time_to_its_edge() -> None:
    robot = make_arm(slide(MASS), effort=FORCE)
    near = JointRegionGoal([1.2], 0.2)
    bound = lower_bound(Problem(robot, [0.0], near))
    assert bound.T == pytest.approx(2.0 * math.sqrt(MASS / FORCE))
    assert bound.joint == "joint1"


# -- against motions under random torques ----------------------------------------------


@dataclass
class Arm:
    """An arm with one joint, as equations written by hand."""

    mass: float
    effort: tuple[float, float]
    damping: float = 0.0
    friction: float = 0.0
    lift: float = 0.0
    pendulum: bool = False
    curve: EffortCurve | None = None
    limits: MotionLimits | None = field(default=None)

    @classmethod
    def random(cls, rng: np.random.Generator, pendulum: bool) -> Arm:
        """Random torques, friction and curve, on an upright rail or of a pendulum."""
        arm = cls(
            mass=float(rng.uniform(0.3, 2.0)),
            effort=(-float(rng.uniform(2.0, 9.0)), float(rng.uniform(2.0, 9.0))),
            damping=float(rng.choice([0.0, rng.uniform(0.0, 2.0)])),
            friction=float(rng.choice([0.0, rng.uniform(0.0, 1.5)])),
            lift=float(rng.choice([0.0, rng.uniform(0.0, 1.0)])),
            pendulum=pendulum,
        )
        if rng.uniform() < 0.4:
            speeds = np.concatenate([[0.0], np.cumsum(rng.uniform(0.3, 2.0, 2))])
            arm.curve = EffortCurve(speeds, rng.uniform(1.0, 9.0, 3))
            arm.limits = MotionLimits(effort_curves={"joint1": arm.curve})
        return arm

    def robot(self) -> Robot:
        """The robot: gravity pulls by the share ``lift`` of 9.81 m/s^2."""
        link = slide(self.mass, (0.0, 1.0, 0.0))
        if self.pendulum:
            link = Link(self.mass, 1.0, 1.0, INERTIA)
        return make_arm(
            link,
            effort=np.array([self.effort]),
            gravity=(0.0, -self.lift * GRAVITY, 0.0),
            damping=self.damping,
            friction=self.friction,
            position_lower=-1e3,
            position_upper=1e3,
        )

    def acceleration(self, q: float, v: float, side: float, sign: float) -> float:
        """Acceleration by full torque of a sign, in motion towards a side."""
        torque = self.effort[1] if sign > 0.0 else self.effort[0]
        if self.curve is not None:
            most = float(self.curve(np.array(abs(v)))[0])
            torque = min(max(torque, -most), most)
        weight = self.mass * self.lift * GRAVITY
        if self.pendulum:
            weight *= math.cos(q)
        dry = math.copysign(self.friction, side)
        inertia = self.mass + (INERTIA if self.pendulum else 0.0)
        return (torque - weight - self.damping * v - dry) / inertia

    def pushed(
        self, q: float, v: float, sign: float, T: float
    ) -> tuple[float, float, float] | None:
        """Position, velocity and time after full torque of a sign for at most T."""
        t = 0.0
        for _ in range(3):
            side = v if v != 0.0 else sign
            if v == 0.0 and self.acceleration(q, 0.0, side, sign) * sign <= 0.0:
                return None

            def rate(_: float, x: np.ndarray, side: float = side) -> list[float]:
                return [x[1], self.acceleration(x[0], x[1], side, sign)]

            def turn(_: float, x: np.ndarray) -> float:
                return float(x[1]) if abs(x[1]) > 1e-12 or _ > 1e-6 else 1.0

            turn.terminal = True  # type: ignore[attr-defined]
            # Longer steps miss dips of a curve.
            longest = math.inf if self.curve is None else 2e-3
            exact = {"rtol": 1e-9, "atol": 1e-11, "max_step": longest}
            done = solve_ivp(rate, (0.0, T - t), [q, v], events=turn, **exact)
            t, q, v = t + done.t[-1], float(done.y[0, -1]), float(done.y[1, -1])
            if done.status == 0:
                return q, v, t
            v = 0.0
        return None


@pytest.mark.parametrize("pendulum", [False, True])
def test_no_bang_bang_motion_beats_the_bound(
    pendulum: bool, rng: np.random.Generator
) -> None:
    shares: list[float] = []
    while len(shares) < 26:  # some arms cannot move, or hardly do
        arm = Arm.random(rng, pendulum)
        q = start = float(rng.uniform(-3.0, 3.0))
        v = speed = float(rng.choice([0.0, rng.normal()]))
        sign, total = float(rng.choice([-1.0, 1.0])), 0.0
        for _ in range(int(rng.integers(1, 4))):
            end = arm.pushed(q, v, sign, float(rng.exponential(0.4)))
            if end is None:
                break
            q, v, total, sign = end[0], end[1], total + end[2], -sign
        if total < 1e-2:
            continue
        # An arm in motion need not hold itself.
        goal = JointGoal([q], [v + 1e-12])
        begin = [speed + 1e-12]
        problem = Problem(
            arm.robot(), [start], goal, v_start=begin, motion_limits=arm.limits
        )
        found = lower_bound(problem).T
        assert found <= total * (1.0 + 1e-6)
        shares.append(found / total)
    # Many of these motions are time-optimal.
    assert np.mean(np.array(shares) > 0.98) > (0.05 if pendulum else 0.3)


def test_speed_that_is_only_approached_counts_as_reached() -> None:
    """Regression: the bound was 37 s, for a motion that ends 2e-9 m/s slower."""
    arm = make_arm(slide(1.0), effort=1.0, damping=1.0)
    T = 20.0  # v = 1 - exp(-t) m/s, and the integral of v
    goal = JointGoal([T - 1.0 + math.exp(-T)], [1.0 - 1e-12])
    problem = Problem(arm.with_changes(position_upper=1e3), [0.0], goal)
    assert lower_bound(problem).T == pytest.approx(T, rel=1e-6)


def test_no_motion_of_random_jerks_beats_the_bound(rng: np.random.Generator) -> None:
    """Limits are the largest acceleration, jerk and speed of the motion itself."""
    robot = make_arm(slide(1.0), effort=1e6, position_lower=-1e3, position_upper=1e3)
    shares = []
    for _ in range(150):
        count = int(rng.integers(1, 5))
        jerk = rng.choice([rng.uniform(-1.0, 1.0), -1.0, 0.0, 1.0], count)
        times = rng.exponential(0.5, count)
        most = max(float(np.max(np.abs(jerk))), 0.1)
        left = float(np.sum(jerk * times))
        # The acceleration is zero at both ends.
        jerk = np.append(jerk, -math.copysign(most, left))
        times = np.append(times, abs(left) / most)
        v = begin = float(rng.choice([0.0, rng.normal()]))
        q = a = peak = 0.0
        top = abs(v)
        for j, t in zip(jerk.tolist(), times.tolist(), strict=True):
            turn = -a / j if j != 0.0 and 0.0 < -a / j < t else t
            top = max(top, abs(v + (a + 0.5 * j * turn) * turn))
            q += (v + (0.5 * a + j * t / 6.0) * t) * t
            v += (a + 0.5 * j * t) * t
            a += j * t
            top, peak = max(top, abs(v)), max(peak, abs(a))
        T = float(np.sum(times))
        if T < 1e-2 or peak < 1e-6:
            continue
        problem = Problem(
            robot.with_changes(velocity=top * (1.0 + 1e-9)),
            [0.0],
            JointGoal([q], [v]),
            v_start=[begin],
            motion_limits=MotionLimits(acceleration=peak * (1.0 + 1e-9), jerk=most),
        )
        found = lower_bound(problem).T
        assert found <= T * (1.0 + 1e-6)
        shares.append(found / T)
    assert len(shares) > 100
    assert np.mean(np.array(shares) > 0.98) > 0.3


def test_bound_of_an_arm_too_weak_for_its_weight_is_finite() -> None:
    robot: Robot = make_arm(ROD, effort=2.0, gravity=DOWNWARD)
    level = Problem(
        robot,
        np.array([-0.5 * math.pi]),
        JointGoal(np.array([0.0]), np.array([1e-9])),
    )
    assert 0.3 < lower_bound(level).T < 10.0


@pytest.mark.parametrize("way", [0.5, 1e-9, 1e-100])
def test_no_bound_of_millions_of_years_for_an_arm_that_cannot_move(way: float) -> None:
    with pytest.warns(TominpmpWarning, match="its dry friction of 2"):
        robot = make_arm(slide(1.0), effort=1.0, friction=2.0, armature=0.1)
    assert lower_bound(Problem(robot, [0.0], JointGoal([way]))).T < 1.0
    pair = make_arm(slide(1.0), slide(1.0), effort=1.0, armature=0.1)
    assert lower_bound(Problem(pair, [0.0, 0.0], JointGoal([way, 0.0]))).T < 1.0
