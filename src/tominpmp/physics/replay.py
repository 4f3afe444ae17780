"""Replay of motions in MuJoCo, open loop and with feedback."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tominpmp.arrays import Array, Record
from tominpmp.checks import choice, positive
from tominpmp.exceptions import ProblemError
from tominpmp.motion.samples import subdivided
from tominpmp.motion.trajectory import Trajectory
from tominpmp.physics.mujoco_arm import MujocoArm
from tominpmp.problem.problem import Problem

# Default step of the simulator [s].
STEP = 2e-4
# Default bandwidth of the feedback [1/s].
BANDWIDTH = 30.0
MOST_STEPS = 5_000_000


@dataclass(frozen=True, eq=False)
class Run(Record):
    """A simulated motion.

    Attributes:
        feedback: Whether torques were corrected by errors of position and velocity.
        t: Times [s], shape (m,).
        q: Positions, shape (m, n) [rad or m].
        v: Velocities, shape (m, n) [rad/s or m/s].
        u: Torques from each time to the next, shape (m, n) [N m or N]; the last row has
            the torques of the motion at its end.
        goal_error: Largest distance of a joint from the end of the motion [rad or m].
        tracking_error: Largest distance of a joint from the motion at any time
            [rad or m].
        excess: Largest violation of a torque limit, as a share of the limit; zero
            without a violation.
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
        integrator: Its integrator and step, in words.
        open_loop: The simulation with the torques alone.
        with_feedback: The simulation with torques and feedback.
        torque_difference: Largest difference of the two inverse dynamics along the
            motion, as a share of the largest torque of each joint.
        tolerance: Largest tolerated error at the end with feedback [rad or m].
    """

    engine: str
    integrator: str
    open_loop: Run
    with_feedback: Run
    torque_difference: float
    tolerance: float

    @property
    def ok(self) -> bool:
        """Whether the motion with feedback ends within the tolerance.

        Without feedback, integration errors grow in long motions of unstable arms, in
        every simulator; see :mod:`~tominpmp.verification.feedback`.
        """
        return self.with_feedback.goal_error <= self.tolerance

    @property
    def message(self) -> str:
        """The errors of both simulations, in a sentence."""
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
    """Replay a motion in MuJoCo, with its torques alone and with feedback.

    Args:
        problem: Robot and loads.
        trajectory: The motion, with torques.
        engine: The simulator: "mujoco" (extra ``mujoco``).
        step: Longest step of the simulator [s].
        bandwidth: Bandwidth of the feedback [1/s]: the gains give each joint, with its
            diagonal inertia, a double pole at minus the bandwidth.
        tolerance: Largest tolerated error at the end with feedback [rad or m].

    Raises:
        ProblemError: If the robot has mimic joints, a load changes during the motion,
            or a value is wrong.
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
    """Check that the arm carries the same load during the whole motion.

    Raises:
        ProblemError: If a segment has a payload.
    """
    if any(segment.payload is not None for segment in problem.segments):
        raise ProblemError(
            "segments: a load changes during the motion, expected the same load for "
            "the whole motion; replay each segment separately",
            "segments",
        )


def _run(arm: MujocoArm, trajectory: Trajectory, step: float, bandwidth: float) -> Run:
    """Simulate an arm with the torques of a motion; bandwidth 0 is open loop."""
    times = subdivided(trajectory.t, step)
    q, v, u = follow(arm, trajectory, times, arm.gains(trajectory.q, bandwidth))
    limits, desired = arm.robot.limits, trajectory(times).q
    span = np.maximum(np.abs(limits.effort_lower), limits.effort_upper)
    beyond = np.maximum(u - limits.effort_upper, limits.effort_lower - u)
    share = beyond / np.where(span > 0.0, span, 1.0)
    return Run(
        bandwidth > 0.0,
        times,
        q,
        v,
        u,
        goal_error=float(np.abs(q[-1] - desired[-1]).max()),
        tracking_error=float(np.abs(q - desired).max()),
        excess=max(float(share.max()), 0.0),
    )


def follow(
    arm: MujocoArm,
    trajectory: Trajectory,
    times: Array,
    gains: tuple[Array, Array],
    *,
    cutoff: tuple[Array, Array] | None = None,
    delay: int = 0,
    noise: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Simulate an arm with the torques of a motion as feed-forward, and feedback.

    Args:
        arm: The arm.
        trajectory: The motion.
        times: Instants of the controller [s], shape (m,).
        gains: Stiffnesses and dampings of the feedback, shape (n,) each.
        cutoff: Least and largest torques of the motors, shape (n,) each [N m or N];
            None for motors without limits.
        delay: Number of instants between a measurement and its correction.
        noise: Noise added to measured positions and velocities, shape (2, m, n); None
            for exact measurements.

    Returns:
        Positions, velocities and torques from each instant on, shape (m, n) each.
    """
    # The constant torque of a step is the motion's torque at its middle.
    plan, feedforward = trajectory(times), trajectory(0.5 * (times[:-1] + times[1:])).u
    stiffness, damping = gains
    q, v, u = (np.empty(plan.q.shape) for _ in range(3))
    noise_q, noise_v = np.zeros((2, *q.shape)) if noise is None else noise
    corrections = [np.zeros(arm.robot.n)] * delay
    arm.set_state(plan.q[0], plan.v[0])
    for k, seconds in enumerate(np.diff(times).tolist()):
        q[k], v[k] = arm.state
        error, rate = plan.q[k] - q[k] - noise_q[k], plan.v[k] - v[k] - noise_v[k]
        corrections.append(stiffness * error + damping * rate)
        u[k] = feedforward[k] + corrections[k]
        if cutoff is not None:
            u[k] = np.clip(u[k], *cutoff)
        arm.step(u[k], seconds)
    (q[-1], v[-1]), u[-1] = arm.state, plan.u[-1]
    return q, v, u


def torque_difference(arm: MujocoArm, trajectory: Trajectory) -> float:
    """Largest difference of MuJoCo's inverse dynamics from the torques of a motion.

    Returns:
        The difference as a share of the largest torque of each joint. Joints with dry
        friction, which MuJoCo smooths about rest, count only while they move so fast
        that their acceleration does not stop them at once.
    """
    state = trajectory((np.arange(100) + 0.5) / 100 * trajectory.duration)
    torques = np.array([arm.inverse(*row) for row in zip(*state[:3], strict=True)])
    largest = np.maximum(np.abs(state.u).max(axis=0), 1e-9)
    slow = 1e-2 + arm.model.dof_solref[0, 0] * np.abs(state.a)
    moving = (np.abs(state.v) > slow) | (arm.robot.friction == 0.0)
    return float(np.max(np.abs(torques - state.u) / largest * moving))
