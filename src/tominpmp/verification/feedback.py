"""Replay of unstable motions: the planned torques with a small feedback.

An arm that is raised slowly is a chain of inverted pendulums: over seconds it amplifies
all errors, rounding errors included, by a factor of 10^10 and more, and no open-loop
torque brings it to the goal, neither in simulation nor in reality. A motion of this
kind is verified by showing that its torques need very little feedback. The replay is
then the motion of the arm under the torques of the plan and of the feedback, and is
judged like any other replay; the feedback may use only a small share of the limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import expm

from tominpmp.arrays import Array
from tominpmp.motion.trajectory import Trajectory, torque_breaks
from tominpmp.motion_limits import FEEDBACK
from tominpmp.options import Tolerances
from tominpmp.robot.robot import Robot
from tominpmp.stopping import check
from tominpmp.verification.limit_violations import Excesses, LimitViolation
from tominpmp.verification.plant import Plant
from tominpmp.verification.polynomials import Pieces
from tominpmp.verification.replay import RTOL, Integration, Integrator, Replay

# Rate of the feedback as a multiple of the growth rate of errors, and its least value
# [1/s].
RATE_FACTOR = 4.0
LEAST_RATE = 20.0
# Share of the tolerated excess over the torque limits that the feedback may use.
FEEDBACK_SHARE = 0.2
# Share of the tolerance at the goal below which amplified integration errors are
# negligible.
NEGLIGIBLE = 0.1
# Factor by which the integration tolerances are tightened to test whether the end of a
# replay depends on them.
TIGHTER = 10.0


class TrackingPlant(Plant):
    """A robot under the planned torques and a feedback of position and velocity.

    The integrated state is the deviation from the plan. It stays small, so that its
    integration takes steps many times as long as an explicit integration of the state
    of the robot, which is stiff with a fast feedback. The polynomials hold the torques
    of the plan, its states and their derivatives, 5n in all. The feedback acts on the
    accelerations and places a double pole at ``-rate``.
    """

    def __init__(self, robot: Robot, rate: float) -> None:
        super().__init__(robot)
        self._rate = rate
        self._plan = np.zeros(5 * robot.n)

    def torque(self, t: float) -> Array:
        """Torque of :class:`Plant` at the time of the last state, shape (n,)."""
        return self._plan[: self._n]

    def state(self, t: float, x: Array) -> Array:
        """State of the robot: the state of the plan plus the deviation, shape (2n,)."""
        self._plan = super().torque(t)
        return self._plan[self._n : 3 * self._n] + x

    def free(self, t: float, x: Array) -> Array:
        """State derivative with the feedback, without held joints, shape (2n,)."""
        out = super().free(t, self.state(t, x))
        out[self._n :] += _correction(x, self._rate)
        return out

    def free_jacobian(self, t: float, x: Array) -> Array:
        """Jacobian of :meth:`free` with respect to the deviation, shape (2n, 2n)."""
        out = super().free_jacobian(t, self.state(t, x))
        # The feedback is linear.
        out[self._n :] += _correction(np.eye(2 * self._n), self._rate).T
        return out

    def slope(self, t: float, x: Array) -> Array:
        """Time derivative of the deviation, shape (2n,)."""
        return super().slope(t, x) - self._plan[3 * self._n :]


def _correction(error: Array, rate: float) -> Array:
    """Acceleration that the feedback adds for a tracking error, shape (..., n).

    Args:
        error: Deviation from the plan, shape (..., 2n).
        rate: Rate of the feedback [1/s].
    """
    n = error.shape[-1] // 2
    return np.asarray(-rate * (rate * error[..., :n] + 2.0 * error[..., n:]))


class Tracking(Integration):
    """Integration of the torques of a trajectory with feedback.

    Args:
        plants: The robots of the segments.
        trajectory: The planned motion.
        rate: Rate of the feedback [1/s].
        integrator: Name of the integrator; None for LSODA.

    Attributes:
        feedback: Feedback torques at the times of the replay, shape (m, n) [N m or N];
            set by :meth:`run`.
    """

    feedback: Array
    # With feedback errors do not grow, and deviations stay small: the first step may
    # take a whole piece, and an error of a nanoradian is small enough.
    lsoda_tightness, long_first_step, atol = 1.0, True, 1e-9

    def __init__(
        self,
        plants: Sequence[Plant],
        trajectory: Trajectory,
        rate: float,
        integrator: Integrator | None,
    ) -> None:
        def curve(times: Array) -> Array:
            q, v, a, u = trajectory(times)
            return np.concatenate([u, q, v, v, a], axis=1)

        robots, self._rate = [plant.robot for plant in plants], rate
        pieces = Pieces.of(curve, torque_breaks(trajectory, robots[0].friction))
        tracking = [TrackingPlant(robot, rate) for robot in robots]
        super().__init__(tracking, trajectory, pieces, integrator)

    def run(self, start: Array) -> Replay:
        """Integrate from a state of shape (2n,) to the end; u includes the feedback."""
        out, n = super().run(start), start.size // 2
        plan, segment = out.u[:, n : 3 * n], self._trajectory.segment_at(out.t)
        added = _correction(np.hstack([out.q, out.v]) - plan, self._rate)
        self.feedback = np.zeros_like(added)
        for k, plant in enumerate(self.plants):
            check()
            rows = segment == k
            self.feedback[rows] = plant.dynamics.inertial(out.q[rows], added[rows])
        return replace(out, u=out.u[:, :n] + self.feedback)

    def excesses(self, t: Array, tolerance: float) -> list[LimitViolation]:
        """Excess of the feedback over the share of the torque limits it may use.

        Args:
            t: Times of the replay [s], shape (m,).
            tolerance: Tolerated excess over the torque limits, as a share of their
                range.

        Returns:
            The excess of the worst joint; empty without torque limits.
        """
        robot = self.plants[0].robot
        span = robot.limits.effort_upper - robot.limits.effort_lower
        excess = np.abs(self.feedback) - FEEDBACK_SHARE * tolerance * span
        return Excesses.of_joints(robot, FEEDBACK, t, excess, span).worst(0.0)

    def _piece(self, k: int, x: Array, times: Array) -> tuple[Array, Array]:
        """Integrate the deviation over a piece, and add the plan."""
        plan = self.pieces.on(k, times)[:, x.size // 2 : 3 * x.size // 2]
        rows, way = super()._piece(k, x - plan[0], times)
        return rows + plan[1 : 1 + len(rows)], way


def amplification(plants: Sequence[Plant], trajectory: Trajectory) -> float:
    """Largest amplification of a small error along a motion, to first order.

    Args:
        plants: The robots of the segments of the motion.
        trajectory: The motion.

    Returns:
        The largest ratio of the error at a node to the error at an earlier node, in the
        norm of positions and velocities times a tenth of a second. Infinite if the
        numbers overflow.
    """
    n, t = trajectory.n, trajectory.t
    times = 0.5 * (t[1:] + t[:-1])
    middle = trajectory(times)
    states = np.concatenate([middle.q, middle.v], axis=1)
    slopes, segment = np.zeros((times.size, 2 * n, 2 * n)), trajectory.segment_at(times)
    for k, plant in enumerate(plants):
        rows = segment == k
        found = plant.dynamics.forward_jacobians(states[rows], middle.u[rows])
        slopes[rows] = found.f_x
    scale = np.concatenate([np.ones(n), np.full(n, 0.1)])
    largest, from_start = 1.0, np.eye(2 * n)
    with np.errstate(all="ignore"):
        transitions = expm(slopes * np.diff(t)[:, None, None])
        for transition in transitions * scale[:, None] / scale:
            # Where errors have decayed, the product starts again: from there, errors
            # that arise at later nodes grow more than earlier errors.
            from_start = transition @ from_start
            finite = np.isfinite(from_start).all()
            size = np.linalg.svd(from_start, compute_uv=False)[0] if finite else 0.0
            if not size > 0.0:
                return np.inf
            largest = max(largest, size)
            if size < 1.0:
                from_start = np.eye(2 * n)
    return float(largest)


def errors_matter(
    growth: float, tolerance: float, error: float, share: float = NEGLIGIBLE
) -> bool:
    """Whether amplified integration errors may matter at the goal.

    Args:
        growth: Amplification of errors, see :func:`amplification`.
        tolerance: Tolerance at the goal [rad or m].
        error: Errors of the integration, as a share of the growth [rad or m].
        share: Share of the tolerance above which errors matter.
    """
    return not growth * error < share * tolerance


def ends_agree(coarse: Replay, fine: Replay, tolerances: Tolerances) -> bool:
    """Whether two replays with different integration tolerances have the same end.

    Args:
        coarse: The replay with the usual integration tolerances.
        fine: The replay with tighter integration tolerances.
        tolerances: Tolerances at the goal.
    """
    gaps = np.abs([coarse.q[-1] - fine.q[-1], coarse.v[-1] - fine.v[-1]])
    allowed = NEGLIGIBLE * np.array([[tolerances.goal], [tolerances.speed]])
    return coarse.complete and fine.complete and bool(np.all(gaps <= allowed))


def feedback_rate(growth: float, duration: float, tolerance: float) -> float | None:
    """Rate of the feedback that a replay needs [1/s]; None without feedback.

    Args:
        growth: Amplification of errors, see :func:`amplification`.
        duration: Duration of the motion [s].
        tolerance: Tolerance at the goal [rad or m].
    """
    if not errors_matter(growth, tolerance, RTOL):
        return None
    growth_rate = np.log(min(growth, 1e300)) / duration
    return float(max(RATE_FACTOR * growth_rate, LEAST_RATE))
