"""Replay of unstable motions: the torques with a small feedback.

An arm that is raised slowly is a row of inverted pendulums: over seconds it amplifies
all errors, rounding included, 10^10-fold and more, and no torque over time brings it to
the goal, in a computer or in the world. A proof of such a motion is that its torques
need very little feedback. The replay then is a motion of the arm under the torques of
the plan and of the feedback, and is judged as any other; the feedback may take only a
small share of the limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import expm

from tominpmp.arrays import Array
from tominpmp.motion.trajectory import Trajectory, torque_breaks
from tominpmp.motion_limits import FEEDBACK
from tominpmp.options import Tolerances
from tominpmp.robot.robot import Robot
from tominpmp.stopping import check
from tominpmp.verification.limit_violations import (
    LimitViolation,
    worst_of_joints,
)
from tominpmp.verification.plant import Plant
from tominpmp.verification.polynomials import Pieces
from tominpmp.verification.replay import (
    RTOL,
    Integration,
    Integrator,
    Replay,
)

if TYPE_CHECKING:
    from tominpmp.verification.stages import Stage

# Rate of the feedback as a multiple of that of the instability, and its least [1/s].
FASTER = 4.0
LEAST_RATE = 20.0
# Share of the tolerated excess over the torque limits that the feedback may take.
TRACE = 0.2
# Amplified errors of the integration below this share of the tolerance at the goal are
# neglected.
NEGLIGIBLE = 0.1
# Factor by which tighter tolerances of the integration must not change the end.
TIGHTER = 10.0


class TrackingPlant(Plant):
    """A robot under the torque of a plan and a feedback of its position and velocity.

    Its state is its deviation from the plan: deviations stay small, and are integrated
    with steps many times as long as those of an explicit method for the state itself,
    which a fast feedback makes stiff. The polynomials are those of the torques of the
    plan, of its states and of their derivatives, 5n in all. The feedback acts on the
    accelerations: a double pole at ``-rate``.
    """

    def __init__(self, robot: Robot, rate: float) -> None:
        super().__init__(robot)
        self.rate_of_feedback = rate
        self._plan = np.zeros(5 * robot.n)

    def torque(self, t: float) -> Array:
        """Torque of the plan at the time of the last state, shape (n,)."""
        return self._plan[: self._n]

    def state(self, t: float, x: Array) -> Array:
        """State of the robot: that of the plan and the deviation, shape (2n,)."""
        self._plan = super().torque(t)
        return self._plan[self._n : 3 * self._n] + x

    def demand(self, off: Array) -> Array:
        """Acceleration by the feedback for a deviation, shape (..., n)."""
        n, rate = self.robot.n, self.rate_of_feedback
        return np.asarray(-rate * (rate * off[..., :n] + 2.0 * off[..., n:]))

    def free(self, t: float, x: Array) -> Array:
        """Derivative of the state with the feedback, for free joints, shape (2n,)."""
        out = super().free(t, self.state(t, x))
        out[self._n :] += self.demand(x)
        return out

    def free_jacobian(self, t: float, x: Array) -> Array:
        """Derivative of :meth:`free` by the deviation, shape (2n, 2n)."""
        out = super().free_jacobian(t, self.state(t, x))
        n, rate, diagonal = self._n, self.rate_of_feedback, np.arange(self._n)
        out[n + diagonal, diagonal] -= rate * rate
        out[n + diagonal, n + diagonal] -= 2.0 * rate
        return out

    def slope(self, t: float, x: Array) -> Array:
        """Derivative of the deviation, shape (2n,)."""
        return super().slope(t, x) - self._plan[3 * self._n :]


class Tracking(Integration):
    """Integration of the torques of a trajectory with feedback.

    Args:
        stages: The segments of the motion, with their robots.
        trajectory: The plan.
        rate: Rate of the feedback [1/s].
        integrator: Name of the integrator.

    Attributes:
        feedback: Torques of the feedback at the times of the replay, after its run,
            shape (m, n) [N m or N].
    """

    feedback: Array
    # With feedback errors do not grow, and deviations stay small: the first step may be
    # a whole piece, and a nanoradian is exact enough.
    lsoda_tightness, hurried, atol = 1.0, True, 1e-9

    def __init__(
        self,
        stages: Sequence[Stage],
        trajectory: Trajectory,
        rate: float,
        integrator: Integrator | None = None,
    ) -> None:
        robot = stages[0].problem.robot

        def curve(times: Array) -> Array:
            found = trajectory(times)
            return np.concatenate([found.u, found.q, found.v], axis=1)

        pieces = Pieces.of(curve, torque_breaks(trajectory, robot.friction))
        rates = pieces.derivatives()[:, robot.n :]
        both = np.concatenate([pieces.coefficients, rates], axis=1)
        pieces = replace(pieces, coefficients=both)
        self._stages = stages
        self._plants = [TrackingPlant(stage.problem.robot, rate) for stage in stages]
        super().__init__(robot, trajectory, pieces, integrator, self._plants)

    def run(self, start: Array) -> Replay:
        """Integrate from a state of shape (2n,) to the end; u includes the feedback."""
        found, n = super().run(start), start.size // 2
        plan = self.pieces(found.t)[:, n : 3 * n]
        demand = self._plants[0].demand(np.hstack([found.q, found.v]) - plan)
        self.feedback = np.zeros_like(demand)
        for plant, stage in zip(self._plants, self._stages, strict=True):
            check()
            rows = (found.t >= stage.begin) & (found.t <= stage.end)
            torque = plant.dynamics.inertial(found.q[rows], demand[rows])
            self.feedback[rows] = torque
        return replace(found, u=found.u[:, :n] + self.feedback)

    def _piece(self, k: int, x: Array, times: Array) -> tuple[Array, Array]:
        """Integrate the deviation over a piece, and add the plan."""
        plan = self.pieces.on(k, times)[:, x.size // 2 : 3 * x.size // 2]
        rows, way = super()._piece(k, x - plan[0], times)
        return rows + plan[1 : 1 + len(rows)], way


def amplification(stages: Sequence[Stage], trajectory: Trajectory) -> float:
    """Largest amplification of a small error along a motion.

    Args:
        stages: Its segments, with their robots.
        trajectory: The motion.

    Returns:
        The largest ratio of the error at a node to one at an earlier node: of norms of
        positions, and velocities times a tenth of a second. Infinite for numbers that
        overflow.
    """
    n, t = trajectory.n, trajectory.t
    times = 0.5 * (t[1:] + t[:-1])
    middle = trajectory(times)
    states = np.concatenate([middle.q, middle.v], axis=1)
    slopes = np.zeros((times.size, 2 * n, 2 * n))
    for stage in stages:
        rows = (times >= stage.begin) & (times <= stage.end)
        dynamics = Plant(stage.problem.robot).dynamics
        slopes[rows] = dynamics.forward_jacobians(states[rows], middle.u[rows]).f_x
    scale = np.concatenate([np.ones(n), np.full(n, 0.1)])
    largest, from_start = 1.0, np.eye(2 * n)
    with np.errstate(all="ignore"):
        moves = expm(slopes * np.diff(t)[:, None, None])
        for move in moves * scale[:, None] / scale:
            # Where errors have decayed, errors of later nodes are larger.
            from_start = move @ from_start
            finite = bool(np.all(np.isfinite(from_start)))
            size = float(np.linalg.norm(from_start, 2)) if finite else 0.0
            if not size > 0.0:
                return np.inf
            largest = max(largest, size)
            if size < 1.0:
                from_start = np.eye(2 * n)
    return largest


def doubtful(
    growth: float, tolerance: float, error: float, share: float = NEGLIGIBLE
) -> bool:
    """Whether errors of the integration may matter at the goal.

    Args:
        growth: See :func:`amplification`.
        tolerance: Tolerance at the goal [rad or m].
        error: Errors of the integration, as a share of the growth.
        share: Share of the tolerance above which they matter.
    """
    return not growth * error < share * tolerance


def settled(one: Replay, finer: Replay, tolerances: Tolerances) -> bool:
    """Whether a replay and one with tighter tolerances have the same end.

    Args:
        one: The replay.
        finer: The replay with tighter tolerances.
        tolerances: Tolerances at the goal.
    """
    apart = np.abs([one.q[-1] - finer.q[-1], one.v[-1] - finer.v[-1]])
    allowed = NEGLIGIBLE * np.array([[tolerances.goal], [tolerances.speed]])
    return one.complete and finer.complete and bool(np.all(apart <= allowed))


def feedback_rate(growth: float, duration: float, tolerance: float) -> float | None:
    """Rate of the feedback that a replay needs [1/s]; None without feedback.

    Args:
        growth: See :func:`amplification`.
        duration: Duration of the motion [s].
        tolerance: Tolerance at the goal [rad or m].
    """
    if not doubtful(growth, tolerance, RTOL):
        return None
    speed = np.log(min(growth, 1e300)) / duration
    return float(max(FASTER * speed, LEAST_RATE))


def needed(
    robot: Robot, t: Array, feedback: Array, tolerance: float
) -> LimitViolation | None:
    """Excess of the torques of a feedback over its share of the torque limits.

    Args:
        robot: The robot.
        t: Times [s], shape (m,).
        feedback: Torques of the feedback at these times, shape (m, n) [N m or N].
        tolerance: Tolerated excess over the limits, as a share of their range.

    Returns:
        The worst joint; None without torque limits.
    """
    span = robot.limits.effort_upper - robot.limits.effort_lower
    beyond = np.abs(feedback) - TRACE * tolerance * span
    return worst_of_joints(robot, FEEDBACK, t, beyond, span, 0.0)
