r"""Time against energy: the least of T + k times the integral of the squared torques.

.. math:: \min \; T + k \int_0^T |u(t)|^2 \, dt

The integral is a sum of squares r^T r with r = sqrt(w h) u at the Gauss points of the
intervals, of lengths h and with weights w. Its linearisation in r gives a convex
quadratic program for the step (Gauss and Newton), to which the curvature along slower
and faster motions is added, which is known and the largest of what is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.constraints import Partials, States
from tominpmp.options import Options
from tominpmp.solvers.iterate import Iterate, SlpResult
from tominpmp.solvers.quadratic import (
    QuadraticProgram,
    first_iterate,
    iterate,
    take_step,
)
from tominpmp.solvers.subproblem import Subproblem, build_subproblem
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.program import NonlinearProgram

# Shares of an interval and weights of the quadrature: exact where the torque is a
# parabola in time.
SHARES = (0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15))
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
# Weight of violations before any multiplier is known, in shares of the objective.
FIRST_WEIGHT = 10.0
# Share of the objective that further steps are not worth their time for.
SETTLED = 1e-6
# Change of the duration by which curvature along it is found.
STRETCH = 1e-3


class EnergyModel(NamedTuple):
    """The integral of the squared torques near an iterate.

    Attributes:
        value: What it is [N^2 m^2 s].
        gradient: Its gradient, shape (size,).
        curvature: Its curvature, positive semidefinite, shape (size, size).
    """

    value: float
    gradient: Array
    curvature: sp.csc_matrix

    def change(self, step: Array) -> float:
        """By how much a step changes it."""
        return float(self.gradient @ step + 0.5 * step @ (self.curvature @ step))


@dataclass(frozen=True, eq=False)
class Energy:
    """The integral of the squared torques of a program's motions.

    Attributes:
        nlp: The program.
    """

    nlp: NonlinearProgram

    def __call__(self, z: Array) -> float:
        """The integral [N^2 m^2 s]."""
        _, h, states = self._states(z)
        squares = np.sum(self._torques(states) ** 2, axis=1)
        return float(np.sum(squares.reshape(h.size, -1) @ WEIGHTS * h))

    def model(self, z: Array) -> EnergyModel:
        """The integral near an iterate."""
        of = self.nlp.transcription
        at, h, states = self._states(z)
        torques = self._torques(states)
        motion, m, n = of.motion(z), at.size, torques.shape[1]
        rows, joints = np.repeat(np.arange(m), n), np.tile(np.arange(n), m)
        motors = of.system.motors
        partials = motors.differentiate(states, rows, joints)
        partials = partials.times(motors.half[joints][:, None])
        share = np.repeat(np.tile(WEIGHTS, h.size), n)
        size = np.repeat(np.sqrt(h[at.interval]), n) * np.sqrt(share)
        by_length = self._lengths(z)[np.repeat(at.interval, n)]
        residual = size * torques.ravel()
        jacobian = sp.diags(size) @ of.pull_back(motion, at, partials)
        longer = 0.5 * torques.ravel() * share / size
        jacobian = sp.csr_matrix(jacobian + sp.diags(longer) @ by_length)
        gradient = 2.0 * (jacobian.T @ residual)
        value = float(residual @ residual)
        curvature = 2.0 * (jacobian.T @ jacobian) + self._of_pace(z, value, jacobian)
        return EnergyModel(value, np.asarray(gradient), sp.csc_matrix(curvature))

    def _states(self, z: Array) -> tuple[Instants, Array, States]:
        of = self.nlp.transcription
        motion = of.motion(z)
        at = Instants.spread(of.intervals, SHARES)
        return at, motion.h, of.states(motion, at, 2)

    def _torques(self, states: States) -> Array:
        """Torques of the motors, dry friction and all, shape (m, n)."""
        system = self.nlp.system
        dry = system.problem.robot.friction * np.sign(states.v)
        return np.asarray(system.motors.torque(states) + dry)

    def _lengths(self, z: Array) -> sp.csr_matrix:
        """Derivatives of the lengths of the intervals, shape (N, size)."""
        of = self.nlp.transcription
        motion, every = of.motion(z), np.arange(of.intervals)
        times = Partials(every, by_t=np.ones(every.size))
        ends, begins = (
            of.pull_back(motion, Instants(every, np.full(every.size, share)), times)
            for share in (1.0, 0.0)
        )
        return sp.csr_matrix(ends - begins)

    def _of_pace(
        self, z: Array, value: float, jacobian: sp.csr_matrix
    ) -> sp.csr_matrix:
        """Curvature along slower motions that the squares alone do not have."""
        nlp = self.nlp
        slower, faster = (nlp.stretch(z, 1.0 + sign * STRETCH) for sign in (1, -1))
        bend = (self(slower) - 2.0 * value + self(faster)) / STRETCH**2
        along = jacobian @ ((slower - faster) / (2.0 * STRETCH))
        missing = max(bend - 2.0 * float(along @ along), 0.0)
        pace = sp.csr_matrix(nlp.cost / float(nlp.cost @ z))
        return missing * (pace.T @ pace)


@dataclass(frozen=True, eq=False)
class EnergySolver:
    """Sequential quadratic programming for time against energy.

    Attributes:
        nlp: The nonlinear program.
        options: Tolerances, limits and the trust region.
        weight: Weight k of the integral [1/(N^2 m^2)].
        over: Tells whether the time is up.
    """

    nlp: NonlinearProgram
    options: Options
    weight: float
    over: Callable[[], bool] = field(default=lambda: False)

    def run(self, z: Array) -> SlpResult:
        """Iterate until nothing more is to be had.

        Args:
            z: Where to begin.

        Returns:
            The outcome; the best iterate is that of the least objective that keeps all
            constraints.
        """
        return iterate(
            self.init(z),
            self.step,
            lambda state: self.objective(state.z),
            self.options,
            self.over,
            SETTLED,
        )

    def init(self, z: Array) -> Iterate:
        """State at the start."""
        weight = FIRST_WEIGHT * self.objective(z)
        return first_iterate(self.nlp, z, self.nlp.cost, weight)

    def objective(self, z: Array) -> float:
        """T + k times the integral [s]; infinite for no motion."""
        if not self.nlp.transcription.motion(z).finite:
            return np.inf
        return float(self.nlp.cost @ z) + self.weight * Energy(self.nlp)(z)

    def step(self, state: Iterate) -> tuple[Iterate, float]:
        """One iteration: linearise, solve, correct, search, accept or shrink.

        Returns:
            The next state, and by how much the program promised to lower the merit.
        """
        nlp, z, values = self.nlp, state.z, state.values
        bounds = nlp.step_bounds(z, self.options.trust_region * state.region.radius)
        linearization = nlp.linearize(z, values, bounds)
        frame = build_subproblem(state.merit, values, linearization, bounds, None, z)
        energy = Energy(nlp).model(z)
        here = float(nlp.cost @ z) + self.weight * energy.value
        return take_step(
            nlp,
            state,
            self._with_energy(frame, energy),
            here,
            lambda z, _: self.objective(z),
            lambda step: (
                here + float(nlp.cost @ step) + self.weight * energy.change(step)
            ),
            self.options.feasibility,
        )

    def _with_energy(self, frame: Subproblem, energy: EnergyModel) -> QuadraticProgram:
        """The program with the energy in its objective."""
        program, free = frame.program, frame.free
        cost = program.cost.copy()
        cost[: free.size] += self.weight * energy.gradient[free]
        of_step = self.weight * energy.curvature[free][:, free]
        rest = program.cost.size - free.size
        curvature = sp.block_diag([of_step, sp.csc_matrix((rest, rest))], format="csc")
        return QuadraticProgram(frame, replace(program, cost=cost), curvature)
