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
from tominpmp.linear_programs import LpSolution, solve_quadratic
from tominpmp.options import Options
from tominpmp.solvers.iterate import Iterate, SlpResult, Trial
from tominpmp.solvers.merit import Merit
from tominpmp.solvers.step_search import StepSearch
from tominpmp.solvers.subproblem import Subproblem, build_subproblem
from tominpmp.solvers.trust_region import TrustRegion
from tominpmp.status import Status
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.program import NonlinearProgram

# Shares of an interval and weights of the quadrature: exact where the torque is a
# parabola in time.
SHARES = (0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15))
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
# Solver of the quadratic programs, and its tolerances: looser where it fails.
QP_SOLVER = "piqp"
QP_TOLERANCES = (1e-9, 1e-7)
# Weight of violations before any multiplier is known, in shares of the objective.
FIRST_WEIGHT = 10.0
# The iteration ends when a step promises less than this share of the objective, or the
# last few brought less.
SETTLED, WINDOW = 1e-6, 3
CORRECTIONS = 4
LINE_SEARCH = (0.5, 0.25, 0.1, 0.03)
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
        curvature = 2.0 * (jacobian.T @ jacobian) + self._of_pace(z, jacobian)
        value = float(residual @ residual)
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

    def _of_pace(self, z: Array, jacobian: sp.csr_matrix) -> sp.csr_matrix:
        """Curvature along slower motions that the squares alone do not have."""
        nlp = self.nlp
        slower, faster = (nlp.stretch(z, 1.0 + sign * STRETCH) for sign in (1, -1))
        bend = (self(slower) - 2.0 * self(z) + self(faster)) / STRETCH**2
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
        state, status = self.init(z), Status.ITERATION_LIMIT
        best: tuple[float, Iterate] | None = None
        costs: list[float] = []
        for _ in range(self.options.max_iterations):
            state, promised = self.step(state)
            cost = self.objective(state.z)
            costs = [*costs, cost][-WINDOW - 1 :]
            if state.violation <= self.options.feasibility:
                if best is None or cost < best[0]:
                    best = cost, state
                gained = costs[0] - cost if len(costs) > WINDOW else np.inf
                if min(promised, gained) < SETTLED * cost:
                    status = Status.CONVERGED
                    break
            if state.region.exhausted or self.over():
                status = Status.TIME_LIMIT if self.over() else Status.STALLED
                break
        found = None if best is None else best[1]
        return SlpResult(status, found or state, found, ())

    def init(self, z: Array) -> Iterate:
        """State at the start."""
        nlp = self.nlp
        weights = np.full(len(nlp.rows.kinds), FIRST_WEIGHT * self.objective(z))
        merit = Merit(nlp.cost, nlp.rows, 0.0, weights)
        return Iterate(
            z, nlp.evaluate(z), merit, TrustRegion(), np.zeros(nlp.rows.size)
        )

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
        frame, curvature = self._with_energy(frame, energy)
        solution = _solve(frame, curvature)
        if solution is None:
            return replace(state, region=state.region.after(0.0, 0.3)), np.inf
        merit, step = state.merit, frame.step(solution)
        now = self.objective(z) + merit.penalty(values)
        expected = values.copy()
        expected[frame.rows] += frame.matrix @ step
        model = float(nlp.cost @ (z + step)) + merit.penalty(expected)
        model += self.weight * (energy.value + energy.change(step))
        promised = max(now - model, 0.0)

        def resolve(error: Array) -> Array | None:
            low, high = frame.corrected(error)
            program = replace(frame.program, row_lower=low, row_upper=high)
            again = _solve(replace(frame, program=program), curvature)
            return None if again is None else frame.step(again)

        search = StepSearch(
            nlp,
            lambda z, values: self.objective(z) + merit.penalty(values),
            frame,
            CORRECTIONS,
            LINE_SEARCH,
        )
        outcome = search.run(
            Trial(z, values, now),
            step,
            promised,
            resolve,
            lambda trial, violation: violation <= self.options.feasibility,
        )
        trial = outcome.trial
        raised = merit.raised(frame.multipliers(solution), values, expected)
        region = state.region.after(outcome.ratio, trial.damping)
        state = replace(state, merit=raised, region=region)
        if outcome.accepted:
            state = replace(state, z=trial.z, values=trial.values)
        return state, promised

    def _with_energy(
        self, frame: Subproblem, energy: EnergyModel
    ) -> tuple[Subproblem, sp.csc_matrix]:
        """The program with the energy in its objective, and its curvature."""
        program, free = frame.program, frame.free
        cost = program.cost.copy()
        cost[: free.size] += self.weight * energy.gradient[free]
        of_step = self.weight * energy.curvature[free][:, free]
        rest = program.cost.size - free.size
        curvature = sp.block_diag([of_step, sp.csc_matrix((rest, rest))], format="csc")
        return replace(frame, program=replace(program, cost=cost)), curvature


def _solve(frame: Subproblem, curvature: sp.csc_matrix) -> LpSolution | None:
    for accuracy in QP_TOLERANCES:
        solution = solve_quadratic(
            frame.program, curvature, QP_SOLVER, eps_abs=accuracy, eps_rel=accuracy
        )
        if solution.optimal and np.all(np.isfinite(solution.x)):
            return solution
    return None
