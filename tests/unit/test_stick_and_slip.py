"""Replay of joints that dry friction holds, releases and stops, and the verdicts.

The motions are constructed, so that their limits are known exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from replays import replay
from sample_arms import DOWNWARD, GRAVITY, Link, make_arm, rod, slide

import tominpmp as tm
from tominpmp.arrays import Array
from tominpmp.dynamics import RobotDynamics

INTEGRATORS = ("LSODA", "DOP853", "Radau")
MASS, FRICTION = 2.0, 3.0
# Inertia of a wrist that its friction stops at 7000 rad/s^2 [kg m^2].
LIGHT = 1.4e-4
START = np.array([-1.2, 0.4, 0.3])
# Displacements of the joints [rad]; some joints do not move at all.
DISPLACEMENTS = {
    "all": [0.5, -0.3, 1.1],
    "one rests": [0.5, 0.0, 1.1],
    "wrist": [0.0, 0.0, 1.0],
}


def wrist_arm(friction: float = 1.0) -> tm.Robot:
    """Two links that hang and a light wrist, all with dry friction."""
    return make_arm(
        rod(2.0, 0.5),
        rod(1.0, 0.4),
        Link(0.02, inertia=LIGHT),
        effort=[60.0, 25.0, 10.0],
        gravity=DOWNWARD,
        friction=friction,
    )


@dataclass
class Case:
    """A motion of several segments with the smallest limits that it satisfies."""

    problem: tm.Problem
    motion: tm.Trajectory

    def verdict(self, **shares: float) -> tm.Verification:
        """The verdict with limits that are the given shares of these limits."""
        limits = {
            kind: share * getattr(self.problem.motion_limits, kind)
            for kind, share in shares.items()
        }
        problem = tm.Problem(
            self.problem.robot,
            self.problem.q_start,
            segments=self.problem.segments,
            motion_limits=tm.MotionLimits(**limits) if limits else None,
        )
        return tm.verify(problem, self.motion)


def there_and_back(
    robot: tm.Robot, way: list[float], *, soft: bool = False, **stay: object
) -> Case:
    """Move to a configuration in 0.4 s, dwell there, and move back."""
    # Accelerations of 1 and -1, or jerks of 1, -1, -1 and 1, for equal times.
    legs = 4 if soft else 2
    h = 0.4 / legs
    if soft:
        v = h * h * np.array([0.0, 0.5, 1.0, 0.5, 0.0])
        s = h**3 * np.array([0.0, 1 / 6, 1.0, 11 / 6, 2.0])
    else:
        v, s = h * np.array([0.0, 1.0, 0.0]), h * h * np.array([0.0, 0.5, 1.0])
    peak = (h if soft else 1.0) / s[-1]
    v, s = v / s[-1], s / s[-1]
    dwell = float(stay.get("dwell", 0.0))  # type: ignore[arg-type]
    t = h * np.arange(legs + 1.0)
    times = [t, 0.4 + dwell + t[0 if dwell else 1 :]]
    places = [s, 1.0 - s[0 if dwell else 1 :]]
    speeds = [v, -v[0 if dwell else 1 :]]
    t, q, v = (np.concatenate(x) for x in (times, places, speeds))
    d = np.array(way)
    q, v = START + q[:, None] * d, v[:, None] * d
    a = None if soft else np.diff(v, axis=0) / np.diff(t)[:, None]
    dynamics = RobotDynamics(robot).inverse
    ends = np.array([0.4 + dwell, t[-1]])
    draft = tm.Trajectory(robot.joint_names, t, q, v, 0.0 * q, a, segment_ends=ends)
    motion = draft.with_torques(dynamics, (dynamics, dynamics))
    jerk = peak / h * np.abs(d) if soft else np.full(3, np.inf)
    limits = tm.MotionLimits(
        acceleration=np.maximum(peak * np.abs(d), 1e-3),
        jerk=np.maximum(jerk, 1e-3),
        effort_rate=1e3,
    )
    goal = tm.JointGoal(q[legs], np.zeros(3))
    segments = [tm.Segment(goal, **stay), tm.Segment(tm.JointGoal(START))]  # type: ignore[arg-type]
    problem = tm.Problem(robot, START, segments=segments, motion_limits=limits)
    return Case(problem, motion)


def violated(found: tm.Verification) -> set[str]:
    """The kinds of the violations."""
    return {item.kind for item in found.violations}


STAYS = {"dwell": {"dwell": 0.1}, "short": {"dwell": 0.003}, "stop": {"stop": True}}


@pytest.mark.parametrize(
    ("stay", "way", "friction"),
    [
        ("dwell", "all", 1.0),
        ("dwell", "one rests", 6.0),
        ("dwell", "wrist", 0.05),
        ("short", "all", 0.05),
        ("stop", "one rests", 0.05),
        ("stop", "wrist", 1.0),
    ],
)
def test_replay_through_a_dwell_keeps_acceleration_limits(
    stay: str, way: str, friction: float
) -> None:
    case = there_and_back(wrist_arm(friction), DISPLACEMENTS[way], **STAYS[stay])
    found = case.verdict(acceleration=1.0)
    assert found.ok, found.message
    assert found.worst["acceleration"].share < 1e-5
    assert found.feedback is None
    lower = case.verdict(acceleration=0.99)
    assert violated(lower) == {"acceleration"}
    assert lower.worst["acceleration"].share == pytest.approx(1 / 0.99 - 1, rel=1e-2)


@pytest.mark.parametrize(
    ("stay", "way"), [("dwell", "all"), ("short", "wrist"), ("stop", "one rests")]
)
def test_replay_through_a_dwell_keeps_jerk_limits(stay: str, way: str) -> None:
    case = there_and_back(wrist_arm(), DISPLACEMENTS[way], soft=True, **STAYS[stay])
    found = case.verdict(acceleration=1.0, jerk=1.0, effort_rate=1.0)
    assert found.ok, found.message
    assert found.worst["jerk"].share < 1e-3
    lower = case.verdict(acceleration=0.99, jerk=0.99)
    assert violated(lower) == {"acceleration", "jerk"}


def test_replay_with_another_friction_or_payload_misses_the_goal() -> None:
    robot = wrist_arm()
    case = there_and_back(robot, DISPLACEMENTS["all"], dwell=0.1)
    others = {
        "more": robot.with_changes(friction=1.2),
        "less": robot.with_changes(friction=0.8),
        "none": robot.with_changes(friction=0.0),
        "load": robot.with_payload(tm.Payload(0.5, "tip")),
    }
    for name, other in others.items():
        found = tm.verify(
            tm.Problem(other, START, segments=case.problem.segments), case.motion
        )
        assert not found.ok, name
        assert "goal" in violated(found), name


@pytest.mark.parametrize("dt", [0.001, 0.004])
def test_samples_of_a_motion_with_a_dwell_are_verified(dt: float) -> None:
    case = there_and_back(wrist_arm(), DISPLACEMENTS["all"], dwell=0.1)
    case.motion = case.motion.sample(dt)  # type: ignore[assignment]
    found = case.verdict(acceleration=1.001)
    assert found.ok, found.message


def test_plan_with_a_dwell_and_acceleration_limits_is_verified() -> None:
    segments = [
        tm.Segment(tm.JointGoal(START + DISPLACEMENTS["all"]), dwell=0.1),
        tm.Segment(tm.JointGoal(START)),
    ]
    problem = tm.Problem(
        wrist_arm(),
        START,
        segments=segments,
        motion_limits=tm.MotionLimits(acceleration=10.0),
    )
    solution = tm.plan(problem, effort="quick")
    assert solution.success, solution.message
    found = solution.verification
    assert found is not None
    assert found.worst["acceleration"].share < 1e-3
    replayed, rest = found.replay, np.all(found.replay.v == 0.0, axis=1)
    assert np.ptp(replayed.t[1:-1][rest[1:-1]]) == pytest.approx(0.1, abs=2e-3)


def test_deceleration_by_friction_counts_as_acceleration() -> None:
    """The motor torque of a wrist ends, and its friction stops it within 50
    microseconds.
    """
    robot = make_arm(Link(0.02, inertia=LIGHT), effort=5.0, friction=1.0)
    t, push = np.array([0.0, 0.1, 0.2]), 3.5
    u = np.array([[1.0 + LIGHT * push], [0.0], [0.0]])
    zero = np.zeros((3, 1))
    motion = tm.Trajectory(robot.joint_names, t, zero, zero, u)
    way = 0.5 * push * 0.1**2
    problem = tm.Problem(
        robot,
        [0.0],
        tm.JointGoal([way]),
        motion_limits=tm.MotionLimits(acceleration=10.0),
    )
    found = tm.verify(problem, motion)
    assert found.goal_error < 1e-4 and found.speed_error == 0.0
    assert violated(found) == {"acceleration"}
    expected = 1.0 / LIGHT - 10.0
    assert found.worst["acceleration"].amount == pytest.approx(expected, rel=1e-6)


def test_torque_jump_of_a_joint_held_by_friction_is_a_violation() -> None:
    robot = make_arm(slide(MASS), effort=10.0, friction=FRICTION)
    t = np.array([0.0, 0.1, 0.2])
    zero, u = np.zeros((3, 1)), np.array([[0.0], [0.8 * FRICTION], [0.8 * FRICTION]])
    motion = tm.Trajectory(robot.joint_names, t, zero, zero, u)
    limits = tm.MotionLimits(effort_rate=100.0)
    problem = tm.Problem(robot, [0.0], tm.JointGoal([0.0]), motion_limits=limits)
    found = tm.verify(problem, motion)
    assert violated(found) == {"effort rate"}
    jump = 0.8 * FRICTION / 1e-3
    assert found.worst["effort rate"].amount == pytest.approx(jump - 100.0)


# -- the law of dry friction -----------------------------------------------------------


def replayed_torques(
    robot: tm.Robot, u: list[float], T: float, integrator: str, **start: list[float]
) -> Array:
    """Replay of constant torques: columns of t, q and v."""
    n = robot.n
    zero, given = np.zeros((2, n)), np.tile(np.array(u), (2, 1))
    motion = tm.Trajectory(robot.joint_names, [0.0, T], zero, zero, given)  # type: ignore[arg-type]
    q, v = start.get("q", [0.0] * n), start.get("v", [0.0] * n)
    problem = tm.Problem(robot, q, tm.JointGoal(q), v_start=v)
    found = replay(problem, motion, integrator=integrator)  # type: ignore[arg-type]
    assert found.complete
    return np.column_stack([found.t, found.q, found.v])


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_mass_stopped_by_friction_stays_at_rest(integrator: str) -> None:
    robot = make_arm(slide(MASS), effort=10.0, friction=FRICTION)
    t, q, v = replayed_torques(robot, [0.0], 1.0, integrator, v=[0.6]).T
    slow = FRICTION / MASS
    stop = 0.6 / slow
    moving = np.minimum(t, stop)
    np.testing.assert_allclose(
        q, 0.6 * moving - 0.5 * slow * moving**2, rtol=0, atol=1e-9
    )
    assert np.all(v[t > stop + 1e-9] == 0.0)
    assert np.ptp(q[t > stop + 1e-9]) == 0.0


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_replay_completes_if_a_joint_stops_within_rounding_of_the_end(
    integrator: str,
) -> None:
    """Regression: no solver can step over so short a rest, and the replays did not
    reach the end.
    """
    robot = make_arm(Link(0.02, inertia=LIGHT), effort=20.0, friction=1.0)
    stop = 1.6 * LIGHT / 21.0
    u, zero = np.array([[1.0], [-20.0], [-20.0]]), np.zeros((3, 1))
    problem = tm.Problem(robot, [0.0], tm.JointGoal([0.0]), v_start=[1.6])
    for spacings in range(-5, 50):
        end = 1.0 + stop + spacings * np.spacing(1.0)
        motion = tm.Trajectory(robot.joint_names, [0.0, 1.0, end], zero, zero, u)  # type: ignore[arg-type]
        assert replay(problem, motion, integrator=integrator).complete  # type: ignore[arg-type]


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_mass_reverses_if_friction_cannot_hold_it(integrator: str) -> None:
    robot = make_arm(slide(MASS), effort=10.0, friction=FRICTION)
    t, q, v = replayed_torques(robot, [-5.0], 1.0, integrator, v=[1.0]).T
    down, back = (5.0 + FRICTION) / MASS, (5.0 - FRICTION) / MASS
    turn = 1.0 / down
    late = np.maximum(t - turn, 0.0)
    np.testing.assert_allclose(
        v, 1.0 - down * np.minimum(t, turn) - back * late, rtol=0, atol=1e-9
    )
    end = 0.5 * turn - 0.5 * back * (1.0 - turn) ** 2
    assert q[-1] == pytest.approx(end, abs=1e-9)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_loaded_joint_held_by_friction_does_not_creep(integrator: str) -> None:
    robot = make_arm(rod(1.0, 0.5), effort=9.0, gravity=DOWNWARD, friction=3.0)
    found = replayed_torques(robot, [0.0], 20.0, integrator, q=[0.2])
    assert 0.25 * GRAVITY * np.cos(0.2) < 3.0
    assert np.all(found[:, 1] == 0.2) and np.all(found[:, 2] == 0.0)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_joint_is_released_when_coupling_torques_exceed_its_friction(
    integrator: str,
) -> None:
    """The falling forearm releases the upper arm, which was held until then."""
    robot = make_arm(
        rod(1.0, 0.5),
        rod(1.0, 0.5),
        effort=12.0,
        gravity=DOWNWARD,
        friction=[5.5, 0.3],
    )
    t, first, second, v1, v2 = replayed_torques(
        robot, [2.0, 0.0], 1.2, integrator, q=[0.0, -1.2]
    ).T
    dynamics = RobotDynamics(robot, dry=False)
    held = v1 == 0.0
    assert held[10] and not held.all() and np.any(v2 < 0.0)
    # While the joint is held, the holding torque is within its friction.
    state = np.column_stack([first, second]), np.column_stack([v1, v2])
    a = np.gradient(v2, t)
    a = np.column_stack([np.zeros_like(a), a])
    needed = 2.0 - dynamics.inverse(*state, a)[:, 0]
    inner = held & np.roll(held, 1) & np.roll(held, -1)
    inner[[0, -1]] = False
    assert np.all(np.abs(needed[inner]) < 5.5 * (1.0 + 1e-3))
    released = int(np.flatnonzero(~held)[0])
    assert np.abs(needed[released - 2]) > 5.4
    assert np.all(first[:released] == 0.0)


@pytest.mark.parametrize("friction", [[1.0, 4.0], [8.0, 0.5], [0.3, 0.2]])
def test_joints_at_rest_satisfy_the_law_of_dry_friction(friction: list[float]) -> None:
    """A joint is either held by at most its friction, or moves against all of it."""
    robot = make_arm(rod(2.0, 1.0), rod(1.0, 0.8), effort=20.0, friction=friction)
    dynamics = RobotDynamics(robot, dry=False)
    rng = np.random.default_rng(3)
    for _ in range(20):
        u, q, T = rng.uniform(-9.0, 9.0, 2), rng.uniform(-2.0, 2.0, 2), 1e-4
        end = replayed_torques(robot, u.tolist(), T, "LSODA", q=q.tolist())[-1]
        a = end[3:] / T
        rest = u - dynamics.inverse(q[None], np.zeros((1, 2)), a[None])[0]
        for i, limit in enumerate(friction):
            if end[3 + i] == 0.0:
                assert abs(rest[i]) <= limit + 1e-3
            else:
                assert rest[i] == pytest.approx(np.sign(a[i]) * limit, abs=1e-2)
