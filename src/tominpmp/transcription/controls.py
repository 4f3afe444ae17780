"""Piecewise constant torques (the paper's equation 16) as unknowns.

The unknowns are motor torques less dry friction, so that their limits depend on the
sign of the joint velocity.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import Partials, States
from tominpmp.constraints.friction import EFFORT_TOLERANCE, Signs, interval_signs
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.base import Transcription, Variation
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.integrator import SteppedMotion, stage_weights
from tominpmp.transcription.problem_functions import ProblemFunctions

# Scale of velocities, as a multiple of the scale of positions over the duration.
SPEED_FACTOR = 5.0


class TorqueTranscription(Transcription[SteppedMotion]):
    """A problem whose torques are unknowns, as shares of their limits in [-1, 1].

    The last unknowns are the torques of N intervals, and eta with the lengths of the
    intervals h = H eta: the matrix H of shares has one column (scaling of a given grid)
    or more. The torques are motor torques less dry friction.

    Attributes:
        system: The functions of the problem.
        shares: Matrix H, shape (N, m): lengths of the intervals [s] per unit of eta.
        duration: Duration that scales velocities [s].
        signs: Velocity signs of joints with dry friction on the intervals; None without
            friction, or before they are taken from a motion.
    """

    inspected = ((0.1, 0.5, 0.9),)
    signs: Signs | None = None

    def __init__(
        self, system: ProblemFunctions, shares: Array, duration: float
    ) -> None:
        super().__init__(system, shares)
        self.duration = duration

    def with_signs(self, duration: float, signs: Signs) -> TorqueTranscription:
        """The transcription with velocity scales of a duration, and given signs."""
        signed = copy(self)  # the signs change the bounds of torques, but no motion
        signed.duration, signed.signs = duration, signs
        return signed

    @property
    def _torques(self) -> slice:
        """Slice of the torque shares in the unknowns."""
        end = self.size - self._m
        return slice(end - self.intervals * self._n, end)

    def shares_at(self, z: Array) -> Array:
        """Torques as shares of their limits, shape (N, n)."""
        return z[self._torques].reshape(self.intervals, self._n)

    def torques(self, z: Array) -> Array:
        """Torques without dry friction, shape (N, n) [N m or N]."""
        share = self.shares_at(z)
        return self.system.effort_middle + self.system.effort_half * share

    def lengths(self, z: Array) -> Array:
        """Lengths of the intervals [s], shape (N,)."""
        return np.asarray(self.shares @ z[-self._m :])

    @property
    def torque_bounds(self) -> tuple[Array, Array]:
        """Bounds of the torque shares, shape (N, n) each."""
        if self.signs is None:
            ones = np.ones((self.intervals, self._n))
            return -ones, ones
        return self.signs.lower, self.signs.upper

    def torque_steps(self, z: Array, largest: Array) -> tuple[Array, Array]:
        """Lower and upper bounds of the step of the torque shares, shape (N, n) each.

        The bounds are zero for joints without a motor.

        Args:
            z: Iterate.
            largest: Largest step of each joint, in shares, shape (n,).
        """
        shares, (low, high) = self.shares_at(z), self.torque_bounds
        driven, most = self.system.driven, np.zeros(self._n)
        most[driven] = largest[driven]
        return np.clip(low - shares, -most, 0.0), np.clip(high - shares, 0.0, most)

    def with_signs_of(self, z: Array) -> tuple[TorqueTranscription, Array] | None:
        """The transcription with the velocity signs of an iterate, which is clipped.

        None if the assumed signs are consistent with the iterate.
        """
        motion = self.motion(z)
        if self.system.friction is None or not motion.finite:
            return None
        known, v, shares = self.signs, motion.x[:, self._n :], self.shares_at(z)
        # Friction is left out until signs are known.
        signs = _new_signs(known, v, shares) if known else self.first_signs(v)
        if signs is None:
            return None
        out = z.copy()
        out[self._torques] = np.clip(shares, signs.lower, signs.upper).ravel()
        return self.with_signs(float(self.cost @ z), signs), out

    def first_signs(self, v: Array) -> Signs:
        """Signs on N intervals from velocities at their nodes, shape (N + 1, n)."""
        friction = self.system.friction
        assert friction is not None  # noqa: S101
        sign, change = interval_signs(v)
        signs = Signs.of(friction, sign)
        return replace(signs, both=change & (friction > 0.0))

    def instants(self, order: int, field: str) -> Instants:
        """Nodes; both ends of the intervals for accelerations, which jump there."""
        return Instants.spread(self.intervals, (0.0, 1.0) if order >= 2 else (1.0,))

    def states(self, motion: SteppedMotion, at: Instants, order: int) -> States:
        """States at instants."""
        n, x, u = self._n, motion.states(at), motion.u[at.interval]
        a = np.zeros((0, n))
        if order >= 2:
            a = self.system.dynamics.forward(x, u)[:, n:]
        return States(at.times(motion.h), x[:, :n], x[:, n:], a, u)

    def by_steps(
        self, motion: SteppedMotion, at: Instants, partials: Partials
    ) -> tuple[IntArray, Array]:
        """Derivatives of k values by the ends, the torque and the length of a step.

        Accelerations are eliminated by the forward dynamics.

        Returns:
            The step of each value, shape (k,), and the derivatives, shape (k, 5n + 1).
        """
        n, here = self._n, at[partials.at]
        by_x, by_u = np.zeros((here.size, 2 * n)), np.zeros((here.size, n))
        parts = partials.by_q, partials.by_v, partials.by_u
        targets = by_x[:, :n], by_x[:, n:], by_u
        for part, target in zip(parts, targets, strict=True):
            if part is not None:
                target += part
        if partials.by_a is not None:
            x, u = motion.states(here), motion.u[here.interval]
            slopes = self.system.dynamics.forward_jacobians(x, u)
            by_x += np.einsum("kj,kji->ki", partials.by_a, slopes.f_x[:, n:])
            by_u += np.einsum("kj,kji->ki", partials.by_a, slopes.f_u[:, n:])
        step, share = motion.steps(here)
        weights = stage_weights(share)
        by_ends = weights[:, :1] * by_x, weights[:, 2:] * by_x
        data = np.concatenate([*by_ends, by_u, np.zeros((here.size, 1))], axis=1)
        if np.any(weights[:, 1]):
            inner = motion.derivatives.inner[step]
            data += weights[:, 1:2] * np.einsum("kj,kji->ki", by_x, inner)
        return step, data

    def variation(self, z: Array) -> Variation:
        """Jumps of the torques between intervals, in full ranges."""
        unknown = np.arange(self.size)[self._torques].reshape(self.intervals, self._n)
        driven = unknown[:, self.system.driven]
        unit = sp.identity(self.size, format="csr")
        jumps = 0.5 * (unit[driven[1:].ravel()] - unit[driven[:-1].ravel()])
        return Variation(jumps, np.zeros(jumps.shape[0]))

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate, by Hermite interpolation between its nodes.

        Its torques are motor torques: it has additional nodes where joints with dry
        friction reverse. An assumed sign counts only where a joint rests: elsewhere
        that of the motion may differ, as long as no torque exceeds its limit.
        """
        motion, n = self.motion(z), self._n
        held = Trajectory(
            joint_names=self.system.problem.robot.joint_names,
            t=np.concatenate([[0.0], np.cumsum(motion.h)]),
            q=motion.x[:, :n],
            v=motion.x[:, n:],
            u=np.concatenate([motion.u, motion.u[-1:]]),
            holding=self.system.dynamics.inverse,
        )
        if self.system.friction is None:
            return held
        friction, signs = self.system.problem.robot.friction, self.signs
        t = np.sort(np.concatenate([held.t, held.turns.of_joints(friction > 0.0)]))
        middle = 0.5 * (t[1:] + t[:-1])
        sign = held.turns.at(middle)
        if signs is not None:
            index = np.searchsorted(held.t, middle) - 1
            sign = np.where(sign == 0.0, signs.sign[index], sign)
        u, nodes = held(middle).u + friction * sign, held(t)
        return replace(held, t=t, q=nodes.q, v=nodes.v, u=np.vstack([u, u[-1:]]))


