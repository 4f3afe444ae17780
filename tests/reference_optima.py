r"""Minimum times that do not come from the library.

Closed forms for a mass on a rail, and the equations of motion of small mechanisms
written out by hand, with their derivatives. Bang-bang motions of these mechanisms are
found in bang_bang.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

Array = NDArray[np.float64]


# -- closed forms: one mass on a rail
# ----------------------------------------------------


def rail_time(
    distance: float,
    push: float,
    brake: float | None = None,
    *,
    start_speed: float = 0.0,
    end_speed: float = 0.0,
    top_speed: float = np.inf,
) -> float:
    """Minimum time of x'' = u with -brake <= u <= push and x' <= top_speed.

    Args:
        distance: Distance to the goal [m].
        push: Largest acceleration [m/s^2].
        brake: Largest deceleration [m/s^2]; as large as ``push`` if None.
        start_speed: Speed at the start [m/s].
        end_speed: Speed at the goal [m/s].
        top_speed: Speed limit in both directions [m/s].
    """
    brake = push if brake is None else brake
    v0, v1 = start_speed, end_speed
    # Distance within which the mass changes from the start speed to the end speed.
    rate = push if v1 > v0 else -brake
    if distance < (v1**2 - v0**2) / (2.0 * rate):
        # The mass passes the goal and approaches it from behind: the mirror image.
        distance, v0, v1, push, brake = -distance, -v0, -v1, brake, push
    peak = np.sqrt(
        (2.0 * push * brake * distance + brake * v0**2 + push * v1**2) / (push + brake)
    )
    if peak <= top_speed:
        return float((peak - v0) / push + (peak - v1) / brake)
    top = top_speed
    ramps = (top**2 - v0**2) / (2.0 * push) + (top**2 - v1**2) / (2.0 * brake)
    return float((top - v0) / push + (top - v1) / brake + (distance - ramps) / top)


def friction_time(
    distance: float,
    mass: float,
    friction: float,
    push: float,
    brake: float | None = None,
) -> float:
    """Minimum time from rest to rest with viscous friction.

    With the time constant m/D and the terminal speeds push/D and brake/D, both phases
    are exponentials; the duration of the first is the root of a scalar equation.

    Args:
        distance: Distance to the goal [m].
        mass: Mass [kg].
        friction: Viscous friction D [N s/m].
        push: Largest force forwards [N].
        brake: Largest force backwards [N]; as large as ``push`` if None.
    """
    delay = mass / friction
    forwards = push / friction
    backwards = (push if brake is None else brake) / friction

    def phases(first: float) -> tuple[float, float]:
        """Distance of both phases, and duration of the braking."""
        gain = -np.expm1(-first / delay)
        speed = forwards * gain
        braking = delay * np.log1p(speed / backwards)
        pushed = forwards * (first - delay * gain)
        return float(pushed + delay * speed - backwards * braking), float(braking)

    longest = distance / forwards + 10.0 * delay + np.sqrt(4.0 * distance * mass / push)
    first = float(
        brentq(lambda t: phases(t)[0] - distance, 0.0, longest, xtol=1e-14, rtol=1e-14)
    )
    return first + phases(first)[1]


# -- mechanisms ------------------------------------------------------------------------


class Mechanism(Protocol):
    """Equations of motion M(q) v' + h(q, v) = u, with partial derivatives."""

    @property
    def n(self) -> int:
        """Number of joints."""

    def terms(self, q: Array, v: Array) -> tuple[Array, Array]:
        """M and h, shapes (n, n) and (n,)."""

    def slopes(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """Derivatives of M(q) a + h(q, v) by q and v, shape (n, n) each."""


@dataclass(frozen=True)
class Separate:
    """I q'' + D q' + W cos q + F = u for each joint: pendulums, and masses on rails.

    Attributes:
        inertia: I, shape (n,) [kg m^2 or kg].
        friction: D, shape (n,) [N m s or N s/m].
        weight: W: torque of gravity with the link level, shape (n,) [N m].
        force: F: constant force against the motion, shape (n,) [N].
    """

    inertia: Sequence[float]
    friction: Sequence[float] = (0.0,)
    weight: Sequence[float] = (0.0,)
    force: Sequence[float] = (0.0,)

    @property
    def n(self) -> int:
        return len(self.inertia)

    def terms(self, q: Array, v: Array) -> tuple[Array, Array]:
        h = np.array(self.friction) * v + np.array(self.weight) * np.cos(q)
        return np.diag(np.array(self.inertia)), h + np.array(self.force)

    def slopes(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        return (
            np.diag(-np.array(self.weight) * np.sin(q)),
            np.diag(np.array(self.friction) * np.ones(self.n)),
        )


@dataclass(frozen=True)
class TwoLink:
    """Planar arm of two links, the second angle measured from the first link.

    Attributes:
        shoulder: I1 + m1 c1^2 + m2 l1^2 [kg m^2].
        elbow: I2 + m2 c2^2 [kg m^2].
        coupling: m2 l1 c2 [kg m^2].
        friction: Viscous friction of both joints [N m s].
        weights: Torques of gravity about each joint with the arm stretched level:
            (m1 c1 + m2 l1) g and m2 c2 g [N m].
    """

    shoulder: float
    elbow: float
    coupling: float
    friction: tuple[float, float] = (0.0, 0.0)
    weights: tuple[float, float] = (0.0, 0.0)

    @property
    def n(self) -> int:
        return 2

    def terms(self, q: Array, v: Array) -> tuple[Array, Array]:
        c, s = self.coupling * np.cos(q[1]), self.coupling * np.sin(q[1])
        lower = self.weights[1] * np.cos(q[0] + q[1])
        upper = self.weights[0] * np.cos(q[0])
        cross = self.elbow + c
        mass = np.array(
            [[self.shoulder + self.elbow + 2.0 * c, cross], [cross, self.elbow]]
        )
        h = np.array(
            [
                self.friction[0] * v[0]
                - s * v[1] * (2.0 * v[0] + v[1])
                + upper
                + lower,
                self.friction[1] * v[1] + s * v[0] ** 2 + lower,
            ]
        )
        return mass, h

    def slopes(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        c, s = self.coupling * np.cos(q[1]), self.coupling * np.sin(q[1])
        lower = -self.weights[1] * np.sin(q[0] + q[1])
        upper = -self.weights[0] * np.sin(q[0])
        turning = -s * (2.0 * a[0] + a[1]) - c * v[1] * (2.0 * v[0] + v[1])
        by_q = np.array(
            [
                [upper + lower, turning + lower],
                [lower, -s * a[0] + c * v[0] ** 2 + lower],
            ]
        )
        by_v = np.array(
            [
                [self.friction[0] - 2.0 * s * v[1], -2.0 * s * (v[0] + v[1])],
                [2.0 * s * v[0], self.friction[1]],
            ]
        )
        return by_q, by_v


def state_rate(mechanism: Mechanism, x: Array, u: Array) -> Array:
    """dx/dt of the state x = (q, v)."""
    n = mechanism.n
    mass, h = mechanism.terms(x[:n], x[n:])
    return np.concatenate([x[n:], np.linalg.solve(mass, u - h)])


def linearized(mechanism: Mechanism, x: Array, u: Array) -> tuple[Array, Array, Array]:
    """dx/dt and its derivatives by x and u, shapes (2n,), (2n, 2n) and (2n, n)."""
    n = mechanism.n
    q, v = x[:n], x[n:]
    mass, h = mechanism.terms(q, v)
    inverse = np.linalg.inv(mass)
    a = inverse @ (u - h)
    by_q, by_v = mechanism.slopes(q, v, a)
    by_x, by_u = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, n))
    by_x[:n, n:] = np.eye(n)
    by_x[n:, :n], by_x[n:, n:] = -inverse @ by_q, -inverse @ by_v
    by_u[n:] = inverse
    return np.concatenate([v, a]), by_x, by_u


# -- problems --------------------------------------------------------------------------


@dataclass(frozen=True)
class Task:
    """A minimum-time problem of a mechanism.

    Attributes:
        mechanism: Its equations of motion.
        effort: Torque limits of each joint, lower and upper.
        start: State (q, v) at the start, shape (2n,).
        goal: State at the goal, shape (2n,).
    """

    mechanism: Mechanism
    effort: Sequence[tuple[float, float]]
    start: Sequence[float]
    goal: Sequence[float]

    @cached_property
    def bounds(self) -> Array:
        """Torque limits, lower and upper, shape (n, 2)."""
        return np.array(self.effort, dtype=np.float64)

    @cached_property
    def ends(self) -> Array:
        """States at start and goal, shape (2, 2n)."""
        return np.array([self.start, self.goal], dtype=np.float64)
