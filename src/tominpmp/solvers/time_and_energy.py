r"""Time against energy: T + k times an energy, and convex models of energies.

Both energies are sums over the Gauss points of the intervals, of lengths h and with
weights w, with the robot and the load of each segment:

- of squared torques, :math:`\sum |r|^2` with r = sqrt(w h) u. Its linearisation in r
  gives a convex quadratic (Gauss and Newton);
- of the work that motors do, :math:`\sum \max(p, 0)` with p = w h u v, of each motor
  by itself: what one gets back by braking drives no other. Linearised in p it is convex
  and piecewise linear, its kinks and all.

The curvature along slower and faster motions is added, which is known and the largest
of what is left out.
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

# Shares of an interval and weights of the quadrature: exact where what is summed is of
# degree 5 in time.
SHARES = (0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15))
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
# Further steps are not worth their time for this share of the objective.
SETTLED = 1e-6
# Change of a duration by which curvature along it is found.
STRETCH = 1e-3
# Share of the work that a step as long as the trust region costs in each unknown.
TRACE = 1e-7


@dataclass(frozen=True, eq=False)
class Energy(ABC):
    """An energy of a program's motions.

    Attributes:
        nlp: The program.
    """

    nlp: NonlinearProgram

    @abstractmethod
    def __call__(self, z: Array) -> float:
        """What it is."""

    @abstractmethod
    def model(self, z: Array, steps: StepBounds) -> Model:
        """A convex model near an iterate.

        Args:
            z: The iterate.
            steps: Box for the step.
        """

    def _points(self, motion: Motion) -> tuple[Instants, States]:
        of = self.nlp.transcription
        at = Instants.spread(of.intervals, SHARES)
        return at, of.states(motion, at, 2)

    def _segments(self) -> Iterator[tuple[ProblemFunctions, slice]]:
        """The functions of each segment, and its Gauss points."""
        of, count = self.nlp.transcription, len(SHARES)
        for part, (first, end) in zip(of.system.segments, of.segments, strict=True):
            yield part, slice(count * first, count * end)

    def _torques(self, states: States) -> Array:
        """Torques of the motors, dry friction and all, shape (m, n)."""
        torques = np.empty_like(states.v)
        for part, mine in self._segments():
            torques[mine] = part.motors.torque(_some(states, mine))
        return torques + self.nlp.system.problem.robot.friction * np.sign(states.v)

    def _torque_partials(self, states: States) -> Iterator[tuple[slice, Partials]]:
        """Derivatives of these torques by the states, of each segment, row by row."""
        n = states.v.shape[1]
        for part, mine in self._segments():
            every = np.arange(mine.start, mine.stop)
            at, joints = np.repeat(every, n), np.tile(np.arange(n), every.size)
            partials = part.motors.differentiate(states, at, joints)
            rows = slice(mine.start * n, mine.stop * n)
            yield rows, partials.times(part.motors.half[joints][:, None])

    def _lengths(self, motion: Motion) -> sp.csr_matrix:
        """Derivatives of the lengths of the intervals, shape (N, size)."""
        of = self.nlp.transcription
        every = np.arange(of.intervals)
        times = Partials(every, by_t=np.ones(every.size))
        ends, begins = (
            of.pull_back(motion, Instants(every, np.full(every.size, share)), times)
            for share in (1.0, 0.0)
        )
        return sp.csr_matrix(ends - begins)

    def _of_pace(
        self, z: Array, value: float, jacobian: sp.csr_matrix
    ) -> sp.csr_matrix:
        """Root of the curvature along slower motions that the squares do not have.

        From rest to rest the pace is changed as one, of several segments too: with that
        of a part of them alone, the path would change.
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
        """Which unknowns are durations, for each part of the motion between stops."""
        nlp = self.nlp
        durations = np.flatnonzero(nlp.cost)
        stops = [segment.stop for segment in nlp.system.problem.segments[:-1]]
        number = np.concatenate([[0], np.cumsum(stops)])
        if number.size != durations.size:
            number = np.zeros(durations.size)
        for one in np.unique(number):
            pace = np.zeros(z.size)
            pace[durations[number == one]] = 1.0
            yield pace


def _some(states: States, which: slice) -> States:
    """States at some of the instants."""
    t, q, v, a, u = states
    some_u = None if u is None else u[which]
    return States(t[which], q[which], v[which], a[which] if len(a) else a, some_u)


