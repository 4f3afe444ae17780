r"""Two-stage Radau IIA: implicit integration steps of the dynamics.

With constant torque on an interval of length h, the stages X_1 and X_2 solve

.. math::
    X_i = x_k + h \sum_j a_{ij} f(X_j, u_k), \qquad x_{k+1} = X_2,

with the nodes c = (1/3, 1) and a = ((5/12, -1/12), (3/4, 1/4)). The scheme has order 3
and is L-stable (Hairer and Wanner, 1996, section IV.5), so that it tolerates stiff
joint friction: robot descriptions contain friction whose time constant is a small
fraction of an interval.

In collocation both ends of an interval are unknowns, and only the inner stage is solved
for (:class:`SteppedMotion`); single shooting solves for both stages, interval by
interval (:func:`rollout`). Newton's iteration converges to rounding in both cases, and
the derivatives follow exactly from the implicit function theorem.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.dynamics import Dynamics, ForwardJacobians
from tominpmp.transcription.instants import Instants

# Equations of motion, with their derivatives: a function of states and torques.
Rates: TypeAlias = Callable[[Array, Array], ForwardJacobians]

NODES = np.array([1.0 / 3.0, 1.0])
WEIGHTS = np.array([[5.0 / 12.0, -1.0 / 12.0], [3.0 / 4.0, 1.0 / 4.0]])

# Newton's iteration has converged when its step, or ten times the predicted next step,
# is smaller than this, relative to the unknowns.
ROUNDING = 1e-13
NEWTON_STEPS = 30


class InnerStage(NamedTuple):
    """Inner stages of intervals whose two ends are given.

    Attributes:
        x: State at a third of each interval, shape (m, 2n); interpolated between the
            ends if Newton's iteration failed.
        solved: Whether Newton's iteration converged, for each interval, shape (m,).
    """

    x: Array
    solved: BoolArray


class DefectJacobians(NamedTuple):
    """Partial derivatives by x_k, x_{k+1}, u_k and h_k, stacked in this order.

    Attributes:
        defects: Derivatives of the defects of steps, shape (m, 2n, 5n + 1).
        inner: Derivatives of their inner stages, shape (m, 2n, 5n + 1).
    """

    defects: Array
    inner: Array


def stage_weights(share: Array) -> Array:
    """Weights of start, inner stage and end in the states within steps, shape (m, 3).

    They are the Lagrange basis functions of the collocation polynomial.

    Args:
        share: Elapsed share of the step, from 0 to 1, shape (m,).
    """
    s, c = share, NODES[0]
    parts = (
        (s - c) * (s - 1.0) / c,
        s * (s - 1.0) / (c * (c - 1.0)),
        s * (s - c) / (1.0 - c),
    )
    return np.stack(parts, axis=1)


def _solve_systems(matrix: Array, right: Array) -> Array:
    """Solutions of linear systems; NaN for all if a matrix is singular."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full(np.broadcast_shapes(right.shape), np.nan)


def _converged(size: Array, last: Array) -> BoolArray:
    """Whether Newton's iteration has converged on each of several systems, shape (m,).

    Args:
        size: Size of the last step of each system, shape (m,).
        last: Size of the step before, shape (m,).
    """
    # Quadratic convergence: the next step is about size^2 / last (times size).
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        following = (size / last) ** 2 * size
    following = np.where((size < 1e-3) & (last < 1.0), following, np.inf)
    solved = np.minimum(size, 10.0 * following) <= ROUNDING
    # Rounding errors of stiff terms may keep small steps from shrinking further.
    return np.asarray(solved | ((size < 1e-9) & (size >= 0.1 * last)))


class StepJacobians(NamedTuple):
    """Derivatives of the state at the end of each step.

    Attributes:
        A: With respect to the start x_k of the step, shape (M, 2n, 2n).
        B: With respect to the torque u_k, shape (M, 2n, n).
        c: With respect to the length of the interval of the step, shape (M, 2n).
    """

    A: Array
    B: Array
    c: Array


