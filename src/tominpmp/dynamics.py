r"""Equations of motion of a robot with viscous and dry friction.

.. math:: M(q) \dot v + C(q, v) v + g(q) + D v + F \mathrm{sgn}(v) \ni u

This is the paper's :math:`\dot x = f(x, u)` (equation 2) with the state x = (q, v).
Pinocchio evaluates both directions and their derivatives (Featherstone, 2008;
Carpentier and Mansard, 2018); friction, which its algorithms leave out, is added here.
The sign is Coulomb's: a joint at rest stays at rest as long as its friction, up to F in
either direction, can hold it. Joints that follow others (mimic) enter through the
expansion matrix S of the robot: the torque of the free joints is S^T times the torque
of all joints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeVar

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dposv

from tominpmp.arrays import Array, BoolArray
from tominpmp.stopping import check

if TYPE_CHECKING:
    from tominpmp.robot.robot import Robot

# Joints slower than STANDSTILL [rad/s or m/s] are at rest if they accelerate by less
# than STEADY [rad/s^2 or m/s^2]; with larger accelerations they are starting or
# stopping.
STANDSTILL = 1e-6
STEADY = 1e-6
# Below this speed only rounding separates a joint from rest [rad/s or m/s]: the sign of
# its acceleration then gives its direction.
RESTING = 1e-10
# Number of rows after which the deadline is checked.
CHECK_PERIOD = 5_000
# Share of its dry friction by which a joint may exceed it and still be held: rounding.
HOLD_TOLERANCE = 1e-9

_Row = TypeVar("_Row")


class ForwardJacobians(NamedTuple):
    """State derivative and its partial derivatives, one row per evaluation point.

    Attributes:
        f: dx/dt with x = (q, v), shape (m, 2n).
        f_x: Derivatives by the state, shape (m, 2n, 2n).
        f_u: Derivatives by the torque, shape (m, 2n, n).
    """

    f: Array
    f_x: Array
    f_u: Array


class InverseJacobians(NamedTuple):
    """Torque and its partial derivatives, one row per evaluation point.

    Attributes:
        tau: Torques, shape (m, n) [N m or N].
        tau_q: Derivatives by positions, shape (m, n, n).
        tau_v: Derivatives by velocities, shape (m, n, n).
        tau_a: Derivatives by accelerations: the mass matrices, shape (m, n, n).
    """

    tau: Array
    tau_q: Array
    tau_v: Array
    tau_a: Array


class Dynamics(Protocol):
    """Interface of a mechanical system that transcriptions use."""

    @property
    def n(self) -> int:
        """Number of degrees of freedom."""

    def forward(self, x: Array, u: Array) -> Array:
        """State derivative f(x, u), shapes (m, 2n) and (m, n) to (m, 2n)."""

    def forward_jacobians(self, x: Array, u: Array) -> ForwardJacobians:
        """State derivative with its partial derivatives."""

    def inverse(self, q: Array, v: Array, a: Array) -> Array:
        """Torque for a motion, all shapes (m, n)."""

    def inverse_jacobians(self, q: Array, v: Array, a: Array) -> InverseJacobians:
        """Torque with its partial derivatives."""


def _interruptible(rows: Iterable[_Row]) -> Iterator[_Row]:
    """Rows, with a check of the deadline every few thousand of them."""
    for number, row in enumerate(rows, 1):
        if number % CHECK_PERIOD == 0:
            check()
        yield row


class RobotDynamics:
    """Dynamics of a robot, evaluated at rows of states.

    A kinematic robot has the dynamics of :class:`DoubleIntegrator`.

    Attributes:
        robot: The robot.
        friction: Dry friction of its joints, shape (n,) [N m or N]; None without any,
            or if torques mean the part that remains after friction is overcome.
    """

    def __new__(cls, robot: Robot, *, dry: bool = True) -> RobotDynamics:
        """Dynamics of the class that suits the robot."""
        return object.__new__(DoubleIntegrator if robot.kinematic else cls)

    def __init__(self, robot: Robot, *, dry: bool = True) -> None:
        self.robot = robot
        self.friction = robot.friction if dry and np.any(robot.friction) else None

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the arguments, as :meth:`__new__` takes them."""
        return partial(type(self), dry=self.friction is not None), (self.robot,)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    def inverse(self, q: Array, v: Array, a: Array) -> Array:
        """Torque for a motion.

        Dry friction acts against the motion; where a joint is at rest, against the
        motion that is about to begin.

        Args:
            q: Positions, shape (m, n) [rad or m].
            v: Velocities, shape (m, n).
            a: Accelerations, shape (m, n).

        Returns:
            Torques, shape (m, n) [N m or N].
        """
        if self.friction is None:
            return self._smooth(q, v, a)  # the directions would be found for nothing
        return self.inverse_along(q, v, a, directions(v, a))

    def inverse_along(self, q: Array, v: Array, a: Array, signs: Array) -> Array:
        """Torque for a motion whose directions are known, however slow it may be.

        Args:
            q: Positions, shape (m, n) [rad or m].
            v: Velocities, shape (m, n).
            a: Accelerations, shape (m, n).
            signs: Direction of each joint: 1, -1, or 0 at rest, shape (m, n).

        Returns:
            Torques, shape (m, n) [N m or N].
        """
        tau = self._smooth(q, v, a)
        return tau if self.friction is None else tau + self.friction * signs

    def _states(self, q: Array, v: Array, a: Array) -> Iterable[tuple[Array, ...]]:
        """States of all joints of the model, one state at a time."""
        robot = self.robot
        rates = robot.expand_tangent(v), robot.expand_tangent(a)
        return zip(robot.expand(q), *rates, strict=True)

    def _smooth(self, q: Array, v: Array, a: Array) -> Array:
        robot, (model, data) = self.robot, self.robot._model_and_data
        rnea, rows = pin.rnea, self._states(q, v, a)
        tau = np.array([rnea(model, data, *row) for row in _interruptible(rows)])
        return robot.reduce_tangent(tau.reshape(-1, model.nv)) + robot.damping * v

    def inertial(self, q: Array, a: Array) -> Array:
        """Torque that accelerations need beyond the torque at rest: M(q) a.

        Args:
            q: Positions, shape (m, n).
            a: Accelerations, shape (m, n).

        Returns:
            Torques, shape (m, n) [N m or N].
        """
        return np.asarray((self.mass(q) @ a[:, :, None])[:, :, 0])

    def mass(self, q: Array) -> Array:
        """Mass matrices at positions of shape (m, n), shape (m, n, n)."""
        robot, (model, data) = self.robot, self.robot._model_and_data
        out = np.empty((len(q), model.nv, model.nv))
        for i, row in enumerate(_interruptible(robot.expand(q))):
            out[i] = pin.crba(model, data, row)
        return self._reduced(out)

    def _reduced(self, matrices: Array) -> Array:
        """Project matrices of all joints onto the free joints, shape (..., n, n)."""
        S = self.robot.expansion_matrix
        return matrices if S is None else np.asarray(S.T @ matrices @ S)

    def inverse_jacobians(self, q: Array, v: Array, a: Array) -> InverseJacobians:
        """Torque for a motion, with its derivatives.

        Dry friction contributes no derivatives: away from rest it is constant.

        Args:
            q: Positions, shape (m, n).
            v: Velocities, shape (m, n).
            a: Accelerations, shape (m, n).

        Returns:
            Torque and derivatives with respect to q, v and a.
        """
        robot, (model, data) = self.robot, self.robot._model_and_data
        m, nv = q.shape[0], model.nv
        tau = np.empty((m, nv))
        parts = np.empty((3, m, nv, nv))
        for i, row in enumerate(self._states(q, v, a)):
            by = pin.computeRNEADerivatives(model, data, *row)
            tau[i], (parts[0, i], parts[1, i], parts[2, i]) = data.tau, by
        parts = self._reduced(parts)
        parts[1] += np.diag(robot.damping)
        tau = robot.reduce_tangent(tau) + robot.damping * v
        if self.friction is not None:
            tau = tau + self.friction * directions(v, a)
        return InverseJacobians(tau, parts[0], parts[1], parts[2])

    def forward(self, x: Array, u: Array) -> Array:
        """State derivative.

        Args:
            x: States (q, v), shape (m, 2n).
            u: Torques without the part that dry friction takes, shape (m, n) [N m or
                N].

        Returns:
            dx/dt = (v, dv/dt), shape (m, 2n).
        """
        q, v = x[:, : self.n], x[:, self.n :]
        return np.concatenate([v, self._acceleration(q, v, u)], axis=1)

    def forward_along(self, q: Array, v: Array, u: Array, signs: Array) -> Array:
        """Accelerations of joints with known directions, however slow they may be.

        Args:
            q: Positions, shape (m, n) [rad or m].
            v: Velocities, shape (m, n).
            u: Torques, shape (m, n) [N m or N].
            signs: Direction of each joint with dry friction: 1, -1, or 0 for joints
                that the friction holds, shape (m, n).

        Returns:
            Accelerations, shape (m, n).
        """
        F = self.robot.friction
        a, held = self._acceleration(q, v, u - F * signs), (signs == 0.0) & (F > 0.0)
        for pattern in np.unique(held[held.any(axis=1)], axis=0):
            rows = np.flatnonzero((held == pattern).all(axis=1))
            mass = self.mass(q[rows])
            a[rows] = held_accelerations(mass, a[rows][..., None], pattern)[..., 0]
        return a

    def _acceleration(self, q: Array, v: Array, u: Array) -> Array:
        robot, (model, data) = self.robot, self.robot._model_and_data
        if robot.expansion_matrix is not None or robot.kinematic:
            rest = u - self._smooth(q, v, np.zeros_like(v))
            return np.asarray(np.linalg.solve(self.mass(q), rest[..., None])[..., 0])
        aba, force = pin.aba, u - robot.damping * v
        rows = _interruptible(zip(q, v, force, strict=True))
        return np.array([aba(model, data, *row) for row in rows]).reshape(q.shape)

    def acceleration_at(self, q: Array, v: Array, u: Array) -> Array:
        """Accelerations at a single state, without the overhead of a batch of rows.

        Integrators ask for one state at a time. For many states a batch is faster, as
        its algebra is done for all rows together.

        Args:
            q: Positions, shape (n,) [rad or m].
            v: Velocities, shape (n,).
            u: Torques without the part that dry friction takes, shape (n,) [N m or N].

        Returns:
            Accelerations, shape (n,).
        """
        robot, (model, data) = self.robot, self.robot._model_and_data
        force = u - robot.damping * v
        S, offset = robot.expansion_matrix, robot.expansion_offset
        if S is None or offset is None:
            return np.asarray(pin.aba(model, data, q, v, force))
        row = S @ q + offset
        bias = pin.nonLinearEffects(model, data, row, S @ v) @ S
        mass = S.T @ pin.crba(model, data, row) @ S
        return np.asarray(dposv(mass, force - bias)[1])

    def forward_jacobians(self, x: Array, u: Array) -> ForwardJacobians:
        r"""State derivative with its partial derivatives.

        By the implicit function theorem on the inverse dynamics,
        :math:`\dot v_q = -M^{-1} \tau_q`, :math:`\dot v_v = -M^{-1} \tau_v` and
        :math:`\dot v_u = M^{-1}`; for robots without mimic joints that have torques,
        Pinocchio's derivatives of ABA, which need no solve, are used.

        Args:
            x: States (q, v), shape (m, 2n).
            u: Torques without the part that dry friction takes, shape (m, n).

        Returns:
            f, f_x and f_u.
        """
        robot, (model, data) = self.robot, self.robot._model_and_data
        n, m = self.n, x.shape[0]
        q, v = x[:, :n], x[:, n:]
        f_x = np.zeros((m, 2 * n, 2 * n))
        f_u = np.zeros((m, 2 * n, n))
        f_x[:, :n, n:] = np.eye(n)
        by_q, by_v, by_u = f_x[:, n:, :n], f_x[:, n:, n:], f_u[:, n:]  # to be filled
        if robot.expansion_matrix is not None or robot.kinematic:
            a = self._acceleration(q, v, u)
            parts = self.inverse_jacobians(q, v, a)
            by_u[:] = np.linalg.inv(parts.tau_a)
            by_q[:], by_v[:] = -by_u @ parts.tau_q, -by_u @ parts.tau_v
        else:
            a, force = np.empty_like(q), u - robot.damping * v
            for i, row in enumerate(zip(q, v, force, strict=True)):
                by = pin.computeABADerivatives(model, data, *row)
                a[i], (by_q[i], by_v[i], by_u[i]) = data.ddq, by
            # The friction is a torque -D v, which accelerates by the inverse mass.
            by_v -= by_u * robot.damping
        return ForwardJacobians(np.concatenate([v, a], axis=1), f_x, f_u)


