"""Objectives: what an iteration is to make least, and which motion is better."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, cast

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.options import Options
from tominpmp.solvers.energy_measures import MEASURES, Energy
from tominpmp.solvers.iterate import Iterate
from tominpmp.solvers.mean_speeds import mean_speeds
from tominpmp.solvers.model import Model
from tominpmp.solvers.restoration import restorable, restored
from tominpmp.solvers.torque_variation import TorqueVariation
from tominpmp.transcription.base import Linearization, Program, StepBounds, Variation
from tominpmp.transcription.program import NonlinearProgram

# Where any motion will do: how much slower one may be made.
TIME_SCALINGS = (1.0, 1.02, 1.05, 1.1, 1.2)
# What a step of all unknowns to the ends of the trust region costs, as a share of T,
# where no weight on the sum of differences of the controls keeps them quiet. With a
# third of it iterations are as many, with three times as much motions end slower by
# 0.05 %.
PROXIMAL = 3e-3
# Further steps for time and energy, and for quiet torques, are not worth their time for
# these shares of the objective.
ENERGY_SETTLED, QUIET_SETTLED = 1e-6, 5e-3
# Residuals of what does not vary at all are measured against this.
LEAST_NORM = 1e-6
# Weight of the mean speeds beside the torque variation. A third of it leaves half as
# much again of the ways beyond the straight ones; three times as much makes torques
# less quiet by a sixth (24 goals of four arms).
SPEED_WEIGHT = 0.1


@dataclass(frozen=True, eq=False)
class Objective(ABC):
    """What is to be least.

    Attributes:
        tolerance: Further steps are not worth their time for this share of it.
        feasibility: Largest violation that is let pass.
    """

    tolerance: float
    feasibility: float
    # Whether any motion that keeps its limits is enough.
    any_will_do: ClassVar[bool] = False

    @abstractmethod
    def value(self, program: Program, z: Array, values: Array) -> float:
        """The objective of a motion.

        Args:
            program: The program.
            z: Its unknowns.
            values: Row values there.
        """

    @abstractmethod
    def model(
        self,
        program: Program,
        state: Iterate,
        steps: StepBounds,
        linearization: Linearization,
    ) -> Model:
        """The objective near an iterate, and what else keeps steps in check.

        Args:
            program: The program.
            state: The iterate.
            steps: Box for the step.
            linearization: Jacobian of the rows that may matter.
        """

    def within(self, program: Program, steps: StepBounds) -> StepBounds:
        """The part of a box of steps that the objective allows."""
        return steps

    def better(
        self, program: Program, state: Iterate, best: Iterate | None
    ) -> Iterate | None:
        """An iterate if it keeps its limits and has less than the best one, else that.

        Args:
            program: The program.
            state: The iterate.
            best: The best one; None if there is none.
        """
        if state.violation > self.feasibility:
            return best
        now = self.value(program, state.z, state.values)
        if best is None or now < self.value(program, best.z, best.values):
            return state
        return best

    def restorable(self, program: Program, state: Iterate) -> bool:
        """Whether slowing down can remove the violations that are left."""
        return restorable(program, state, self.feasibility)

    def restored(self, program: Program, state: Iterate) -> Iterate:
        """The motion without violations, where slowing down is enough."""
        return restored(program, state, self.feasibility)


@dataclass(frozen=True, eq=False)
class MinimumTime(Objective):
    """The duration, and a little of the total variation of the controls.

    Attributes:
        tv_weight: Weight of the total variation [s].
    """

    tv_weight: float = 0.0

    @staticmethod
    def of(options: Options, tv_weight: float = 0.0) -> MinimumTime:
        """The least time, or the time of any motion, as options say.

        Args:
            options: What is wanted, and tolerances.
            tv_weight: Weight of the total variation [s].
        """
        kind = AnyMotion if options.objective == "feasible" else MinimumTime
        return kind(options.tolerance, options.feasibility, tv_weight)

    def value(self, program: Program, z: Array, values: Array) -> float:
        """The duration [s]."""
        return float(program.cost @ z)

    def model(
        self,
        program: Program,
        state: Iterate,
        steps: StepBounds,
        linearization: Linearization,
    ) -> Model:
        """The duration and the variation, which is linear near an iterate.

        A linear program knows nothing of unknowns that the duration does not hang on:
        they may be anywhere in the trust region, and what that breaks has to be mended.
        Where no variation is weighed, a small weight on the square of the step keeps
        them where they are (proximal points, Rockafellar, 1976).
        """
        cost, weight = program.cost, self.tv_weight
        if weight > 0.0:
            variation = program.variation(state.z)
            return Model(
                lambda z, _: float(cost @ z) + weight * variation.total(z),
                cost,
                variation=variation,
                weight=weight,
            )
        reach = np.maximum(-steps.lower, steps.upper)
        moving = (reach > 0.0) & (cost == 0.0)
        near = np.zeros(cost.size)
        share = 2.0 * PROXIMAL * state.duration / max(int(moving.sum()), 1)
        near[moving] = np.sqrt(share) / reach[moving]
        return Model(lambda z, _: float(cost @ z), cost, near=near)


class AnyMotion(MinimumTime):
    """The duration, as far as it leads to any motion that keeps its limits."""

    any_will_do = True

    def better(
        self, program: Program, state: Iterate, best: Iterate | None
    ) -> Iterate | None:
        """The motion as slow as it has to be to keep its limits, if that is a cure."""
        rows = program.rows
        curable = rows.curable[rows.kind]
        if np.all(rows.violation(state.values)[~curable] <= self.feasibility):
            for factor in TIME_SCALINGS:
                z, values = program.slower(state.z, factor, state.values)
                trial = replace(state, z=z, values=values)
                if trial.violation <= self.feasibility:
                    return trial
        return super().better(program, state, best)


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
        return cls(ENERGY_SETTLED, options.feasibility, *weighed)

    def value(self, program: Program, z: Array, values: Array) -> float:
        """T + k times the energy [s]; infinite for no motion."""
        energy = self._energy(program)
        if not energy.nlp.transcription.motion(z).finite:
            return np.inf
        return float(program.cost @ z) + self.weight * energy(z)

    def model(
        self,
        program: Program,
        state: Iterate,
        steps: StepBounds,
        linearization: Linearization,
    ) -> Model:
        """The duration, and a convex model of the energy."""
        return (
            self._energy(program)
            .model(state.z, steps)
            .times(self.weight)
            .plus(program.cost, lambda z, values: self.value(program, z, values))
        )

    def _energy(self, program: Program) -> Energy:
        return MEASURES[self.measure](cast(NonlinearProgram, program))


@dataclass(frozen=True, eq=False)
class QuietTorques(Objective):
    """Torque variation and mean speeds in a given time, each in shares of what it was.

    Attributes:
        times: Instants of the sequence of torques as shares of T, shape (k,).
        torque_norm: What the differences of torques are measured against.
        speeds: Mean speeds in their shares, linear in the unknowns.
    """

    times: Array
    torque_norm: float
    speeds: Variation

    @classmethod
    def of(cls, nlp: NonlinearProgram, z: Array, feasibility: float) -> QuietTorques:
        """The objective for the time of an iterate.

        Args:
            nlp: The nonlinear program.
            z: Its iterate.
            feasibility: Largest violation that is let pass.
        """
        times = nlp.transcription.sequence_times(z)
        torques = TorqueVariation(nlp, times).differences(z, nlp.evaluate(z))
        matrix, offset = mean_speeds(nlp, z)
        norm = _norm(matrix @ z + offset) / np.sqrt(SPEED_WEIGHT)
        speeds = Variation(matrix / norm, offset / norm)
        return cls(QUIET_SETTLED, feasibility, times, _norm(torques), speeds)

    def value(self, program: Program, z: Array, values: Array) -> float:
        """Half the sum of the squares: (1 + the weight of the speeds) / 2 at first."""
        torques = TorqueVariation(cast(NonlinearProgram, program), self.times)
        differences = torques.differences(z, values) / self.torque_norm
        speeds = self.speeds.matrix @ z + self.speeds.offset
        return 0.5 * float(differences @ differences + speeds @ speeds)

    def model(
        self,
        program: Program,
        state: Iterate,
        steps: StepBounds,
        linearization: Linearization,
    ) -> Model:
        """The squares of residuals that are linear near an iterate."""
        torques = TorqueVariation(cast(NonlinearProgram, program), self.times)
        matrix, offset = torques.linearized(state.z, state.values, linearization)
        parts = [matrix / self.torque_norm, self.speeds.matrix]
        offsets = [offset / self.torque_norm, self.speeds.offset]
        root = sp.vstack(parts, format="csr")
        gradient = root.T @ (root @ state.z + np.concatenate(offsets))
        return Model(
            lambda z, values: self.value(program, z, values),
            np.asarray(gradient),
            root,
        )

    def within(self, program: Program, steps: StepBounds) -> StepBounds:
        """The time stays as it is."""
        timed = program.cost != 0.0
        return StepBounds(*(np.where(timed, 0.0, bound) for bound in steps))

    def restorable(self, program: Program, state: Iterate) -> bool:
        """Whether there are no violations: the time is given."""
        return state.violation <= self.feasibility

    def restored(self, program: Program, state: Iterate) -> Iterate:
        """The motion as it is."""
        return state


def _norm(residuals: Array) -> float:
    return max(float(np.linalg.norm(residuals)), LEAST_NORM)