@dataclass(frozen=True, eq=False)
class SteppedMotion:
    """States at the ends of steps, and torques; the defects need not be zero.

    Attributes:
        dynamics: Equations of motion.
        ends: State at the start and at the end of each step, shape (M + 1, 2n).
        u: Torques of the intervals, shape (N, n) [N m or N].
        h: Lengths of the intervals [s], shape (N,).
        substeps: Number of steps in each interval.
        known_inner: Inner stages of the steps, shape (M, 2n); None if they have yet to
            be solved for.
        finite: Whether all steps were solved; states after a failed step are NaN.
    """

    dynamics: Dynamics
    ends: Array
    u: Array
    h: Array
    substeps: int = 1
    known_inner: Array | None = None
    finite: bool = True

    @property
    def x(self) -> Array:
        """States at the nodes, shape (N + 1, 2n)."""
        return self.ends[:: self.substeps]

    @property
    def _steps(self) -> tuple[Array, Array, Array, Array]:
        """Starts and ends, shapes (M, 2n), torques (M, n) and lengths (M, 1) [s]."""
        u = np.repeat(self.u, self.substeps, axis=0)
        h = np.repeat(self.h / self.substeps, self.substeps)
        return self.ends[:-1], self.ends[1:], u, h[:, None]

    @cached_property
    def stage(self) -> InnerStage:
        """Inner stages between the ends of the steps, by Newton's iteration."""
        dynamics, (start, end, u, h) = self.dynamics, self._steps
        n = u.shape[1]
        # Cubic Hermite interpolation of the positions, linear of the velocities.
        guess = start + NODES[0] * (end - start)
        guess[:, :n] = (20.0 * start[:, :n] + 7.0 * end[:, :n]) / 27.0 + h * (
            4.0 * start[:, n:] - 2.0 * end[:, n:]
        ) / 27.0
        with np.errstate(over="ignore", invalid="ignore"):
            known = start + h * WEIGHTS[0, 1] * dynamics.forward(end, u)
            steps = dynamics.forward_jacobians, known, u, h[..., None] * WEIGHTS[:1, :1]
            stages, solved = solve_steps(*steps, guess[:, None], NEWTON_STEPS)
        return InnerStage(np.where(solved[:, None], stages[:, 0], guess), solved)

    @property
    def inner(self) -> Array:
        """Inner stages, shape (M, 2n)."""
        return self.stage.x if self.known_inner is None else self.known_inner

    @cached_property
    def defects(self) -> Array:
        """Defects x_{k+1} - x_k - h (3/4 f(X_1) + 1/4 f(x_{k+1})), shape (M, 2n)."""
        start, end, u, h = self._steps
        stages, torques = np.concatenate([self.inner, end]), np.concatenate([u, u])
        inner, last = np.split(self.dynamics.forward(stages, torques), 2)
        return np.asarray(
            end - start - h * (WEIGHTS[1, 0] * inner + WEIGHTS[1, 1] * last)
        )

    @cached_property
    def derivatives(self) -> DefectJacobians:
        """Derivatives of inner stages, and of defects with these eliminated."""
        _, end, u, h = self._steps
        m, size = end.shape
        stages, torques = np.concatenate([self.inner, end]), np.concatenate([u, u])
        by = self.dynamics.forward_jacobians(stages, torques)
        f1, f2 = by.f[:m], by.f[m:]
        F1, F2, B1, B2 = by.f_x[:m], by.f_x[m:], by.f_u[:m], by.f_u[m:]
        step = h[..., None]
        eye = np.broadcast_to(np.eye(size), (m, size, size))
        (a11, a12), (a21, a22) = WEIGHTS
        by_control = step * (a11 * B1 + a12 * B2)
        by_length = (a11 * f1 + a12 * f2)[..., None]
        right = np.concatenate([eye, step * a12 * F2, by_control, by_length], axis=2)
        inner = _solve_systems(eye - step * a11 * F1, right)
        by_control = -step * (a21 * B1 + a22 * B2)
        by_length = -(a21 * f1 + a22 * f2)[..., None]
        direct = np.concatenate(
            [-eye, eye - step * a22 * F2, by_control, by_length], axis=2
        )
        return DefectJacobians(direct - step * a21 * F1 @ inner, inner)

    @cached_property
    def sensitivities(self) -> StepJacobians:
        """Derivatives of the ends of the steps, whose defects must be zero."""
        size = self.ends.shape[1]
        starts, ends, others = np.split(self.derivatives.defects, [size, 2 * size], 2)
        # The end of each step is defined implicitly by a zero defect.
        parts = -_solve_systems(ends, np.concatenate([starts, others], axis=2))
        by_length = parts[..., -1] / self.substeps
        return StepJacobians(parts[..., :size], parts[..., size:-1], by_length)

    def steps(self, at: Instants) -> tuple[IntArray, Array]:
        """Indices of the steps of instants, and shares of these steps, (m,) each."""
        place = at.share * self.substeps
        inside = np.clip(np.ceil(place) - 1, 0, self.substeps - 1).astype(np.int64)
        return at.interval * self.substeps + inside, place - inside

    def states(self, at: Instants) -> Array:
        """States at instants, shape (m, 2n)."""
        step, share = self.steps(at)
        weights = stage_weights(share)
        x = weights[:, :1] * self.ends[step] + weights[:, 2:] * self.ends[step + 1]
        if np.any(weights[:, 1]):
            x = x + weights[:, 1:2] * self.inner[step]
        return np.asarray(x)


