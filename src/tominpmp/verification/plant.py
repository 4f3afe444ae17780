"""The robot of a replay.

The direction in which a joint with dry friction slides, or that friction holds it, is a
part of the state: between two changes of it the equations of motion are smooth, see
``docs/friction.md``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, BoolArray
from tominpmp.dynamics import (
    HOLD_TOLERANCE,
    RobotDynamics,
    held_accelerations,
    slip_directions,
)
from tominpmp.robot.robot import Robot

Slope: TypeAlias = Callable[[float, Array], Array]
Curve: TypeAlias = Callable[[float], Array]

# Speed of a joint at rest [rad/s or m/s]: below the errors of an integration.
STILL = 1e-11
# Speed of a reversal between two rows that is neglected [rad/s or m/s].
GRAZE = 1e-8

# Instants of a piece at which it is checked that friction holds an arm at rest.
LOOKS = 30


class Plant:
    """State derivative of a robot under a polynomial of torque, one row at a time.

    Attributes:
        robot: The robot.
        dynamics: Its dynamics without dry friction.
        dry: Whether each joint has dry friction, shape (n,).
        way: Directions of these joints: 1, -1, or 0 for joints that friction holds, and
            for joints without friction, shape (n,).
        still: Speed of joints at rest [rad/s or m/s].
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.dynamics = RobotDynamics(robot, dry=False)
        self.dry: BoolArray = robot.friction > 0.0
        self.way = np.zeros(robot.n)
        self.still = STILL
        self._held = np.zeros(robot.n, dtype=bool)
        self._holds = False
        self._n, self._data = robot.n, robot.model.createData()
        self._exponents = np.zeros(0)
        self._given = self.coefficients = np.zeros((robot.n, 0))
        self.begin, self.rate = 0.0, 1.0

    def load(self, begin: float, end: float, coefficients: Array) -> None:
        """Replace the torque by that of another piece."""
        self._given = self.coefficients = coefficients
        self.begin, self.rate = begin, 2.0 / (end - begin)
        self._exponents = np.arange(float(coefficients.shape[1]))
        self.way = np.zeros(self._n)

    def torque(self, t: float) -> Array:
        """Torque less the friction of sliding joints, shape (n,)."""
        s = (t - self.begin) * self.rate - 1.0
        return np.asarray(self.coefficients.dot(s**self._exponents))

    def state(self, t: float, x: Array) -> Array:
        """Positions and velocities for an integrated vector, shape (2n,)."""
        return x

    def free(self, t: float, x: Array) -> Array:
        """Derivative of positions and velocities for free joints, shape (2n,)."""
        robot, n = self.robot, self._n
        if robot.kinematic or robot.expansion_matrix is not None:
            return np.asarray(self.dynamics.forward(x[None], self.torque(t)[None])[0])
        # Without the handling of many rows, which takes longer than the dynamics.
        out, v = np.empty(2 * n), x[n:]
        out[:n] = v
        force = self.torque(t) - robot.damping * v
        out[n:] = pin.aba(robot.model, self._data, x[:n], v, force)
        return out

    def free_jacobian(self, t: float, x: Array) -> Array:
        """Derivative of :meth:`free` with respect to x, shape (2n, 2n)."""
        u = self.torque(t)[None]
        return np.asarray(self.dynamics.forward_jacobians(x[None], u).f_x[0])

    def slope(self, t: float, x: Array) -> Array:
        """dx/dt, shape (2n,)."""
        return self._kept(t, x, self.free(t, x))

    def jacobian(self, t: float, x: Array) -> Array:
        """Derivative of dx/dt with respect to x, shape (2n, 2n)."""
        return self._kept(t, x, self.free_jacobian(t, x))

    def _kept(self, t: float, x: Array, free: Array) -> Array:
        """A derivative with joints that friction holds at rest."""
        if self._holds:
            n, a = self._n, free.reshape(2 * self._n, -1)
            a[n:] = held_accelerations(self._mass(t, x), a[n:], self._held)
        return free

    def _mass(self, t: float, x: Array) -> Array:
        q = self.state(t, x)[None, : self._n]
        return np.asarray(self.dynamics.mass(q)[0])

    def settle(self, t: float, x: Array) -> Array:
        """Determine the joints that slide from here on, and those that friction holds.

        Args:
            t: The time [s].
            x: The integrated vector, shape (2n,).

        Returns:
            The vector with velocity zero for joints that have stopped.
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
            sets_out = slip_directions(mass, mass @ a, self.robot.friction, resting)
            self._slide(self.way + sets_out)
        self._held = self.dry & (self.way == 0.0)
        self._holds = bool(self._held.any())
        return x

    def _slide(self, way: Array) -> None:
        """Let friction act against the directions of the joints."""
        self.way, self.coefficients = way, np.array(self._given)
        self.coefficients[: self._n, 0] -= self.robot.friction * way

    def changes(self, begin: float, end: float, curve: Curve) -> float:
        """Time of the first change in a step: a joint stops, or friction releases it.

        Args:
            begin: Begin of the step [s].
            end: End of the step [s].
            curve: The integrated vector over time.

        Returns:
            The time just after the change; the end of the step without a change.
        """
        if not self.dry.any():
            return end

        early, late = begin, end
        step = np.array([begin, end]), np.array([curve(begin), curve(end)])
        if self.unchanged(*step):
            return end
        while early < (middle := 0.5 * (early + late)) < late:
            if self._room(middle, curve(middle)) < 0.0:
                late = middle
            else:
                early = middle
        return late

    def unchanged(self, t: Array, x: Array) -> int:
        """Number of rows of a motion before a joint stops, or friction releases it.

        Args:
            t: Times [s], from the last :meth:`settle` on, shape (m + 1,).
            x: The integrated vector there; fewer rows after a failure, (k + 1, 2n).

        Returns:
            Number of valid rows among the k rows.
        """
        count = len(x) - 1
        if not self.dry.any():
            return count
        t = t[: count + 1]
        state = np.array([self.state(*row) for row in zip(t.tolist(), x, strict=True)])
        q, v = state[:, : self._n], state[:, self._n :]
        # By Simpson's rule, halfway between two rows.
        halfway = 1.5 * np.diff(q, axis=0) / np.diff(t)[:, None]
        halfway -= 0.25 * (v[1:] + v[:-1])
        slowest = np.minimum(self.way * v[1:] + self.still, self.way * halfway + GRAZE)
        back = np.flatnonzero((slowest < 0.0).any(axis=1))
        count = int(back[0]) if back.size else count
        rows = np.arange(count if self._holds else 0)
        if not v.any():  # torques of an arm at rest are polynomials
            rows = np.unique(np.linspace(0, count - 1, LOOKS).astype(int))
        good = 0
        for k in rows.tolist():
            if self._room(t[k + 1], x[k + 1]) < 0.0:
                return good
            good = k + 1
        return count

    def _room(self, t: float, x: Array) -> float:
        """Margin of joints to a reversal, and of friction to a release."""
        v = self.state(t, x)[self._n :]
        back = float((self.way * v).min()) + self.still
        if back < 0.0 or not self._holds:
            return back
        free, mass = self.free(t, x)[self._n :, None], self._mass(t, x)
        needed = mass @ (free - held_accelerations(mass, free, self._held))
        # A trace more than the torque that starts joints, so that they start.
        rest = (1.0 + 2.0 * HOLD_TOLERANCE) * self.robot.friction - np.abs(needed[:, 0])
        return min(back, float(rest[self._held].min()))
