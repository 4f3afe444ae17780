"""The robot of a replay, as a hybrid system.

For each joint with dry friction the direction in which it slides, or the fact that
friction holds it, is a discrete state: between two changes of the discrete state the
equations of motion are smooth, see ``docs/friction.md``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.dynamics import (
    HOLD_TOLERANCE,
    RobotDynamics,
    held_accelerations,
    slip_directions,
)
from tominpmp.robot.robot import Robot

Slope: TypeAlias = Callable[[float, Array], Array]
StateCurve: TypeAlias = Callable[[float], Array]

# Speed below which a joint is at rest [rad/s or m/s]: below the integration errors.
STILL = 1e-11
# Speed of a reversal between two rows below which it is neglected [rad/s or m/s].
GRAZE = 1e-8

# Number of instants of a piece at which the static friction of a resting arm is tested.
TESTED_INSTANTS = 30


class Plant:
    """State derivative of a robot under a polynomial of torque, one state at a time.

    Attributes:
        robot: The robot.
        begin: Beginning of the current piece of torque [s].
        rate: Derivative of the variable s of its polynomial, in [-1, 1], by time [1/s].
        coefficients: Coefficients of its polynomial in s, less the dry friction of
            sliding joints, shape (n, K).
        dynamics: Dynamics of the robot without dry friction.
        dry: Whether each joint has dry friction, shape (n,).
        way: Sliding direction of each joint with dry friction, 1 or -1; 0 for joints
            that friction holds, and for joints without dry friction, shape (n,).
        still: Speed below which a joint is at rest [rad/s or m/s].
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.dynamics = RobotDynamics(robot, dry=False)
        self.dry: BoolArray = robot.friction > 0.0
        self.still = STILL
        self._held = np.zeros(robot.n, dtype=bool)
        self._holds = False
        self._n = robot.n

    def load(self, begin: float, end: float, coefficients: Array) -> None:
        """Replace the torque by the polynomial of another piece.

        Args:
            begin: Start of the piece [s].
            end: End of the piece [s].
            coefficients: Coefficients of the polynomial, shape (n, K); more rows for
                :class:`~.feedback.TrackingPlant`.
        """
        self._given = self.coefficients = coefficients
        self.begin, self.rate = begin, 2.0 / (end - begin)
        self._exponents = np.arange(float(coefficients.shape[1]))
        self.way = np.zeros(self._n)

    def torque(self, t: float) -> Array:
        """Torque minus the dry friction of sliding joints, shape (n,)."""
        s = (t - self.begin) * self.rate - 1.0
        return np.asarray(self.coefficients.dot(s**self._exponents))

    def state(self, t: float, x: Array) -> Array:
        """Positions and velocities that belong to an integrated vector, shape (2n,)."""
        return x

    def free(self, t: float, x: Array) -> Array:
        """State derivative if friction holds no joint, shape (2n,)."""
        q, v = x[: self._n], x[self._n :]
        return np.concatenate([v, self.dynamics.acceleration_at(q, v, self.torque(t))])

    def free_jacobian(self, t: float, x: Array) -> Array:
        """Jacobian of :meth:`free` with respect to x, shape (2n, 2n)."""
        u = self.torque(t)[None]
        return np.asarray(self.dynamics.forward_jacobians(x[None], u).f_x[0])

    def slope(self, t: float, x: Array) -> Array:
        """State derivative dx/dt, shape (2n,)."""
        return self._with_held(t, x, self.free(t, x))

    def jacobian(self, t: float, x: Array) -> Array:
        """Jacobian of dx/dt with respect to x, shape (2n, 2n)."""
        return self._with_held(t, x, self.free_jacobian(t, x))

    def _with_held(self, t: float, x: Array, free: Array) -> Array:
        """A state derivative or its Jacobian, with joints that friction holds."""
        if self._holds:
            n, a = self._n, free.reshape(2 * self._n, -1)
            a[n:] = held_accelerations(self._mass(t, x), a[n:], self._held)
        return free

    def _mass(self, t: float, x: Array) -> Array:
        """Mass matrix at a state, shape (n, n)."""
        q = self.state(t, x)[None, : self._n]
        return np.asarray(self.dynamics.mass(q)[0])

    def settle(self, t: float, x: Array) -> Array:
        """Determine which joints slide from a state on, and which friction holds.

        Args:
            t: The time [s].
            x: The integrated vector, shape (2n,).

        Returns:
            The integrated vector, with velocity zero for joints that have stopped.
        """
        if not self.dry.any():
            return x
        n, v, x = self._n, self.state(t, x)[self._n :], np.array(x)
        stopped = (np.abs(v) <= self.still) | (self.way * v < 0.0)
        resting = self.dry & stopped
        x[n:] -= np.where(resting, v, 0.0)
        self._slide(np.where(self.dry & ~stopped, np.sign(v), 0.0))
        if resting.any():
            mass, a = self._mass(t, x), self.free(t, x)[n:]
            released = slip_directions(mass, mass @ a, self.robot.friction, resting)
            self._slide(self.way + released)
        self._held = self.dry & (self.way == 0.0)
        self._holds = bool(self._held.any())
        return x

    def _slide(self, way: Array) -> None:
        """Set the sliding directions of the joints, against which friction acts."""
        self.way, self.coefficients = way, np.array(self._given)
        self.coefficients[: self._n, 0] -= self.robot.friction * way

    def changes(self, begin: float, end: float, curve: StateCurve) -> float:
        """Time of the first event in a step: a joint stops, or friction releases it.

        Args:
            begin: Start of the step [s].
            end: End of the step [s].
            curve: The integrated vector as a function of time.

        Returns:
            The time just after the event; the end of the step without an event.
        """
        early, late = begin, end
        step = np.array([begin, end]), np.array([curve(begin), curve(end)])
        if self.unchanged(*step):
            return end
        while early < (middle := 0.5 * (early + late)) < late:
            if self._event_margins(np.array([middle]), curve(middle)[None]) < 0.0:
                late = middle
            else:
                early = middle
        return late

    def unchanged(self, t: Array, x: Array) -> int:
        """Number of rows before the first event: a joint stops, or is released.

        Args:
            t: Times [s], from the last :meth:`settle` on, shape (m + 1,).
            x: The integrated vector at the times, shape (k + 1, 2n); fewer rows than
                times after a failure.

        Returns:
            Number of valid rows among the k rows.
        """
        count = len(x) - 1
        if not self.dry.any():
            return count
        t = t[: count + 1]
        state = np.array([self.state(*row) for row in zip(t.tolist(), x, strict=True)])
        q, v = state[:, : self._n], state[:, self._n :]
        # Velocity halfway between two rows, by Simpson's rule.
        halfway = 1.5 * np.diff(q, axis=0) / np.diff(t)[:, None]
        halfway -= 0.25 * (v[1:] + v[:-1])
        slowest = np.minimum(self.way * v[1:] + self.still, self.way * halfway + GRAZE)
        back = np.flatnonzero((slowest < 0.0).any(axis=1))
        count = int(back[0]) if back.size else count
        if not (count and self._holds):
            return count
        tested = np.arange(1, count + 1)
        if not v.any():
            # Torques of a resting arm are smooth: some instants suffice.
            tested = 1 + np.linspace(0, count - 1, TESTED_INSTANTS).astype(int)
        late = np.flatnonzero(self._event_margins(t[tested], x[tested]) < 0.0)
        return int(np.append(0, tested)[late[0]]) if late.size else count

    def _event_margins(self, t: Array, x: Array) -> Array:
        """Margins to the next event, negative after it, shape (m,).

        The margin is the least speed of a sliding joint, or the least reserve of
        friction torque of a held joint, if that is less.
        """
        rows = [*zip(t.tolist(), x, strict=True)]
        state = np.array([self.state(*row) for row in rows])
        slowest = (self.way * state[:, self._n :]).min(axis=1) + self.still
        if not self._holds:
            return np.asarray(slowest)
        free = np.array([self.free(*row) for row in rows])[:, self._n :, None]
        mass = self.dynamics.mass(state[:, : self._n])
        needed = mass @ (free - held_accelerations(mass, free, self._held))
        # Slightly more than the friction by which joints are released, so that a joint
        # beyond the margin is released.
        most = (1.0 + 2.0 * HOLD_TOLERANCE) * self.robot.friction
        reserve = (most - np.abs(needed[..., 0]))[:, self._held]
        return np.asarray(np.minimum(slowest, reserve.min(axis=1)))