def rollout(
    dynamics: Dynamics,
    x_start: Array,
    u: Array,
    h: Array,
    substeps: int = 1,
    guess: SteppedMotion | None = None,
) -> SteppedMotion:
    """Integrate forward with a constant torque on each interval.

    With a similar motion as a guess, Newton's iteration runs on all steps at once,
    which needs a few evaluations of many states instead of many evaluations of one
    state; the result is the same. Without a guess, or if the iteration fails, the steps
    are solved one by one.

    Args:
        dynamics: Equations of motion.
        x_start: State at the start, shape (2n,).
        u: Torques of the intervals, shape (N, n) [N m or N].
        h: Lengths of the intervals, shape (N,) [s].
        substeps: Number of steps in each interval.
        guess: A motion with the same number of steps.
    """
    each, length = np.repeat(u, substeps, axis=0), np.repeat(h / substeps, substeps)
    steps = dynamics.forward_jacobians, x_start, each, length[:, None, None] * WEIGHTS
    solved = np.zeros(1, dtype=bool)
    with np.errstate(over="ignore", invalid="ignore"):
        if guess is not None and guess.finite:
            first = np.stack([guess.inner, guess.ends[1:]], axis=1)
            stages, solved = solve_steps(*steps, first, NEWTON_STEPS)
        if not solved[0]:
            stages = _one_by_one(*steps)
    ends = np.concatenate([x_start[None], stages[:, 1]])
    finite = bool(np.all(np.isfinite(ends)))
    return SteppedMotion(dynamics, ends, u, h, substeps, stages[:, 0], finite)


def _one_by_one(rates: Rates, x_start: Array, u: Array, weights: Array) -> Array:
    """Stages of successive steps, shape (M, 2, 2n); NaN from a failed step on."""
    stages = np.full((len(u), 2, x_start.size), np.nan)
    x = x_start
    for k in range(len(u)):
        start, step = np.stack([x, x])[None], slice(k, k + 1)
        found, (solved,) = solve_steps(
            rates, x, u[step], weights[step], start, NEWTON_STEPS
        )
        if not solved:
            break
        stages[k] = found[0]
        x = stages[k, 1]
    return stages