class DoubleIntegrator(RobotDynamics):
    """Dynamics of a kinematic robot: decoupled joints of unit inertia.

    Its controls are accelerations instead of torques.
    """

    def _smooth(self, q: Array, v: Array, a: Array) -> Array:
        return np.array(a)

    def mass(self, q: Array) -> Array:
        """Unit matrices, shape (m, n, n)."""
        return np.tile(np.eye(self.n), (len(q), 1, 1))

    def inverse_jacobians(self, q: Array, v: Array, a: Array) -> InverseJacobians:
        """The accelerations, and their derivatives: zero by q and v, identity by a."""
        none = np.zeros((len(q), self.n, self.n))
        return InverseJacobians(np.array(a), none, none, self.mass(q))

    def acceleration_at(self, q: Array, v: Array, u: Array) -> Array:
        """The controls, shape (n,)."""
        return u


def unknown_torques(q: Array, v: Array, a: Array) -> Array:
    """Inverse dynamics of a motion with unknown torques: NaN, shape (m, n)."""
    return np.full(np.shape(a), np.nan)


def torques_of(robot: Robot) -> Callable[[Array, Array, Array], Array]:
    """Inverse dynamics that gives the torques of a motion of a robot."""
    return unknown_torques if robot.kinematic else RobotDynamics(robot).inverse


