r"""Time against energy: T + k times an energy, and convex models of energies.

An energy is the integral of the squares, or of the positive parts, of terms r(u, v),
one for each motor (:class:`~tominpmp.motion.measures.EnergyKind`): a sum over the Gauss
points, with weights w, of the intervals, with lengths h; each segment has its own robot
and load:

- squares, for example of the torques: :math:`\sum w h |r|^2`. The linearisation of
  sqrt(w h) r gives a convex quadratic model (Gauss and Newton);
- positive parts, for example of the powers: :math:`\sum w h \max(r, 0)`, for each motor
  separately: energy recovered by a braking motor does not drive another one. The
  linearisation of w h r gives a convex, piecewise linear model, which keeps the kinks.

Of the curvature that these models omit, the largest part is known, and is added: the
curvature along slower and faster motions.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.constraints.base import Partials, States
from tominpmp.motion.measures import ENERGIES, EnergyKind
from tominpmp.options import Options
from tominpmp.solvers.iterate import Iterate
from tominpmp.solvers.objective import PROXIMAL, Model, Objective
from tominpmp.transcription.base import Linearization, Motion, Transcription, Variation
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

# Three Gauss points as shares of an interval, and weights of the quadrature, which is
# exact for integrands of degree 5 in time.
POINTS, WEIGHTS = (0.5 * each for each in np.polynomial.legendre.leggauss(3))
SHARES = tuple((0.5 + POINTS).tolist())
# Relative reduction of the objective below which progress has settled.
SETTLED = 1e-6
# Relative change of a duration for the difference quotient of the curvature along it.
STRETCH = 1e-3


@dataclass(frozen=True, eq=False)
class TimeAndEnergy(Objective):
    r"""Time against energy.

    .. math:: T + k \int_0^T \sum_i r(u_i, \dot q_i)^2 \, dt \quad \text{or} \quad
        T + k \int_0^T \sum_i \max(r(u_i, \dot q_i), 0) \, dt

    Attributes:
        kind: Kind of energy.
        weight: Weight k of the energy [s per unit of the energy].
    """

    kind: EnergyKind
    weight: float

    @classmethod
    def of(cls, options: Options) -> TimeAndEnergy:
        """The objective with the energy and the weight of options."""
        kind, weight = ENERGIES[options.energy], options.energy_weight
        return cls(SETTLED, options.feasibility, kind, weight)

    def value(self, program: NonlinearProgram, z: Array, values: Array) -> float:
        """T + k times the energy [s]."""
        return float(program.cost @ z) + self.weight * self.energy(program, z)

    def energy(self, program: NonlinearProgram, z: Array) -> float:
        """The energy at an iterate, in the unit of its kind."""
        scheme, integrand = program.transcription, self.kind.integrand
        return sum(
            float(weight @ integrand(_torques(part, states), states.v))
            for part, _, states, weight, _ in _pieces(scheme, scheme.motion(z))
        )

    def model(
        self, program: NonlinearProgram, state: Iterate, linearization: Linearization
    ) -> Model:
        """The duration, and a convex model of the energy.

        A positive part max(r, 0) is half of r + abs(r). Terms that no step within the
        box brings to zero have a known sign, and are linear.
        """
        z, k, value = state.z, self.weight, partial(self.value, program)
        terms, jacobian = self._terms(program, z)
        if self.kind.squared:
            gradient = np.asarray(2.0 * (jacobian.T @ terms))
            pace = self._pace_curvature(program, z, float(terms @ terms), jacobian)
            root = sp.vstack([np.sqrt(2.0) * jacobian, pace], format="csr")
            gradient, root = program.cost + k * gradient, np.sqrt(k) * root
            return Model(value, gradient, root)
        lower, upper = linearization.steps
        box, energy = np.maximum(upper, -lower), float(np.sum(np.maximum(terms, 0.0)))
        near = np.abs(terms) < abs(jacobian) @ box
        kinks = jacobian[near]
        gradient = np.asarray(jacobian.T @ np.where(near, 0.5, terms > 0.0))
        pace = self._pace_curvature(program, z, energy, sp.csr_matrix((1, z.size)))
        # A small proximal term determines the unknowns that do not affect the energy.
        trace = np.sqrt(2.0 * PROXIMAL * energy / z.size)
        still = np.divide(trace, box, out=np.zeros(z.size), where=box > 0.0)
        root = np.sqrt(k) * sp.vstack([pace, sp.diags(still)], format="csr")
        gradient = program.cost + k * gradient
        variation = Variation(kinks, terms[near] - kinks @ z)
        return Model(value, gradient, root, variation, 0.5 * k)

    def slowed(self, program: NonlinearProgram, state: Iterate) -> Iterate:
        """The motion slowed down, unless that costs more than its violations are worth.

        Torques that hold the arm against gravity hardly fall with the speed. The
        weights of their violations are then too small.
        """
        slower = super().slowed(program, state)
        if slower is state:
            return state
        now, then = (self.value(program, k.z, k.values) for k in (state, slower))
        costly = then > (1.0 + state.violation) * now
        return state if costly else slower

    def _terms(
        self, program: NonlinearProgram, z: Array
    ) -> tuple[Array, sp.csr_matrix]:
        """Weighted terms at the Gauss points and during dwells, and their Jacobian.

        Roots of the weights multiply terms that are squared.
        """
        scheme, n = program.transcription, program.system.n
        exponent = 0.5 if self.kind.squared else 1.0
        motion = scheme.motion(z)
        # Derivatives of the lengths of the intervals by the unknowns.
        earlier = z.size - scheme.shares.shape[1]
        lengths = sp.csr_matrix(np.pad(scheme.shares, [(0, 0), (earlier, 0)]))
        values, matrices = list[Array](), list[sp.csr_matrix]()
        for part, at, states, weight, rate in _pieces(scheme, motion):
            size, rates = np.repeat(weight, n) ** exponent, np.repeat(rate, n)
            found = self.kind.term(_torques(part, states), states.v)
            term, by_u, by_v = (each.ravel() for each in found)
            by = _by_states(part, states).times(by_u)
            if np.any(rate):
                direct = np.tile(np.eye(n), (at.size, 1)) * by_v[:, None]
                by = by._replace(by_v=direct if by.by_v is None else by.by_v + direct)
            else:
                by = Partials(by.at, by.by_q)  # the arm is held at rest
            longer = sp.diags(exponent * size * term * rates)
            values.append(size * term)
            matrices.append(
                sp.diags(size) @ scheme.pull_back(motion, at, by)
                + longer @ lengths[np.repeat(at.interval, n)]
            )
        return np.concatenate(values), sp.vstack(matrices, format="csr")

    def _pace_curvature(
        self,
        program: NonlinearProgram,
        z: Array,
        energy: float,
        jacobian: sp.csr_matrix,
    ) -> sp.csr_matrix:
        """Root of the curvature along time scaling that the squares do not contain.

        Between stops the speed of the motion is scaled as a whole, even across several
        segments: to scale only some of these would change the path.
        """
        durations = np.flatnonzero(program.cost)
        stops = [segment.stop for segment in program.system.problem.segments[:-1]]
        number = np.cumsum([False, *stops])  # part between stops of each duration
        roots = []
        for part in np.unique(number):
            pace = np.zeros(z.size)
            pace[durations[number == part]] = 1.0
            step = STRETCH * z * pace
            slower, faster = z + step, z - step
            if number[-1] == 0:
                slower = program.time_scale(z, 1.0 + STRETCH)
                faster = program.time_scale(z, 1.0 - STRETCH)
            change = self.energy(program, slower) - 2.0 * energy
            bend = (change + self.energy(program, faster)) / STRETCH**2
            along = jacobian @ ((slower - faster) / (2.0 * STRETCH))
            missing = max(bend - 2.0 * float(along @ along), 0.0)
            cost = program.cost * pace
            roots.append(np.sqrt(missing) / float(cost @ z) * cost)
        return sp.csr_matrix(np.array(roots))


def _pieces(
    scheme: Transcription[Any], motion: Motion
) -> Iterator[tuple[ProblemFunctions, Instants, States, Array, Array]]:
    """The Gauss points of each segment, and the arm that is held during its dwell.

    Yields:
        The functions of the segment, the instants, the states there, their weights in
        the integral over time [s], and the relative derivatives of the weights by the
        lengths of their intervals [1/s]; these are zero during a dwell.
    """
    every, system = Instants.spread(scheme.intervals, SHARES), scheme.system
    dwells = [segment.dwell for segment in system.problem.segments] or [0.0]
    for part, span, dwell in zip(system.segments, scheme.segments, dwells, strict=True):
        at = every.within(*span)
        h = motion.h[at.interval]
        weight = np.tile(WEIGHTS, at.size // WEIGHTS.size) * h
        yield part, at, scheme.states(motion, at, 2), weight, 1.0 / h
        if dwell > 0.0:
            at = Instants.end(span[1])
            t, q, *_ = scheme.states(motion, at, 0)
            held = States(t, q, 0.0 * q, 0.0 * q)
            yield part, at, held, np.array([dwell]), np.zeros(1)


def _torques(part: ProblemFunctions, states: States) -> Array:
    """Torques of the motors, including dry friction, shape (m, n)."""
    friction = part.problem.robot.friction
    return part.motors.torque(states) + friction * np.sign(states.v)


def _by_states(part: ProblemFunctions, states: States) -> Partials:
    """Derivatives of the torques of all motors at all instants by the states."""
    count, n = states.q.shape
    at, joints = np.repeat(np.arange(count), n), np.tile(np.arange(n), count)
    by = part.motors.differentiate(states, at, joints)
    return by.times(part.motors.half[joints])