def solve_steps(
    rates: Rates, x_start: Array, u: Array, weights: Array, stages: Array, most: int
) -> tuple[Array, BoolArray]:
    """Stages of successive steps, by Newton's iteration on all steps at once.

    Args:
        rates: Equations of motion, with their derivatives.
        x_start: State before the first step, shape (s,); or before each step, shape
            (M, s), for steps that do not depend on each other.
        u: Torques, shape (M, n).
        weights: Weights of a scheme with k stages, times the lengths of the steps [s],
            shape (M, k, k). The last stage of successive steps is at the end.
        stages: Initial guess, shape (M, k, s).
        most: Largest number of iterations.

    Returns:
        Stages, shape (M, k, s), and whether the iteration has converged: for all steps
        together, shape (1,), or for each step, shape (M,).
    """
    count, k, size = stages.shape
    torque, starts = np.repeat(u, k, axis=0), x_start
    by_start = np.broadcast_to(np.vstack([np.eye(size)] * k), (count, k * size, size))
    linked = x_start.ndim == 1
    systems = 1 if linked else count
    last, solved = np.full(systems, np.inf), np.zeros(systems, dtype=bool)
    for _ in range(most):
        by = rates(stages.reshape(-1, size), torque)
        f_x = by.f_x.reshape(count, k, size, size)
        if linked:
            starts = np.concatenate([x_start[None], stages[:-1, -1]])
        residual = stages - starts[:, None] - weights @ by.f.reshape(stages.shape)
        coupling = weights[:, :, None, :, None] * f_x.transpose(0, 2, 1, 3)[:, None]
        matrix = np.eye(k * size) - coupling.reshape(count, k * size, k * size)
        residual = residual.reshape(count, k * size, 1)
        if systems == count:
            change = -_solve_systems(matrix, residual)
        else:
            right = np.concatenate([-residual, by_start], axis=2)
            change = _forward_sweep(_solve_systems(matrix, right))
        stages = stages + change.reshape(stages.shape)
        way, x = (np.abs(part).reshape(systems, -1) for part in (change, stages))
        moved = np.max(way, axis=1) / (1.0 + np.max(x, axis=1))
        solved = _converged(moved, last)
        if np.all(solved) or not np.all(np.isfinite(moved)):
            break
        last = moved
    return stages, solved


def _forward_sweep(parts: Array) -> Array:
    """Changes of the stages of linked steps: each starts at the end of the previous.

    Args:
        parts: Changes of the stages for a fixed start, followed by their derivatives by
            the start, shape (M, k s, 1 + s), for M steps of k stages of s entries; the
            last stage is the end of the step.

    Returns:
        Changes of all stages, shape (M, k s).
    """
    size = parts.shape[2] - 1
    changes, by_start = parts[..., 0].copy(), parts[..., 1:]
    for k in range(1, changes.shape[0]):
        changes[k] += by_start[k] @ changes[k - 1, -size:]
    return changes


def sweep_adjoint(
    sensitivities: StepJacobians, nodes: IntArray, seeds: Array, functionals: IntArray
) -> tuple[Array, Array]:
    r"""Differentiate functionals of states at the ends of steps by the controls.

    In the paper, the differential of a functional :math:`g(x(1))` (equation 12) is

    .. math:: \delta g = T \int_0^1 \langle f_u^T \psi, \delta u \rangle \, d\tau
        + \delta T \int_0^1 \langle \psi, f \rangle \, d\tau, \qquad
        \frac{d\psi}{d\tau} + T f_x^T \psi = 0, \quad \psi(1) = g_x^T,

    and the costate of a functional at another instant (equation 13) begins there. Here
    the motion is computed by an integrator, and the derivatives are exact for its
    steps: for a functional :math:`g(x_k)` the discrete adjoint is
    :math:`\lambda_k = g_x` and :math:`\lambda_j = A_j^T \lambda_{j+1}`, swept backwards
    for all functionals at once; the derivatives are
    :math:`g_{u_j} = B_j^T \lambda_{j+1}` and :math:`g_{h_j} = c_j^T \lambda_{j+1}`.

    Args:
        sensitivities: A, B and c of the steps.
        nodes: Index of the end of a step for each seed, shape (s,).
        seeds: Gradients of functionals with respect to the states there, (s, 2n).
        functionals: Index of the functional of each seed, shape (s,).

    Returns:
        Derivatives with respect to torques, shape (m, M, n), and lengths, shape (m, M).
    """
    A, B, c = sensitivities
    count, _, n = B.shape
    number = int(functionals.max(initial=-1)) + 1
    by_control, by_length = np.zeros((number, count, n)), np.zeros((number, count))
    costate = np.zeros((number, A.shape[1]))
    for j in range(count - 1, -1, -1):
        here = nodes == j + 1
        np.add.at(costate, functionals[here], seeds[here])
        by_control[:, j], by_length[:, j] = costate @ B[j], costate @ c[j]
        costate = costate @ A[j]
    return by_control, by_length
