r"""Time against energy: T + k times an energy, and convex models of energies.

Both energies are sums over the Gauss points, with weights w, of the intervals, with
lengths h; each segment has its own robot and load:

- squared torques, :math:`\sum |r|^2` with r = sqrt(w h) u. The linearisation of r gives
  a convex quadratic model (Gauss and Newton);
- work of the motors, :math:`\sum \max(p, 0)` with p = w h u v, for each motor
  separately: energy recovered by a braking motor does not drive another one. The
  linearisation of p gives a convex, piecewise linear model, which keeps the kinks.

Of the curvature that these models omit, the largest part is known, and is added: the
curvature along slower and faster motions.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.constraints.base import Partials, States
from tominpmp.options import Options
from tominpmp.solvers.iterate import Iterate
from tominpmp.solvers.model import Model
from tominpmp.solvers.objective import Objective
from tominpmp.transcription.base import Linearization, Motion, StepBounds, Variation
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

# Gauss points as shares of an interval, and weights of the quadrature, which is exact
# for integrands of degree 5 in time.
SHARES = (0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15))
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
# Relative reduction of the objective below which progress has settled.
SETTLED = 1e-6
# Relative change of a duration for the difference quotient of the curvature along it.
STRETCH = 1e-3
# Proximal term: cost of a step of the size of the trust region in each unknown, as a
# share of the work.
TRACE = 1e-7


@dataclass(frozen=True, eq=False)
class Energy(ABC):
    """An energy of the motions of a program.

    Attributes:
        nlp: The nonlinear program.
    """

    nlp: NonlinearProgram

    @abstractmethod
    def __call__(self, z: Array) -> float:
        """The energy at an iterate."""

    @abstractmethod
    def model(self, z: Array, steps: StepBounds) -> Model:
        """A convex model near an iterate.

        Args:
            z: The iterate.
            steps: Box for the step.
        """

    def _points(self, motion: Motion) -> tuple[Instants, States]:
        """The Gauss points of all intervals, and the states there."""
        scheme = self.nlp.transcription
        at = Instants.spread(scheme.intervals, SHARES)
        return at, scheme.states(motion, at, 2)

    def _segments(self) -> Iterator[tuple[ProblemFunctions, slice]]:
        """The functions of each segment, and the slice of its Gauss points."""
        scheme, count = self.nlp.transcription, len(SHARES)
        for part, (i, j) in zip(scheme.system.segments, scheme.segments, strict=True):
            yield part, slice(count * i, count * j)

    def _torques(self, states: States) -> Array:
        """Torques of the motors, including dry friction, shape (m, n)."""
        torques = np.empty_like(states.v)
        for part, points in self._segments():
            torques[points] = part.motors.torque(_states_at(states, points))
        return torques + self.nlp.system.problem.robot.friction * np.sign(states.v)

    def _torque_partials(self, states: States) -> Iterator[tuple[slice, Partials]]:
        """Derivatives of the torques by the states, with their rows, by segment."""
        n = states.v.shape[1]
        for part, points in self._segments():
            every = np.arange(points.start, points.stop)
            at, joints = np.repeat(every, n), np.tile(np.arange(n), every.size)
            partials = part.motors.differentiate(states, at, joints)
            rows = slice(points.start * n, points.stop * n)
            yield rows, partials.times(part.motors.half[joints][:, None])

    def _lengths(self, motion: Motion) -> sp.csr_matrix:
        """Derivatives of the lengths of the intervals, shape (N, size)."""
        scheme = self.nlp.transcription
        every = np.arange(scheme.intervals)
        times = Partials(every, by_t=np.ones(every.size))
        ends, begins = (
            scheme.pull_back(motion, Instants(every, np.full(every.size, share)), times)
            for share in (1.0, 0.0)
        )
        return sp.csr_matrix(ends - begins)

    def _pace_curvature(
        self, z: Array, value: float, jacobian: sp.csr_matrix
    ) -> sp.csr_matrix:
        """Root of the curvature along time scaling that the squares do not contain.

        Between stops the speed of the motion is scaled as a whole, even across several
        segments: to scale only some of these would change the path.
        """
        nlp, roots = self.nlp, []
        paces = list(self._paces(z))
        for pace in paces:
            step = STRETCH * z * pace
            slower, faster = z + step, z - step
            if len(paces) == 1:
                slower, faster = (nlp.time_scale(z, 1.0 + s * STRETCH) for s in (1, -1))
            bend = (self(slower) - 2.0 * value + self(faster)) / STRETCH**2
            along = jacobian @ ((slower - faster) / (2.0 * STRETCH))
            missing = max(bend - 2.0 * float(along @ along), 0.0)
            cost = nlp.cost * pace
            roots.append(np.sqrt(missing) / float(cost @ z) * cost)
        return sp.csr_matrix(np.array(roots))

    def _paces(self, z: Array) -> Iterator[Array]:
        """Indicators of the durations, for each part of the motion between stops."""
        nlp = self.nlp
        durations = np.flatnonzero(nlp.cost)
        stops = [segment.stop for segment in nlp.system.problem.segments[:-1]]
        number = np.concatenate([[0], np.cumsum(stops)])
        if number.size != durations.size:
            number = np.zeros(durations.size)
        for part in np.unique(number):
            pace = np.zeros(z.size)
            pace[durations[number == part]] = 1.0
            yield pace


def _states_at(states: States, which: slice) -> States:
    """States at the chosen instants."""
    t, q, v, a, u = states
    chosen_u = None if u is None else u[which]
    return States(t[which], q[which], v[which], a[which] if len(a) else a, chosen_u)


class SquaredTorques(Energy):
    """The integral of the squared torques [N^2 m^2 s].

    During a dwell at the end of a segment the torques are those that hold the arm.
    """

    def __call__(self, z: Array) -> float:
        """The integral [N^2 m^2 s]."""
        motion = self.nlp.transcription.motion(z)
        squares = np.sum(self._torques(self._points(motion)[1]) ** 2, axis=1)
        moving = float(np.sum(squares.reshape(motion.h.size, -1) @ WEIGHTS * motion.h))
        return moving + sum(float(held @ held) for held, _ in self._holding(motion))

    def model(self, z: Array, steps: StepBounds) -> Model:
        """Gauss-Newton model of the integral near an iterate."""
        residual, jacobian = self._terms(z)
        gradient = np.asarray(2.0 * (jacobian.T @ residual))
        pace = self._pace_curvature(z, float(residual @ residual), jacobian)
        root = sp.vstack([np.sqrt(2.0) * jacobian, pace], format="csr")
        return Model(lambda z, _: self(z), gradient, root)

    def _terms(self, z: Array) -> tuple[Array, sp.csr_matrix]:
        """Roots of the terms of the sum, and their Jacobian."""
        scheme = self.nlp.transcription
        motion = scheme.motion(z)
        at, states = self._points(motion)
        h, n = motion.h, states.v.shape[1]
        torques = self._torques(states).ravel()
        share = np.repeat(np.tile(WEIGHTS, h.size), n)
        size = np.repeat(np.sqrt(h[at.interval]), n) * np.sqrt(share)
        by_length = self._lengths(motion)[np.repeat(at.interval, n)]
        parts = [
            scheme.pull_back(motion, at, partials)
            for _, partials in self._torque_partials(states)
        ]
        jacobian = sp.diags(size) @ sp.vstack(parts, format="csr")
        longer = 0.5 * torques * share / size
        jacobian = sp.csr_matrix(jacobian + sp.diags(longer) @ by_length)
        values, matrices = [size * torques], [jacobian]
        for held, by in self._holding(motion):
            values.append(held)
            matrices.append(by)
        return np.concatenate(values), sp.vstack(matrices, format="csr")

    def _holding(self, motion: Motion) -> Iterator[tuple[Array, sp.csr_matrix]]:
        """Residuals of the holding torques during dwells, and their Jacobians."""
        scheme = self.nlp.transcription
        parts = scheme.system.segments
        dwells = [segment.dwell for segment in scheme.system.problem.segments]
        for part, (_, end), dwell in zip(parts, scheme.segments, dwells, strict=False):
            if dwell == 0.0:
                continue
            at = Instants.end(end)
            states = scheme.states(motion, at, 0)
            still = np.zeros_like(states.q)
            states = States(states.t, states.q, still, still)
            root = np.sqrt(dwell)
            held = root * part.motors.torque(states)[0]
            joints = np.arange(held.size)
            partials = part.motors.differentiate(states, 0 * joints, joints)
            scale = root * part.motors.half[:, None]
            by_q = Partials(partials.at, by_q=partials.times(scale).by_q)
            yield held, scheme.pull_back(motion, at, by_q)


class PositiveWork(Energy):
    """The work of the motors [J]; energy from braking is not recovered."""

    def __call__(self, z: Array) -> float:
        """The work [J]."""
        motion = self.nlp.transcription.motion(z)
        states = self._points(motion)[1]
        power = np.maximum(self._torques(states) * states.v, 0.0).sum(axis=1)
        return float(np.sum(power.reshape(motion.h.size, -1) @ WEIGHTS * motion.h))

    def model(self, z: Array, steps: StepBounds) -> Model:
        """Model of the work near an iterate: max(p, 0) is half of p + abs(p).

        Terms that no step within the box brings to zero have a known sign, and are
        linear.
        """
        power, jacobian = self._terms(z)
        value = float(np.sum(np.maximum(power, 0.0)))
        box = np.maximum(steps.upper, -steps.lower)
        near = np.abs(power) <= abs(jacobian) @ box
        kinks = jacobian[near]
        signs = np.where(near, 0.5, power > 0.0)
        # A small proximal term determines the unknowns that do not affect the work.
        trace = np.sqrt(TRACE * value)
        still = np.divide(trace, box, out=np.zeros(z.size), where=box > 0.0)
        return Model(
            lambda z, _: self(z),
            np.asarray(jacobian.T @ signs),
            self._pace_curvature(z, value, sp.csr_matrix((1, z.size))),
            still,
            Variation(kinks, power[near] - kinks @ z),
            0.5,
        )

    def _terms(self, z: Array) -> tuple[Array, sp.csr_matrix]:
        """Work of each motor at each Gauss point, and the Jacobian."""
        scheme = self.nlp.transcription
        motion = scheme.motion(z)
        at, states = self._points(motion)
        h, n = motion.h, states.v.shape[1]
        torques, speeds = self._torques(states), states.v
        share = np.repeat(np.tile(WEIGHTS, h.size), n)
        size = share * np.repeat(h[at.interval], n)
        by_length = self._lengths(motion)[np.repeat(at.interval, n)]
        parts = [
            scheme.pull_back(motion, at, _power(partials, rows, torques, speeds))
            for rows, partials in self._torque_partials(states)
        ]
        power = (torques * speeds).ravel()
        jacobian = sp.diags(size) @ sp.vstack(parts, format="csr")
        jacobian = jacobian + sp.diags(share * power) @ by_length
        return size * power, sp.csr_matrix(jacobian)


def _power(partials: Partials, rows: slice, torques: Array, speeds: Array) -> Partials:
    """Derivatives of the powers from the derivatives of the torques."""
    n = speeds.shape[1]
    by = partials.times(speeds.ravel()[rows][:, None])
    direct = np.zeros((rows.stop - rows.start, n))
    joint = np.arange(rows.start, rows.stop) % n
    direct[np.arange(joint.size), joint] = torques.ravel()[rows]
    return by._replace(by_v=direct if by.by_v is None else by.by_v + direct)


MEASURES: dict[str, type[Energy]] = {
    "torque_squared": SquaredTorques,
    "work": PositiveWork,
}


@dataclass(frozen=True, eq=False)
class TimeAndEnergy(Objective):
    r"""Time against energy.

    .. math:: T + k \int_0^T |u(t)|^2 \, dt \quad \text{or} \quad
        T + k \int_0^T \sum_i \max(u_i \dot q_i, 0) \, dt

    Attributes:
        measure: Kind of energy, by its name in options.
        weight: Weight k of the energy [1/(N^2 m^2) or s/J].
    """

    measure: str
    weight: float

    @classmethod
    def of(cls, options: Options) -> TimeAndEnergy:
        """The objective with the energy and the weight of options."""
        weighed = options.energy, options.energy_weight
        return cls(SETTLED, options.feasibility, *weighed)

    def value(self, program: NonlinearProgram, z: Array, values: Array) -> float:
        """T + k times the energy [s]; infinite if the motion is not finite."""
        energy = self._energy(program)
        if not energy.nlp.transcription.motion(z).finite:
            return np.inf
        return float(program.cost @ z) + self.weight * energy(z)

    def model(
        self, program: NonlinearProgram, state: Iterate, linearization: Linearization
    ) -> Model:
        """The duration, and a convex model of the energy."""
        k, steps = self.weight, linearization.steps
        model = self._energy(program).model(state.z, steps)
        proximal = None if model.proximal is None else np.sqrt(k) * model.proximal
        return Model(
            lambda z, values: self.value(program, z, values),
            program.cost + k * model.gradient,
            np.sqrt(k) * model.root,
            proximal,
            model.variation,
            k * model.weight,
        )

    def _energy(self, program: NonlinearProgram) -> Energy:
        return MEASURES[self.measure](program)
