"""Motions replayed in MuJoCo: the torques alone, and with a feedback."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tominpmp.arrays import Array, Record
from tominpmp.checks import choice, positive
from tominpmp.exceptions import ProblemError
from tominpmp.motion.trajectory import Trajectory
from tominpmp.physics.mujoco_arm import MujocoArm
from tominpmp.problem.problem import Problem
from tominpmp.verification.replay import cut

# Steps of the simulator, unless something else is asked for [s].
STEP = 2e-4
# How fast the feedback brings errors to zero [1/s].
BANDWIDTH = 30.0
MOST_STEPS = 5_000_000


@dataclass(frozen=True, eq=False)
class Run(Record):
    """A motion as the simulator saw it.

    Attributes:
        feedback: Whether torques were corrected by errors of position and velocity.
        t: Times [s], shape (m,).
        q: Positions, shape (m, n) [rad or m].
        v: Velocities, shape (m, n).
        u: Torques from each time to the next, shape (m, n); the last row is that of
            the end.
        goal_error: Largest distance of a joint from where the motion ends [rad or m].
        tracking_error: Largest distance of a joint from the motion, at any time.
        excess: Largest share of its limit by which a torque is beyond it; zero if none.
    """

    feedback: bool
    t: Array = field(repr=False)
    q: Array = field(repr=False)
    v: Array = field(repr=False)
    u: Array = field(repr=False)
    goal_error: float
    tracking_error: float
    excess: float


@dataclass(frozen=True, eq=False)
class PhysicsReplay(Record):
    """A motion replayed in another simulator.

    Attributes:
        engine: Name and version of the simulator.
        integrator: How it integrates, and its step [s].
        open_loop: The torques alone.
        with_feedback: The torques and a feedback.
        torque_difference: Largest difference of the two inverse dynamics along the
            motion, as a share of the largest torque of each joint.
        tolerance: What either may be off by at the goal [rad or m].
    """

    engine: str
    integrator: str
    open_loop: Run
    with_feedback: Run
    torque_difference: float
    tolerance: float

    @property
    def ok(self) -> bool:
        """Whether the motion with feedback ends where it is to.

        Torques alone may lead astray in long motions of unstable arms, in every
        simulator; see :mod:`~tominpmp.verification.feedback`.
        """
        return self.with_feedback.goal_error <= self.tolerance

    @property
    def message(self) -> str:
        """What was found, in a sentence."""
        alone, fed = self.open_loop, self.with_feedback
        return (
            f"{self.engine} ({self.integrator}): the torques alone end "
            f"{alone.goal_error:.2g} from the goal, with feedback {fed.goal_error:.2g} "
            f"and never more than {fed.tracking_error:.2g} from the motion (rad or m); "
            f"the inverse dynamics differ by {self.torque_difference:.1g} of the "
            "largest torques"
        )


def replay(
    problem: Problem,
    trajectory: Trajectory,
    *,
    engine: str = "mujoco",
    step: float = STEP,
    bandwidth: float = BANDWIDTH,
    tolerance: float = 1e-2,
) -> PhysicsReplay:
    """Replay a motion in MuJoCo, with its torques alone and with a feedback.

    Args:
        problem: Robot and loads.
        trajectory: The motion, with torques.
        engine: The simulator: "mujoco" (extra ``mujoco``).
        step: Longest step of the simulator [s].
        bandwidth: How fast the feedback brings errors to zero [1/s]: the gains are
            those of two poles there, for the inertia that each joint sees.
        tolerance: What the end may be off by [rad or m].

    Raises:
        ProblemError: If the robot has joints that follow others, a load changes on the
            way, or a value is wrong.
        MissingDependency: If MuJoCo is not installed.
    """
    choice(engine, ("mujoco",), "engine", "'mujoco'")
    step, bandwidth = positive(step, "step", "s"), positive(bandwidth, "bandwidth")
    tolerance = positive(tolerance, "tolerance", "rad or m")
    check_one_load(problem)
    if not np.all(np.isfinite(trajectory.u)):
        raise ProblemError("trajectory has no torques to replay", "trajectory")
    if trajectory.duration / step > MOST_STEPS:
        raise ProblemError(f"step is {step:g} s, too small for the motion", "step")
    arm = MujocoArm(problem.robot)
    integrator = arm.choose_integrator(step, trajectory.q[0])
    return PhysicsReplay(
        f"MuJoCo {arm.mujoco.__version__}",
        f"{integrator}, steps of {1e3 * step:.3g} ms",
        _run(arm, trajectory, step, 0.0),
        _run(arm, trajectory, step, bandwidth),
        torque_difference(arm, trajectory),
        tolerance,
    )


def check_one_load(problem: Problem) -> None:
    """Check that the arm carries the same all the way.

    Raises:
        ProblemError: If it does not.
    """
    if any(segment.payload is not None for segment in problem.segments):
        raise ProblemError(
            "segments: a load changes on the way, expected one robot for the whole "
            "motion; replay the segments by themselves",
            "segments",
        )


def _run(arm: MujocoArm, trajectory: Trajectory, step: float, bandwidth: float) -> Run:
    """Move an arm by the torques of a motion, and a feedback of some bandwidth."""
    times = cut(trajectory.t, step)
    gains = arm.gains(trajectory.q, bandwidth)
    q, v, u = follow(arm, trajectory, times, gains)
    limits, wanted = arm.robot.limits, trajectory(times).q
    span = np.maximum(np.abs(limits.effort_lower), limits.effort_upper)
    beyond = np.maximum(u - limits.effort_upper, limits.effort_lower - u)
    share = beyond / np.where(span > 0.0, span, 1.0)
    return Run(
        bandwidth > 0.0,
        times,
        q,
        v,
        u,
        goal_error=float(np.abs(q[-1] - wanted[-1]).max()),
        tracking_error=float(np.abs(q - wanted).max()),
        excess=max(float(share.max()), 0.0),
    )


def follow(
    arm: MujocoArm,
    trajectory: Trajectory,
    times: Array,
    gains: tuple[Array, Array],
    *,
    most: tuple[Array, Array] | None = None,
    late: int = 0,
    noise: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Move an arm by the torques of a motion, and a feedback.

    Args:
        arm: The arm.
        trajectory: The motion.
        times: Instants of the controller [s], shape (m,).
        gains: Stiffnesses and dampings of the feedback, shape (n,) each.
        most: Torques at which the motors cut off, shape (n,) each; None for none.
        late: How many instants later what is measured acts.
        noise: What is added to measured positions and velocities, shape (2, m, n).

    Returns:
        Positions, velocities and torques from each instant on, shape (m, n) each.
    """
    # A torque that is constant on a step is that of its middle.
    plan, wanted = trajectory(times), trajectory(0.5 * (times[:-1] + times[1:])).u
    stiffness, damping = gains
    q, v, u = (np.empty(plan.q.shape) for _ in range(3))
    seen_q, seen_v = np.zeros((2, *q.shape)) if noise is None else noise
    corrections = [np.zeros(arm.robot.n)] * late
    arm.set_state(plan.q[0], plan.v[0])
    for k, seconds in enumerate(np.diff(times).tolist()):
        q[k], v[k] = arm.q, arm.v
        off, slow = plan.q[k] - q[k] - seen_q[k], plan.v[k] - v[k] - seen_v[k]
        corrections.append(stiffness * off + damping * slow)
        u[k] = wanted[k] + corrections[k]
        if most is not None:
            u[k] = np.clip(u[k], *most)
        arm.step(u[k], seconds)
    q[-1], v[-1], u[-1] = arm.q, arm.v, plan.u[-1]
    return q, v, u


def torque_difference(arm: MujocoArm, trajectory: Trajectory) -> float:
    """Largest difference of MuJoCo's inverse dynamics from the torques of a motion.

    Returns:
        As a share of the largest torque of each joint. Dry friction, which MuJoCo
        makes smooth about rest, counts where the joints move.
    """
    share = (np.arange(100) + 0.5) / 100
    state = trajectory(share * trajectory.duration)
    found = np.array([arm.inverse(*row) for row in zip(*state[:3], strict=True)])
    largest = np.maximum(np.abs(state.u).max(axis=0), 1e-9)
    moving = (np.abs(state.v) > 1e-2) | (arm.robot.friction == 0.0)
    return float(np.max(np.abs(found - state.u) / largest * moving))