class SquaredTorques(Energy):
    """The integral of the squared torques [N^2 m^2 s].

    Where the arm stays at the end of a segment, it is that of the torques that hold it.
    """

    def __call__(self, z: Array) -> float:
        """The integral [N^2 m^2 s]."""
        motion = self.nlp.transcription.motion(z)
        squares = np.sum(self._torques(self._points(motion)[1]) ** 2, axis=1)
        moving = float(np.sum(squares.reshape(motion.h.size, -1) @ WEIGHTS * motion.h))
        return moving + sum(float(held @ held) for held, _ in self._held(motion))

    def model(self, z: Array, steps: StepBounds) -> Model:
        """The integral near an iterate."""
        residual, jacobian = self._terms(z)
        gradient = np.asarray(2.0 * (jacobian.T @ residual))
        pace = self._of_pace(z, float(residual @ residual), jacobian)
        root = sp.vstack([np.sqrt(2.0) * jacobian, pace], format="csr")
        return Model(lambda z, _: self(z), gradient, root)

    def _terms(self, z: Array) -> tuple[Array, sp.csr_matrix]:
        """Roots of the terms of the sum, and their Jacobian."""
        of = self.nlp.transcription
        motion = of.motion(z)
        at, states = self._points(motion)
        h, n = motion.h, states.v.shape[1]
        torques = self._torques(states).ravel()
        share = np.repeat(np.tile(WEIGHTS, h.size), n)
        size = np.repeat(np.sqrt(h[at.interval]), n) * np.sqrt(share)
        by_length = self._lengths(motion)[np.repeat(at.interval, n)]
        parts = [
            of.pull_back(motion, at, partials)
            for _, partials in self._torque_partials(states)
        ]
        jacobian = sp.diags(size) @ sp.vstack(parts, format="csr")
        longer = 0.5 * torques * share / size
        jacobian = sp.csr_matrix(jacobian + sp.diags(longer) @ by_length)
        values, matrices = [size * torques], [jacobian]
        for held, by in self._held(motion):
            values.append(held)
            matrices.append(by)
        return np.concatenate(values), sp.vstack(matrices, format="csr")

    def _held(self, motion: Motion) -> Iterator[tuple[Array, sp.csr_matrix]]:
        """Roots of what it takes to stay at the ends of segments, and their Jacobians.

        Of segments that have a dwell.
        """
        of = self.nlp.transcription
        asked = of.system.problem.segments
        segments = zip(of.system.segments, of.segments, asked, strict=False)
        for part, (_, end), one in segments:
            if one.dwell == 0.0:
                continue
            at = Instants.end(end)
            states = of.states(motion, at, 0)
            still = np.zeros_like(states.q)
            states = States(states.t, states.q, still, still)
            root = np.sqrt(one.dwell)
            held = root * part.motors.torque(states)[0]
            joints = np.arange(held.size)
            partials = part.motors.differentiate(states, 0 * joints, joints)
            scale = root * part.motors.half[:, None]
            by_q = Partials(partials.at, by_q=partials.times(scale).by_q)
            yield held, of.pull_back(motion, at, by_q)


class PositiveWork(Energy):
    """The work that the motors do [J]; what they get back by braking is lost."""

    def __call__(self, z: Array) -> float:
        """The work [J]."""
        motion = self.nlp.transcription.motion(z)
        states = self._points(motion)[1]
        power = np.maximum(self._torques(states) * states.v, 0.0).sum(axis=1)
        return float(np.sum(power.reshape(motion.h.size, -1) @ WEIGHTS * motion.h))

    def model(self, z: Array, steps: StepBounds) -> Model:
        """The work near an iterate: max(p, 0) is half of p, and half of its size.

        Of terms that no step of the box brings to zero the sign is known.
        """
        power, jacobian = self._terms(z)
        value = float(np.sum(np.maximum(power, 0.0)))
        box = np.maximum(steps.upper, -steps.lower)
        near = np.abs(power) <= abs(jacobian) @ box
        kinks = jacobian[near]
        signs = np.where(near, 0.5, power > 0.0)
        # A trace of curvature for what is free to be anything.
        trace = np.sqrt(TRACE * value)
        still = np.divide(trace, box, out=np.zeros(z.size), where=box > 0.0)
        return Model(
            lambda z, _: self(z),
            np.asarray(jacobian.T @ signs),
            self._of_pace(z, value, sp.csr_matrix((1, z.size))),
            still,
            Variation(kinks, power[near] - kinks @ z),
            0.5,
        )

    def _terms(self, z: Array) -> tuple[Array, sp.csr_matrix]:
        """Work of each motor by Gauss points, and its Jacobian."""
        of = self.nlp.transcription
        motion = of.motion(z)
        at, states = self._points(motion)
        h, n = motion.h, states.v.shape[1]
        torques, speeds = self._torques(states), states.v
        share = np.repeat(np.tile(WEIGHTS, h.size), n)
        size = share * np.repeat(h[at.interval], n)
        by_length = self._lengths(motion)[np.repeat(at.interval, n)]
        parts = [
            of.pull_back(motion, at, _power(partials, rows, torques, speeds))
            for rows, partials in self._torque_partials(states)
        ]
        power = (torques * speeds).ravel()
        jacobian = sp.diags(size) @ sp.vstack(parts, format="csr")
        jacobian = jacobian + sp.diags(share * power) @ by_length
        return size * power, sp.csr_matrix(jacobian)


def _power(partials: Partials, rows: slice, torques: Array, speeds: Array) -> Partials:
    """Derivatives of powers from those of torques."""
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
        measure: Which energy, as options name it.
        weight: Its weight k [1/(N^2 m^2) or s/J].
    """

    measure: str
    weight: float

    @classmethod
    def of(cls, options: Options) -> TimeAndEnergy:
        """The energy that options weigh."""
        weighed = options.energy, options.energy_weight
        return cls(SETTLED, options.feasibility, *weighed)

    def value(self, program: NonlinearProgram, z: Array, values: Array) -> float:
        """T + k times the energy [s]; infinite for no motion."""
        energy = self._energy(program)
        if not energy.nlp.transcription.motion(z).finite:
            return np.inf
        return float(program.cost @ z) + self.weight * energy(z)

    def model(
        self,
        program: NonlinearProgram,
        state: Iterate,
        steps: StepBounds,
        linearization: Linearization,
    ) -> Model:
        """The duration, and a convex model of the energy."""
        model, k = self._energy(program).model(state.z, steps), self.weight
        near = None if model.near is None else np.sqrt(k) * model.near
        return Model(
            lambda z, values: self.value(program, z, values),
            program.cost + k * model.gradient,
            np.sqrt(k) * model.root,
            near,
            model.variation,
            k * model.weight,
        )

    def _energy(self, program: NonlinearProgram) -> Energy:
        return MEASURES[self.measure](program)