def directions(v: Array, a: Array) -> Array:
    """Directions in which joints move, or are about to move if they are at rest.

    Args:
        v: Velocities, shape (m, n) [rad/s or m/s].
        a: Accelerations at these velocities or just afterwards, shape (m, n).

    Returns:
        1, -1, or 0 for joints that remain at rest, shape (m, n).
    """
    signs = np.where(np.abs(v) > RESTING, np.sign(v), np.sign(a))
    resting = (np.abs(v) <= STANDSTILL) & (np.abs(a) <= STEADY)
    return np.where(resting, 0.0, signs)


def held_accelerations(mass: Array, free: Array, held: BoolArray) -> Array:
    """Accelerations when some joints are held against the forces of the others.

    Args:
        mass: Mass matrices, shape (..., n, n).
        free: Accelerations with no joint held, or their derivatives, shape (..., n, k).
        held: Which joints are held, shape (n,).
    """
    out, loose = np.zeros_like(free), np.flatnonzero(~held)
    force = (mass @ free)[..., loose, :]
    out[..., loose, :] = np.linalg.solve(mass[..., loose[:, None], loose], force)
    return out


def slip_directions(mass: Array, force: Array, F: Array, resting: BoolArray) -> Array:
    """Directions of the joints at rest whose dry friction cannot hold them.

    This is a linear complementarity problem. Joints are released, or held again, one at
    a time, always the first one that violates Coulomb's law; the iteration is finite,
    and ends at the only solution (Murty, 1974).

    Args:
        mass: Mass matrix, shape (n, n).
        force: Accelerating torques without the friction of joints at rest, shape (n,).
        F: Largest dry friction, shape (n,) [N m or N].
        resting: Which joints are at rest and have dry friction, shape (n,).

    Returns:
        1 or -1 for joints that begin to move, 0 for all others, shape (n,).
    """
    signs = np.zeros_like(force)
    while True:
        held, accelerating = resting & (signs == 0.0), force - F * signs
        loose = np.flatnonzero(~held)
        a = np.zeros_like(force)
        a[loose] = np.linalg.solve(mass[np.ix_(loose, loose)], accelerating[loose])
        needed = accelerating - mass @ a
        slips = held & (np.abs(needed) > (1.0 + HOLD_TOLERANCE) * F)
        wrong = np.flatnonzero(slips | (resting & (signs * a < 0.0)))
        if not wrong.size:
            return signs
        signs[wrong[0]] = np.sign(needed[wrong[0]]) if held[wrong[0]] else 0.0
