r"""Minimum time along the straight joint line: TOPP-RA.

The path is fixed, only its timing is optimised, so the result is an upper bound on the
optimum that costs milliseconds. Velocity and torque limits are those of the robot.

**Viscous friction.** Along a path q(s), with x the square of the path speed and u the
path acceleration, TOPP-RA takes limits linear in (u, x). Friction adds
:math:`d \sqrt{x}`, with :math:`d = D q'(s)`, to the torque :math:`a u + b x + c`, which
is not linear. Where friction relieves the limit (it pulls the torque away from it), the
limit is a convex set, replaced by the polygon of chords of the square root. Where it
loads the limit, the square root is replaced by its tangent at the last solution, and
TOPP-RA is run again until T converges. Both replacements lie inside the true set, so
every pass keeps the true limits, no pass is slower than the one before, and at the end
the loaded limits are exact at the grid points. Without friction one pass is enough and
the limits are those of toppra's own ``JointTorqueConstraint``.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass

import numpy as np
import toppra
from toppra.algorithm import TOPPRA
from toppra.constraint import (
    DiscretizationType,
    JointVelocityConstraint,
    LinearConstraint,
)
from toppra.constraint.linear_constraint import canlinear_colloc_to_interpolate

from .arm import Arm, Array, Sampler, TorqueModel, piecewise_constant_acceleration

# Squared path speeds, relative to the largest that can be reached, between which
# the square root is replaced by chords; dense near rest, where it bends. The polygon
# is at most 1 % of sqrt(x) low from the second point on.
CHORDS = np.array([0.0, 1e-4, 4e-4, 1.6e-3, 6.4e-3, 2.5e-2, 0.1, 0.25, 0.5, 1.0])

# No tangent is taken at rest, where its slope is infinite; this share of the largest
# squared speed costs 0.5 % of the friction torque at full speed, at rest only.
SMALLEST_TANGENT = 1e-4


@dataclass(frozen=True)
class ToppraResult:
    """Result of TOPP-RA.

    Attributes:
        T: Duration in [s]; nan unless solved.
        success: Whether a timing of the line exists within the limits.
        status: Status reported by toppra.
        t: Times of the grid points, shape (M+1,), in [s].
        q: Positions at the grid points, shape (M+1, n).
        v: Velocities at the grid points, shape (M+1, n).
        seconds: Processor time of all passes, set-up included [s].
        passes: Number of passes; more than one only with friction.
    """

    T: float
    success: bool
    status: str
    t: Array
    q: Array
    v: Array
    seconds: float
    passes: int

    @property
    def motion(self) -> Sampler:
        """The motion between the grid points: constant path acceleration."""
        return piecewise_constant_acceleration(self.t, self.q, self.v)


class DampedTorqueConstraint(LinearConstraint):
    """Inner approximation of torque limits with viscous friction.

    Args:
        arm: The robot.
        gridpoints: Path positions, shape (M+1,).
        q: Positions at the grid points, shape (M+1, n).
        step: Derivative of the straight path, shape (n,).

    Attributes:
        x_max: Bound of the squared path speed, from the velocity limits and from the
            speeds at which friction takes all torque. The rows hold only up to it.
    """

    def __init__(self, arm: Arm, gridpoints: Array, q: Array, step: Array) -> None:
        super().__init__()
        self.set_discretization_type(DiscretizationType.Interpolation)
        self.identical = True
        self._gridpoints = gridpoints
        self._arm = arm
        torque = TorqueModel(arm)
        zero = np.zeros_like(q)
        steps = np.tile(step, (len(q), 1))
        self._friction = arm.damping * step
        self._c = torque(q, zero, zero)
        self._a = torque(q, zero, steps) - self._c
        self._b = torque(q, steps, zero) - self._c - self._friction

        tiny = 1e-12
        effort = np.maximum(arm.effort_upper, -arm.effort_lower)
        pull = effort + np.max(np.abs(self._c), axis=0)
        terminal = float(np.min(pull / np.maximum(np.abs(self._friction), tiny)))
        fastest = float(np.min(arm.velocity / np.maximum(np.abs(step), tiny)))
        # Coupling may drive a joint beyond its terminal speed, but not to twice this.
        self.x_max = min(fastest, 2.0 * terminal) ** 2
        self._tangent_at = np.full(len(q), min(fastest, 0.5 * terminal) ** 2)

    def touch(self, x: Array) -> None:
        """Put the tangents of the square root at these squared speeds, shape (M+1,)."""
        self._tangent_at = np.maximum(x, SMALLEST_TANGENT * self.x_max)

    def get_dof(self) -> int:
        """Number of joints."""
        return self._arm.n

    def rows(self) -> tuple[Array, Array, Array]:
        """Rows a u + b x + c <= 0 at each grid point, each of shape (M+1, m)."""
        a, b, c = [], [], []
        root = np.sqrt(self._tangent_at)[:, None]
        chord_x = CHORDS * self.x_max
        slopes = np.diff(np.sqrt(chord_x)) / np.diff(chord_x)
        intercepts = np.sqrt(chord_x[:-1]) - slopes * chord_x[:-1]
        for sign, bound in (
            (1.0, self._arm.effort_upper),
            (-1.0, self._arm.effort_lower),
        ):
            friction = sign * self._friction
            base = sign * self._c - sign * bound
            loads = friction >= 0.0
            # Tangent: sqrt(x) <= x / (2 root) + root / 2.
            a.append(sign * self._a[:, loads])
            b.append((sign * self._b + friction / (2.0 * root))[:, loads])
            c.append((base + friction * root / 2.0)[:, loads])
            for slope, intercept in zip(slopes, intercepts, strict=True):
                a.append(sign * self._a[:, ~loads])
                b.append((sign * self._b + friction * slope)[:, ~loads])
                c.append((base + friction * intercept)[:, ~loads])
        return np.hstack(a), np.hstack(b), np.hstack(c)

    def compute_constraint_params(
        self, path: object, gridpoints: Array, *args: object, **kwargs: object
    ) -> tuple[Array | None, ...]:
        """Pass the rows to toppra, at both ends of each step."""
        if not np.array_equal(gridpoints, self._gridpoints):
            raise ValueError("the constraint was built for other grid points")
        a, b, c = self.rows()
        count = a.shape[1]
        result: tuple[Array | None, ...] = canlinear_colloc_to_interpolate(
            a, b, c, np.eye(count), np.zeros(count), None, None, gridpoints, True
        )
        return result


def solve_line(
    arm: Arm,
    q_start: Array,
    q_goal: Array,
    *,
    gridpoints: int = 200,
    max_passes: int = 20,
    tolerance: float = 1e-4,
) -> ToppraResult:
    """Time the straight joint line from rest to rest.

    Args:
        arm: The robot.
        q_start: Start, shape (n,).
        q_goal: Goal, shape (n,).
        gridpoints: Number M of steps along the line.
        max_passes: Most passes (only with friction).
        tolerance: Relative gain of T below which no further pass is made.
    """
    started = time.process_time()
    logging.getLogger("toppra").setLevel(logging.ERROR)
    step = q_goal - q_start
    # Dense at both ends, where a uniform grid loses up to 1 % of T: a strong arm on a
    # long line is at full speed within one uniform step.
    grid = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, gridpoints + 1)))
    q = q_start + np.outer(grid, step)
    path = toppra.SplineInterpolator([0.0, 1.0], np.stack([q_start, q_goal]))
    torque = DampedTorqueConstraint(arm, grid, q, step)
    speed = np.minimum(arm.velocity, np.sqrt(torque.x_max) * np.abs(step))
    # A joint that does not move keeps its limit: toppra accepts no limit of zero.
    speed = np.where(step == 0.0, arm.velocity, speed)
    velocity = JointVelocityConstraint(np.stack([-speed, speed], axis=1))
    damped = bool(np.any(arm.damping * step != 0.0))

    best_T, best_sd, status, passes = float("nan"), np.ones(gridpoints + 1), "", 0
    while passes < max_passes:
        passes += 1
        algorithm = TOPPRA(
            [velocity, torque], path, gridpoints=grid, solver_wrapper="seidel"
        )
        _, sd, _ = algorithm.compute_parameterization(0.0, 0.0)
        code = str(algorithm.problem_data.return_code.name)
        if sd is None or not np.all(np.isfinite(sd)):
            if damped and passes == 1:
                # Tangents at full speed may leave too little torque to hold the arm.
                torque.touch(np.zeros(gridpoints + 1))
                continue
            status = status or code
            break
        T = float(_times(grid, sd)[-1])
        gain = np.inf if np.isnan(best_T) else 1.0 - T / best_T
        if gain > 0.0:
            best_T, best_sd, status = T, sd, code
        if not damped or gain < tolerance:
            break
        torque.touch(sd**2)

    return ToppraResult(
        T=best_T,
        success=not np.isnan(best_T),
        status=status,
        t=_times(grid, best_sd),
        q=q,
        v=np.outer(best_sd, step),
        seconds=time.process_time() - started,
        passes=passes,
    )


def _times(grid: Array, speeds: Array) -> Array:
    """Times of the grid points, with constant path acceleration between them."""
    steps = 2.0 * np.diff(grid) / (speeds[1:] + speeds[:-1])
    return np.concatenate([[0.0], np.cumsum(steps)])
