"""The replay of torques, and the verification of its result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from optimum_cases import FORCE, HANGING, MASS, PUSH, ROD, UPRIGHT
from replays import replay
from sample_arms import DOWNWARD, GRAVITY, make_arm, slide
from two_link_cases import RODS

from tominpmp.bounds.lower_bound import lower_bound
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError
from tominpmp.goals.frames import PositionGoal
from tominpmp.goals.joints import JointGoal, JointRegionGoal
from tominpmp.goals.sets import AnyGoal
from tominpmp.kinematics import FrameMotions, RobotKinematics
from tominpmp.motion.joining import checked_motion
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import EffortCurve, MotionLimits
from tominpmp.options import Options, Tolerances
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import Segment
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.obstacles import Sphere
from tominpmp.scene.scene import Scene
from tominpmp.verification.limit_violations import limit_violations
from tominpmp.verification.plant import Plant
from tominpmp.verification.polynomials import Pieces
from tominpmp.verification.replay import planned, torque_pieces
from tominpmp.verification.verification import verify

RAIL_TIME = 2.0 / np.sqrt(PUSH)


def rail_motion(force: float = FORCE, nodes: int = 9) -> Trajectory:
    """Full force, first forwards and then backwards, over 1 m from rest to rest."""
    push = force / MASS
    T = 2.0 / np.sqrt(push)
    t = np.linspace(0.0, T, nodes)
    left = T - t
    first = t <= 0.5 * T
    q = np.where(first, 0.5 * push * t**2, 1.0 - 0.5 * push * left**2)
    v = np.where(first, push * t, push * left)
    u = np.where(t < 0.5 * T - 1e-9, force, -force)
    return Trajectory(("joint1",), t, q[:, None], v[:, None], u[:, None])


def rail_problem(**changes: object) -> Problem:
    """One metre on a rail."""
    robot = make_arm(slide(MASS), effort=FORCE, **changes)
    return Problem(robot, np.zeros(1), JointGoal(np.ones(1)))


def swing(robot: Robot, duration: float, intervals: int = 20) -> Trajectory:
    """A smooth motion of any arm, of constant accelerations."""
    n = robot.n
    t = np.linspace(0.0, duration, intervals + 1)
    phase = 2.0 * np.pi * t[:-1, None] / duration + np.arange(n)
    a = 3.0 * np.cos(phase)
    h = np.diff(t)[:, None]
    v = np.concatenate([np.zeros((1, n)), np.cumsum(h * a, axis=0)])
    q = np.cumsum(h * (v[:-1] + 0.5 * h * a), axis=0)
    q = np.concatenate([np.zeros((1, n)), q])
    dynamics = RobotDynamics(robot)
    u = dynamics.inverse(q, v, np.concatenate([a, a[-1:]]))
    return Trajectory(robot.joint_names, t, q, v, u, a, dynamics.inverse)


def swing_problem(robot: Robot, motion: Trajectory) -> Problem:
    """The problem that a smooth motion solves."""
    goal = JointGoal(motion.q[-1], motion.v[-1])
    return Problem(robot, motion.q[0], goal, v_start=motion.v[0])


# -- replay ----------------------------------------------------------------------------


def test_replay_of_full_force_matches_the_closed_form() -> None:
    found = replay(rail_problem(), rail_motion())
    early = found.t < 0.5 * RAIL_TIME
    assert found.complete
    assert np.max(np.diff(found.t)) <= 1e-3 + 1e-12
    expected = 0.5 * PUSH * found.t[early] ** 2
    np.testing.assert_allclose(found.q[early, 0], expected, atol=1e-12)
    np.testing.assert_allclose(found.q[-1], 1.0, atol=1e-11)
    np.testing.assert_allclose(found.v[-1], 0.0, atol=1e-11)
    assert np.all(np.isin(rail_motion().t, found.t))


@pytest.mark.parametrize("integrator", ["DOP853", "LSODA", "Radau"])
def test_replay_of_a_free_pendulum_conserves_energy(integrator: str) -> None:
    robot = make_arm(ROD, effort=1.0, gravity=DOWNWARD)
    t = np.linspace(0.0, 2.0, 5)
    rest = np.zeros((5, 1))
    motion = Trajectory(robot.joint_names, t, rest, rest, rest)
    problem = Problem(robot, np.zeros(1), JointGoal(np.full(1, HANGING)))
    found = replay(problem, motion, integrator=integrator)
    energy = found.v[:, 0] ** 2 / 6.0 + 0.5 * GRAVITY * np.sin(found.q[:, 0])
    assert found.integrator == integrator
    assert np.ptp(found.q) > 2.0  # it swings
    np.testing.assert_allclose(energy, 0.0, atol=2e-7)


def test_replay_with_stiff_damping_needs_few_evaluations() -> None:
    stiff = make_arm(slide(MASS), effort=FORCE, damping=2e4)
    goal = JointGoal(np.ones(1))
    motion = rail_motion()
    found = replay(Problem(stiff, np.zeros(1), goal), motion)
    assert found.evaluations < 5000
    # The carriage moves forwards and backwards at its terminal speed.
    half = np.searchsorted(found.t, motion.t[4])
    np.testing.assert_allclose(found.q[half, 0], 5e-4 * RAIL_TIME / 2, rtol=1e-3)
    assert abs(found.q[-1, 0]) < 1e-6


@pytest.mark.parametrize("integrator", ["DOP853", "LSODA", "Radau"])
def test_replay_of_inverse_dynamics_follows_the_spline(integrator: str) -> None:
    robot = make_arm(*RODS, effort=100.0, gravity=DOWNWARD, damping=1.0)
    motion = swing(robot, 1.5)
    found = replay(swing_problem(robot, motion), motion, integrator=integrator)
    np.testing.assert_allclose(found.q, motion(found.t).q, atol=1e-6)


def test_jacobian_for_implicit_integrators_matches_the_dynamics() -> None:
    robot = make_arm(
        *RODS, effort=100.0, gravity=DOWNWARD, damping=np.array([2.0, 7.0])
    )
    plant = Plant(robot)
    torque = np.array([[3.0, 1.0], [-2.0, 4.0]])
    plant.load(1.0, 3.0, torque)
    x = np.array([0.3, -0.8, 1.5, 2.5])
    u = torque @ np.array([1.0, -0.5])  # at a quarter of the piece
    f = RobotDynamics(robot).forward_jacobians(x[None], u[None])
    np.testing.assert_allclose(plant.slope(1.5, x), f.f[0], rtol=1e-12)
    np.testing.assert_allclose(plant.jacobian(1.5, x), f.f_x[0], atol=1e-11)


def test_replay_that_diverges_ends_early_and_is_reported() -> None:
    problem = rail_problem()
    motion = rail_motion()
    wild = replace(motion, u=1e9 * motion.u)
    found = replay(problem, wild)
    assert not found.complete
    assert np.all(np.isfinite(found.q))
    verdict = verify(problem, wild)
    assert not verdict.ok
    assert verdict.goal_error == np.inf
    lost = f"the integration fails at {verdict.replay.duration:.3f} s"
    assert f"{lost}, before joint joint1 is at the goal; " in verdict.message
    assert "inf" not in verdict.message


def test_piecewise_polynomials_follow_a_curve() -> None:
    t = np.array([0.0, 0.4, 1.5])
    curve = Pieces.of(lambda x: np.column_stack([np.sin(9 * x), x**3 - x]), t)
    assert curve.count > 2  # halved, as one polynomial cannot follow the sine
    some = np.linspace(0.0, 1.5, 41)
    expected = np.column_stack([np.sin(9 * some), some**3 - some])
    np.testing.assert_allclose(curve(some), expected, atol=1e-9)


# -- verification ----------------------------------------------------------------------


def test_motion_within_all_limits_is_verified() -> None:
    found = verify(rail_problem(), rail_motion())
    assert found.ok and found.complete and found.violations == ()
    assert found.goal_error < 1e-10 and found.speed_error < 1e-10
    assert found.worst["effort"].amount == pytest.approx(0.0, abs=1e-9)
    assert found.defect is None
    assert found.min_clearance == np.inf
    assert "reaches the goal" in found.message


def test_defect_of_an_interval_whose_integration_fails_is_infinite() -> None:
    # Regression: it was the distance at the last row before the integration failed.
    none = np.zeros((2, 1))
    push = np.full((2, 1), 1e9)  # the speed of failure is exceeded half-way
    motion = Trajectory(("joint1",), np.array([0.0, 0.01]), none, none, push)
    found = verify(rail_problem(), motion)
    assert not found.complete and found.replay.t.size > 2
    assert found.defect == np.inf


def test_velocity_limit_is_checked_between_the_nodes() -> None:
    # Three nodes at rest hide the top speed; the torques do not.
    motion = rail_motion(nodes=3)
    hidden = replace(motion, v=np.zeros((3, 1)))
    found = verify(rail_problem(velocity=1.0), hidden)
    (violation,) = found.violations
    assert not found.ok
    assert (violation.kind, violation.name) == ("velocity", "joint1")
    assert violation.time == pytest.approx(0.5 * RAIL_TIME)
    assert violation.amount == pytest.approx(np.sqrt(PUSH) - 1.0)
    assert violation.share == pytest.approx(np.sqrt(PUSH) - 1.0)
    assert "beyond its velocity limit" in found.message


def test_motions_below_a_millisecond_are_checked_between_nodes() -> None:
    """Regression: of a motion of less than a millisecond, only the nodes were
    checked.
    """
    t, zero = np.array([0.0, 4e-4]), np.zeros((2, 1))
    effort = 6.0 * MASS / t[1] ** 2
    robot = make_arm(slide(MASS), effort=effort, velocity=1.0 / t[1])
    problem = Problem(robot, np.zeros(1), JointGoal(np.ones(1)))
    inverse = RobotDynamics(robot).inverse
    q, u = np.array([[0.0], [1.0]]), np.array([[effort], [-effort]])
    motion = Trajectory(("joint1",), t, q, zero, u, inverse_dynamics=inverse)
    (violation,) = verify(problem, motion).violations
    assert violation.kind == "velocity"
    assert violation.share == pytest.approx(0.5, rel=1e-3)


def test_acceleration_jumps_within_a_millisecond_violate_jerk() -> None:
    """Regression: a motion of 1 ms was accepted, though its limit of jerk requires 1.47
    ms.
    """
    force = 4e6 * MASS
    robot = make_arm(slide(MASS), effort=force, velocity=1e4)
    limits = MotionLimits(jerk=1e10)
    problem = Problem(robot, [0.0], JointGoal([1.0]), motion_limits=limits)
    motion = rail_motion(force)
    assert motion.duration < 0.7 * lower_bound(problem).T
    assert {item.kind for item in verify(problem, motion).violations} == {"jerk"}


def test_effort_limit_is_checked_on_both_sides_of_a_jump() -> None:
    # The force rises along the interval and is too large at its end alone.
    def force(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        return np.where(v > 0.0, 12.0 * v, -1.0)

    motion = rail_motion()
    ramp = replace(
        motion,
        t=np.array([0.0, 1.0, 2.0]),
        q=np.zeros((3, 1)),
        v=np.array([[0.0], [1.0], [0.0]]),
        u=np.array([[0.0], [-1.0], [-1.0]]),
        a=np.array([[1.0], [-1e-9]]),
        inverse_dynamics=force,
    )
    found = verify(rail_problem(), ramp)
    effort = found.worst["effort"]
    assert effort.violated
    assert effort.time == pytest.approx(1.0)
    assert effort.amount == pytest.approx(2.0, rel=1e-6)
    assert effort.share == pytest.approx(0.2, rel=1e-6)


def test_position_violation_has_its_joint_and_time() -> None:
    upper, lower = np.array([9.0, 0.01]), np.array([-9.0, -0.5])
    limits = {"position_upper": upper, "position_lower": lower}
    robot = make_arm(*RODS, effort=100.0, **limits)
    motion = swing(robot, 1.0)
    top = int(np.argmax(motion.q[:, 1]))
    start = Problem(robot, motion.q[0], JointGoal(np.zeros(2)))
    found = verify(start, motion)
    position = found.worst["position"]
    assert position.violated and position.name == "joint2"
    assert position.time == pytest.approx(motion.t[top], abs=0.06)
    assert position.amount == pytest.approx(np.max(motion.q[:, 1]) - 0.01, abs=1e-3)


def test_replay_begins_at_the_start_of_the_problem() -> None:
    problem = rail_problem()
    apart = replace(problem, q_start=np.array([-0.01]))
    found = verify(apart, rail_motion())
    assert not found.ok
    assert found.goal_error == pytest.approx(0.01)
    assert found.violations[0].kind == "goal"
    assert verify(apart, rail_motion(), Tolerances(goal=0.02)).ok


def test_motion_that_begins_elsewhere_fails_with_the_right_torques() -> None:
    """Regression: the same torques move a rail by a metre, wherever it stands."""
    motion = rail_motion()
    shifted = replace(motion, q=motion.q + 0.3)
    found = verify(rail_problem(), shifted)
    assert found.goal_error < 1e-10 and not found.ok
    message = "joint joint1 begins 0.3 m from the start of the problem."
    assert found.message == message and found.violations[0].kind == "start"
    assert verify(rail_problem(), replace(motion, q=motion.q + 5e-4)).ok


def test_whole_turns_of_a_continuous_joint_are_the_same_start() -> None:
    free = {"position_lower": -np.inf, "position_upper": np.inf}
    robot = make_arm(RODS[0], effort=100.0, gravity=np.zeros(3), **free)
    motion = swing(robot, 1.0)
    problem = swing_problem(robot, motion)
    assert verify(problem, replace(motion, q=motion.q - 4.0 * np.pi)).ok
    assert not verify(problem, replace(motion, q=motion.q + np.pi)).ok


def test_final_velocity_of_the_goal_is_checked() -> None:
    problem = replace(rail_problem(), goal=JointGoal(np.ones(1), np.full(1, 0.5)))
    found = verify(problem, rail_motion())
    assert [item.kind for item in found.violations] == ["speed"]
    assert found.speed_error == pytest.approx(0.5)


def standing(distance: float) -> tuple[Problem, Trajectory]:
    """A rod that stands still for 8 s at this distance from upright, without torque."""
    robot = make_arm(ROD, effort=5.0, gravity=DOWNWARD)
    t = np.linspace(0.0, 8.0, 161)
    q = np.full((161, 1), UPRIGHT - distance)
    rest = np.zeros((161, 1))
    motion = Trajectory(robot.joint_names, t, q, rest, rest)
    return Problem(robot, q[0], JointGoal(q[0])), motion


def test_unstable_motion_is_verified_with_little_feedback() -> None:
    problem, motion = standing(1e-9)
    found = verify(problem, motion)
    # A rod 1 m long falls at the rate (3 g / 2 l)^(1/2).
    falling = np.sqrt(1.5 * 9.81)
    assert np.log(found.growth) == pytest.approx(8.0 * falling, rel=0.05)
    assert found.ok, found.message
    assert found.feedback is not None
    assert 0.0 < found.feedback[0] < 1e-7
    assert "unstable" in found.message


def test_feedback_beyond_its_limit_is_a_violation() -> None:
    problem, motion = standing(0.05)
    found = verify(problem, motion)
    assert not found.ok
    assert "feedback" in [item.kind for item in found.violations]
    weight = 0.5 * 9.81
    assert found.feedback is not None
    assert found.feedback[0] == pytest.approx(weight * np.sin(0.05), rel=0.25)


def test_stable_motion_is_replayed_without_feedback() -> None:
    found = verify(rail_problem(), rail_motion())
    assert found.ok
    assert found.feedback is None
    assert found.growth < 100.0


def test_goal_error_of_a_frame_goal_is_measured_at_the_frame() -> None:
    robot = make_arm(*RODS, effort=100.0)
    motion = swing(robot, 1.0)
    tip = RobotKinematics(robot).placement(motion.q[-1], "tip").translation
    v = FrameMotions(robot, "tip").velocities(motion.q[-1:], motion.v[-1:])[0]
    reached = Problem(robot, motion.q[0], PositionGoal("tip", tip, v))
    assert verify(reached, motion).ok
    beside = PositionGoal("tip", tip - np.array([0.0, 0.02, 0.0]), v)
    found = verify(replace(reached, goal=beside), motion)
    assert found.goal_error == pytest.approx(0.02)
    assert found.violations[0].name == "frame tip"
    assert found.violations[0].unit == "m"


def test_any_alternative_goal_within_its_range_is_accepted() -> None:
    robot = make_arm(*RODS, effort=100.0)
    motion = swing(robot, 1.0)
    end = motion.q[-1]
    stop = Tolerances(speed=100.0)
    outside = JointRegionGoal(end[1:] + 0.3, 0.1, joints=["joint2"])
    found = verify(Problem(robot, motion.q[0], outside), motion, stop)
    assert found.violations[0].name == "joint joint2"
    assert found.goal_error == pytest.approx(0.2)
    inside = replace(outside, tolerance=0.301)
    either = AnyGoal([outside, inside])
    assert verify(Problem(robot, motion.q[0], either), motion, stop).ok


def test_collision_has_its_pair_time_and_depth(planar3r: Robot) -> None:
    t = np.linspace(0.0, 1.0, 11)
    q = np.zeros((11, 3))
    q[:, 0] = 0.2 + 1.6 * t**2 * (3.0 - 2.0 * t)
    v = np.zeros((11, 3))
    v[:, 0] = 9.6 * t * (1.0 - t)
    inverse = RobotDynamics(planar3r).inverse
    draft = Trajectory(planar3r.joint_names, t, q, v, 0.0 * q)
    u = inverse(q, v, draft(t).a)
    motion = replace(draft, u=u, inverse_dynamics=inverse)
    at = np.array([5.0 * np.cos(1.0), 5.0 * np.sin(1.0), 0.0])
    scene = Scene([Sphere("post", radius=0.1, position=at)])
    problem = Problem(planar3r, q[0], JointGoal(q[-1]), scene=scene)
    found = verify(problem, motion, Tolerances(limits=100.0))
    contact = found.worst["clearance"]
    assert contact.violated and "post" in contact.name
    assert contact.time == pytest.approx(0.5, abs=0.01)
    assert found.min_clearance == pytest.approx(-contact.amount)
    assert found.min_clearance < -0.1  # the axis of the arm goes through the centre
    far = replace(problem, scene=Scene([Sphere("post", radius=0.1, position=2 * at)]))
    assert verify(far, motion, Tolerances(limits=100.0)).min_clearance > 3.0


def test_motion_limits_are_checked() -> None:
    limits = MotionLimits(
        acceleration=4.0,
        effort_rate=100.0,
        effort_scale=0.9,
        effort_curves={"joint1": EffortCurve.droop(FORCE, 4.0)},
    )
    found = verify(replace(rail_problem(), motion_limits=limits), rail_motion())
    assert not found.ok
    assert found.worst["acceleration"].amount == pytest.approx(PUSH - 4.0)
    # Where the force jumps, from 10 N to -10 N.
    assert found.worst["effort rate"].time == pytest.approx(0.5 * RAIL_TIME)
    droop = found.worst["effort"]
    assert droop.time == pytest.approx(0.5 * RAIL_TIME)
    assert droop.amount == pytest.approx(FORCE * np.sqrt(PUSH) / 4.0, rel=1e-6)
    only_scale = MotionLimits(effort_scale=0.9)
    found = verify(replace(rail_problem(), motion_limits=only_scale), rail_motion())
    assert found.worst["effort"].amount == pytest.approx(0.1 * FORCE)


def test_steady_feedback_is_no_rate_of_the_torques() -> None:
    """Regression: torques before a node lacked the feedback of a replay: it seemed to
    jump at each node.
    """
    limits = MotionLimits(effort_rate=12.0)
    problem = replace(rail_problem(), motion_limits=limits)
    motion = accelerating(1.0, 0.0)
    torque, replayed = torque_pieces(problem.robot, motion), planned(motion)
    fed, unknown = replace(replayed, u=replayed.u + 0.05), np.full((2, 1), np.nan)
    found = limit_violations(problem, fed, torque, 0.0, unknown)
    (rate,) = (item for item in found if item.kind == "effort rate")
    assert rate.amount == pytest.approx(-12.0)


SMOOTH = {"jerk": MotionLimits(jerk=6.0), "effort rate": MotionLimits(effort_rate=12.0)}


def accelerating(
    a: float, jerk: float, begin: float = 0.0, speed: float = 0.0
) -> Trajectory:
    """A motion of constant jerk on a rail from a state, over one second."""
    t = np.linspace(0.0, 1.0, 5)[:, None]
    inverse = RobotDynamics(rail_problem().robot).inverse
    q = begin + speed * t + a * t**2 / 2.0 + jerk * t**3 / 6.0
    v = speed + a * t + jerk * t**2 / 2.0
    u = inverse(q, v, a + jerk * t)
    return Trajectory(("joint1",), t[:, 0], q, v, u, inverse_dynamics=inverse)


@pytest.mark.parametrize("kind", SMOOTH)
@pytest.mark.parametrize(
    ("a", "jerk", "time"), [(2.0, -2.0, 0.0), (0.0, 2.0, 1.0), (0.0, 0.0, None)]
)
def test_acceleration_jump_at_an_end_violates_rate_limits(
    kind: str, a: float, jerk: float, time: float | None
) -> None:
    motion = accelerating(a, jerk)
    goal, limits = JointGoal(motion.q[-1], motion.v[-1]), SMOOTH[kind]
    found = verify(replace(rail_problem(), goal=goal, motion_limits=limits), motion)
    assert [item.time for item in found.violations] == ([] if time is None else [time])
    assert all(item.kind == kind for item in found.violations)


@pytest.mark.parametrize("kind", SMOOTH)
@pytest.mark.parametrize("continuous", [True, False])
def test_acceleration_jump_between_segments_violates_rate_limits(
    kind: str, continuous: bool
) -> None:
    first, robot = accelerating(0.0, 2.0), rail_problem().robot
    a = 2.0 if continuous else 0.0
    state = float(first.q[-1, 0]), float(first.v[-1, 0])
    second = accelerating(a, -a, *state)
    q, v, u = (
        np.concatenate([getattr(first, name), getattr(second, name)[1:]])
        for name in ("q", "v", "u")
    )
    t = np.append(first.t, 1.0 + second.t[1:])
    motion = replace(first, t=t, q=q, v=v, u=u, segment_ends=np.array([1.0, 2.0]))
    passed = Segment(JointGoal(first.q[-1]), stop=False)
    segments = [passed, Segment(JointGoal(q[-1], v[-1]))]
    limits = SMOOTH[kind]
    problem = Problem(robot, [0.0], segments=segments, motion_limits=limits)
    jumps = verify(problem, motion).violations
    places = [(item.kind, item.time, item.segment) for item in jumps]
    assert places == ([] if continuous else [(kind, 1.0, 2)])


def test_verify_rejects_other_joints_and_nan() -> None:
    motion = rail_motion()
    with pytest.raises(ProblemError, match="joint1"):
        verify(rail_problem(), replace(motion, joint_names=("elbow",)))
    nan = replace(motion, v=np.full_like(motion.v, np.nan))
    with pytest.raises(ProblemError, match="not finite numbers"):
        verify(rail_problem(), nan)


def test_tolerances_are_options() -> None:
    options = Options(goal_tolerance=0.1, contact_tolerance=0.2)
    assert options.tolerances == Tolerances(goal=0.1, contact=0.2)
    assert Options().tolerances == Tolerances()


RUNNER = """<robot name="runner"><link name="rail"/><link name="carriage">
<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>
</inertial><collision><geometry><sphere radius="0.01"/></geometry></collision></link>
<joint name="run" type="prismatic"><parent link="rail"/><child link="carriage"/>
<axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="100" velocity="20"/></joint>
</robot>"""


def test_collision_between_two_sampled_instants_is_found(tmp_path) -> None:
    # At 10 m/s, a ball of 1 cm passes a small ball between two instants: their distance
    # is 0.6 mm at both instants, and their depth 0.5 mm halfway.
    path = tmp_path / "runner.urdf"
    path.write_text(RUNNER)
    robot = load_robot(path)
    pin = Sphere("pin", radius=1e-3, position=(0.505, 0.0105, 0.0))
    problem = Problem(
        robot, [0.0], JointGoal([1.0], [10.0]), Scene([pin]), v_start=[10.0]
    )
    t = np.array([0.0, 0.1])
    zero = np.zeros((2, 1))
    motion = Trajectory(robot.joint_names, t, 10.0 * t[:, None], zero + 10.0, zero)
    found = verify(problem, motion)
    assert [item.kind for item in found.violations] == ["clearance"]
    assert found.min_clearance == pytest.approx(-5e-4, abs=1e-5)
    assert found.violations[0].time == pytest.approx(0.0505, abs=2e-4)


@pytest.mark.parametrize("curve", [False, True])
def test_mean_torque_between_two_rows_is_compared_with_the_limit(curve: bool) -> None:
    # Regression: torques were compared at the rows alone. A rail whose carriage is sped
    # up within a millisecond has no torque at either end of it.
    robot = make_arm(slide(MASS), effort=1e3 if curve else FORCE)
    of_speed = {"joint1": EffortCurve(np.array([0.0, 1.0]), np.full(2, FORCE))}
    limits = MotionLimits(effort_curves=of_speed) if curve else None
    speed, h = 3e-3 * PUSH, 1e-3
    t = np.array([0.0, 0.1, 0.1 + h, 0.2])
    q = np.array([[0.0], [0.0], [0.5 * h * speed], [speed * (0.1 - 0.5 * h)]])
    v, rest = np.array([[0.0], [0.0], [speed], [speed]]), np.zeros((4, 1))
    dynamics = RobotDynamics(robot).inverse
    motion = Trajectory(
        robot.joint_names, t, q, v, rest, a=rest, inverse_dynamics=dynamics
    )
    goal = JointGoal(q[-1], v[-1])
    problem = Problem(robot, np.zeros(1), goal, motion_limits=limits)
    found = verify(problem, motion)
    mean = MASS * speed / h
    assert found.worst["effort"].amount == pytest.approx(mean - FORCE, rel=1e-3)
    assert [item.kind for item in found.violations] == ["effort"]


def test_torque_jump_between_samples_of_a_millisecond_is_no_violation() -> None:
    # Regression: the force is reversed after a fifth of a millisecond, and polynomials
    # of degree 5 through the samples exceed it there.
    t, turn = np.linspace(0.0, 0.2, 201), 0.1002
    late = np.maximum(t - turn, 0.0)
    q, v = PUSH * (0.5 * t**2 - late**2), PUSH * (t - 2.0 * late)
    a = np.where(t < turn, PUSH, -PUSH)
    rows = [column[:, None] for column in (q, v, a)]
    samples = Samples(("joint1",), t, *rows, np.full((201, 1), np.nan), "quintic")
    goal = JointGoal(q[-1:], v[-1:])
    problem = Problem(rail_problem().robot, np.zeros(1), goal)
    torque = checked_motion(samples, problem)(np.linspace(0.1, 0.101, 99)).u
    assert np.max(np.abs(torque)) > 1.1 * FORCE
    found = verify(problem, samples)
    assert found.ok, found.message
