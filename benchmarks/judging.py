"""Judging a motion of an arm among obstacles, without the library.

The judge must be independent of the library, so this module does not import it:
the scene and the request are read anew, the robot is built from its URDF and SRDF by
Pinocchio, links are the unmodified triangle meshes of the description, and the torques
are replayed by scipy. The checks of the replayed motion are:

- clearance, of all links to all obstacles and to each other, every millisecond;
- position, velocity and torque limits, every millisecond and on both sides of the
  jumps of the torque;
- the end of the motion.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml
from scipy.integrate import solve_ivp

from benchmarks.exact_geometry import Array, Clearance, ExactArm, Surroundings

# A time in [s] to q, v, a, u, each of shape (n,).
Motion = Callable[[float], tuple[Array, Array, Array, Array]]

TIME_STEP = 1e-3  # [s]
RTOL, ATOL = 1e-12, 1e-13  # of the replay
GOAL_TOLERANCE = 1e-3  # [rad]
LIMIT_TOLERANCE = 5e-3  # relative


@dataclass(frozen=True)
class Request:
    """Start and goal by joint name, in [rad] or [m]."""

    start: Mapping[str, float]
    goal: Mapping[str, float]


def read_request(path: Path) -> Request:
    """Read start and goal of a MoveIt motion plan request."""
    request = yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)
    state = request["start_state"]["joint_state"]
    start = dict(zip(state["name"], map(float, state["position"]), strict=True))
    (constraints,) = request["goal_constraints"]
    goal = {
        item["joint_name"]: float(item["position"])
        for item in constraints["joint_constraints"]
    }
    return Request(start, goal)


@dataclass(frozen=True)
class Verdict:
    """Verdict on a motion.

    Attributes:
        clearance: Its closest approach.
        closest_time: Time of the closest approach [s].
        position_excess: Largest excess relative to the range of the joint.
        velocity_excess: Largest excess relative to the limit.
        effort_excess: Largest excess relative to half the range of the torque.
        goal_error: Largest distance of a joint from the goal at the end [rad].
        goal_speed: Largest speed of a joint at the end [rad/s].
        replay_error: Largest distance of a joint from the plan along the motion [rad].
    """

    clearance: Clearance
    closest_time: float
    position_excess: float
    velocity_excess: float
    effort_excess: float
    goal_error: float
    goal_speed: float
    replay_error: float

    @property
    def passed(self) -> bool:
        """Whether the motion is free of contact, within limits and at its goal."""
        return not self.faults

    @property
    def faults(self) -> tuple[str, ...]:
        """Faults of the motion, in single words."""
        excesses = {
            "position": self.position_excess,
            "velocity": self.velocity_excess,
            "effort": self.effort_excess,
        }
        # Written so that NaN is a fault.
        found = [k for k, v in excesses.items() if not v <= LIMIT_TOLERANCE]
        if not self.clearance.distance > 0.0:
            found.append("contact")
        if not self.goal_error <= GOAL_TOLERANCE:
            found.append("goal")
        return tuple(found)


def replay(
    arm: ExactArm, motion: Motion, knots: Array, q_start: Array
) -> tuple[Array, Array, Array]:
    """Integrate the torques of a motion from rest, from one jump of them to the next.

    Args:
        arm: The arm.
        motion: The motion, whose torques alone are used.
        knots: Times between which the torques are smooth, from 0 to T, shape (N+1,).
        q_start: Start configuration, shape (n,).

    Returns:
        Times, positions and velocities, every millisecond and at the knots: shapes
        (m,), (m, n) and (m, n).
    """
    model, data, n = arm.model, arm.model.createData(), len(arm.names)
    state = np.concatenate([q_start, np.zeros(n)])
    times, states = [np.zeros(1)], [state[None]]

    for begin, end in itertools.pairwise(knots):
        last = np.nextafter(end, begin)  # the torque just before it jumps

        def slope(t: float, x: Array, last: float = last) -> Array:
            q, v = x[:n], x[n:]
            torque = motion(min(t, last))[3] - arm.damping * v
            return np.concatenate([v, pin.aba(model, data, q, v, torque)])

        ticks = TIME_STEP * np.arange(
            np.floor(begin / TIME_STEP) + 1, np.ceil(end / TIME_STEP)
        )
        ticks = np.append(ticks[(ticks > begin) & (ticks < end)], end)
        outcome = solve_ivp(
            slope, (begin, end), state, "DOP853", ticks, rtol=RTOL, atol=ATOL
        )
        if not outcome.success:
            break
        state = outcome.y[:, -1]
        times.append(outcome.t)
        states.append(outcome.y.T)
    path = np.concatenate(states)
    return np.concatenate(times), path[:, :n], path[:, n:]


def judge(
    arm: ExactArm,
    surroundings: Surroundings,
    request: Request,
    motion: Motion,
    knots: Array,
    *,
    replayed: bool = True,
) -> Verdict:
    """Judge a motion.

    Without control an arm is unstable: on a Panda rounding errors of a replay grow by a
    factor of about ten every quarter of a second, so that motions of more than three
    seconds cannot be replayed, and the integrator is as accurate as possible.

    Args:
        arm: The arm.
        surroundings: The obstacles.
        request: Required start and goal.
        motion: The motion.
        knots: Times between which the torques are smooth, from 0 to T, shape (N+1,).
        replayed: Whether to judge the replay of the torques; otherwise the positions
            and velocities of the motion itself.
    """
    start, goal = arm.vector(request.start), arm.vector(request.goal)
    times, q, v = replay(arm, motion, knots, start)
    deviation = float(np.abs(q - np.array([motion(t)[0] for t in times])).max())
    arrived = times[-1] >= knots[-1]
    if not replayed:
        arrived, times = True, np.union1d(np.arange(0.0, knots[-1], TIME_STEP), knots)
        q, v = (np.array([motion(t)[part] for t in times]) for part in (0, 1))
    before = np.nextafter(knots[1:], 0.0)
    torques = np.array([motion(t)[3] for t in np.concatenate([times, before])])
    model = arm.model
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    position = np.maximum(q - high, low - q) / (high - low)
    velocity = np.abs(v) / model.velocityLimit - 1.0
    effort = np.abs(torques) / model.effortLimit - 1.0
    clearance = surroundings.closest(q)
    return Verdict(
        clearance=clearance,
        closest_time=float(times[clearance.sample]),
        position_excess=max(0.0, float(position.max())),
        velocity_excess=max(0.0, float(velocity.max())),
        effort_excess=max(0.0, float(effort.max())),
        goal_error=float(np.abs(q[-1] - goal).max()) if arrived else np.inf,
        goal_speed=float(np.abs(v[-1]).max()),
        replay_error=deviation,
    )