def scale_of_goal(system: ProblemFunctions, duration: float) -> Array:
    """Scale of the goal residual at the end of a shot, shape (k,).

    The velocities, of joints or of a frame, come last.

    Args:
        system: The functions of the problem.
        duration: Duration that scales velocities [s].
    """
    scale, speed = np.ones(system.goal_bounds[0].size), SPEED_FACTOR / duration
    if system.final_velocity is None:
        scale[-3:] = speed
    else:
        scale[-system.n :] = speed * system.step_scale
    return scale


def _new_signs(signs: Signs, v: Array, shares: Array) -> Signs | None:
    """Velocity signs on the intervals of a motion, if they affect a torque limit.

    Args:
        signs: Assumed signs on N intervals.
        v: Velocities at the nodes, shape (N + 1, n) [rad/s or m/s].
        shares: Torques without friction as shares of their limits, shape (N, n).

    Returns:
        The signs; None if the assumed signs are consistent with the motion.
    """
    sign, change = interval_signs(v)
    # A joint that reverses within an interval has both signs there.
    wrong = signs.wrong(np.where(change, 1.0, sign), shares, EFFORT_TOLERANCE)
    wrong |= signs.wrong(np.where(change, -1.0, sign), shares, EFFORT_TOLERANCE)
    if not wrong.any():
        return None
    new = signs.corrected(sign, wrong)
    # Torques on this interval must then be within the limits for both signs.
    both = new.both | (change & (signs.friction > 0.0))
    return replace(new, sign=np.where(both, 0.0, new.sign), both=both)
