"""Objectives: what an iteration is to make least, and which motion is better."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tominpmp.arrays import Array
from tominpmp.options import Options
from tominpmp.solvers.iterate import Iterate
from tominpmp.solvers.model import Model
from tominpmp.transcription.base import Linearization, StepBounds
from tominpmp.transcription.program import NonlinearProgram

# Violations below this are removed by slowing down at the end.
RESTORABLE = 1e-2
RESTORATIONS = 8
# Share of a violation that cures it, as torques go with the square of the pace, and
# how much more than what is needed is tried.
HALF, MORE = 0.5, 1.02
# Violations between the rows below this are cured so, where the grid is to be refined
# anyway: programs with rows for them bring less than it costs.
LIGHT = 5e-4
# Where any motion will do: how much slower one may be made.
TIME_SCALINGS = (1.0, 1.02, 1.05, 1.1, 1.2)
# What a step of all unknowns to the ends of the trust region costs, as a share of T,
# where no total variation keeps them quiet. Without it programs are a fifth more on 69
# problems of MotionBenchMaker; in free space iterations are as many with a third of it,
# and motions end 0.05 % slower with three times as much.
PROXIMAL = 3e-3


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
    def value(self, program: NonlinearProgram, z: Array, values: Array) -> float:
        """The objective of a motion.

        Args:
            program: The program.
            z: Its unknowns.
            values: Row values there.
        """

    @abstractmethod
    def model(
        self,
        program: NonlinearProgram,
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

    def within(self, program: NonlinearProgram, steps: StepBounds) -> StepBounds:
        """The part of a box of steps that the objective allows."""
        return steps

    def better(
        self, program: NonlinearProgram, state: Iterate, best: Iterate | None
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

    def restorable(self, program: NonlinearProgram, state: Iterate) -> bool:
        """Whether slowing down can remove the violations that are left.

        It removes none of equations.
        """
        rows = program.rows
        violation = rows.violation(state.values)
        equations = violation[rows.lower == rows.upper]
        light = np.max(violation, initial=0.0) <= RESTORABLE
        return bool(light and np.max(equations, initial=0.0) <= self.feasibility)

    def restored(self, program: NonlinearProgram, state: Iterate) -> Iterate:
        """Slow a motion down until it keeps its limits, where that is enough.

        The iteration stops when the objective has settled, which may be before the last
        second-order errors are gone; slowing down by half of such an error removes it,
        and costs that much. Another program would do no better where it is small.
        """
        if state.violation <= self.feasibility or not self.restorable(program, state):
            return state
        best, low, high = state, 1.0, np.inf
        left, falls = state.violation, 0.0
        factor = 1.0 + HALF * left
        for _ in range(RESTORATIONS):
            z, values = program.slower(state.z, factor, state.values)
            trial = replace(state, z=z, values=values)
            if trial.violation <= self.feasibility:
                best, high = trial, factor
                if falls > 0.0:
                    break
            else:
                falls = max((left - trial.violation) / (factor - low), 0.0)
                low, left = factor, trial.violation
            # What is left falls as evenly as it did: a little beyond there is none.
            beyond = low + MORE * left / falls if falls > 0.0 else np.inf
            if np.isinf(high):
                factor = min(beyond, 1.0 + 2.0 * (factor - 1.0))
            else:
                factor = beyond if beyond < high else 0.5 * (low + high)
        return best

    def _curable(self, program: NonlinearProgram, state: Iterate) -> bool:
        """Whether a slower motion violates all violated rows less."""
        rows = program.rows
        hard = rows.violation(state.values)[~rows.curable[rows.kind]]
        return bool(np.all(hard <= self.feasibility))

    def cured(
        self, program: NonlinearProgram, state: Iterate, light: float
    ) -> Iterate | None:
        """A motion with light violations, so slow that it has none.

        Args:
            program: The program.
            state: An iterate of it.
            light: The largest violation that is light.

        Returns:
            The motion; None if its violations are not light, or slowing down is no
            cure.
        """
        if state.violation > light or not self._curable(program, state):
            return None
        slower = self.restored(program, state)
        return slower if slower.violation <= self.feasibility else None


@dataclass(frozen=True, eq=False)
class MinimumTime(Objective):
    """The duration, and a little of the jumps of the controls.

    Attributes:
        jump_weight: Weight of the jumps [s].
        squared: Whether the squares of the jumps are added up (regularisation,
            Tikhonov, 1963); else their sizes, which is the total variation.
    """

    jump_weight: float = 0.0
    squared: bool = False

    @staticmethod
    def of(
        options: Options, jump_weight: float = 0.0, *, squared: bool = False
    ) -> MinimumTime:
        """The least time, or the time of any motion, as options say.

        Args:
            options: What is wanted, and tolerances.
            jump_weight: Weight of the jumps of the controls [s].
            squared: Whether their squares are added up.
        """
        kind = AnyMotion if options.objective == "feasible" else MinimumTime
        return kind(options.tolerance, options.feasibility, jump_weight, squared)

    def value(self, program: NonlinearProgram, z: Array, values: Array) -> float:
        """The duration [s]."""
        return float(program.cost @ z)

    def model(
        self,
        program: NonlinearProgram,
        state: Iterate,
        steps: StepBounds,
        linearization: Linearization,
    ) -> Model:
        """The duration and the jumps, the squares of which are a quadratic function.

        A linear program knows nothing of unknowns that the duration does not hang on:
        they may be anywhere in the trust region, and what that breaks has to be mended.
        The total variation holds them, or a small weight on the square of the step
        (proximal points, Rockafellar, 1976).
        """
        cost, weight = program.cost, self.jump_weight
        jumps = program.variation(state.z) if weight > 0.0 else None
        if jumps is not None and not self.squared:
            return Model(
                lambda z, _: float(cost @ z) + weight * jumps.total(z),
                cost,
                variation=jumps,
                weight=weight,
            )
        reach = np.maximum(-steps.lower, steps.upper)
        moving = (reach > 0.0) & (cost == 0.0)
        near = np.zeros(cost.size)
        share = 2.0 * PROXIMAL * state.duration / max(int(moving.sum()), 1)
        near[moving] = np.sqrt(share) / reach[moving]
        if jumps is None:
            return Model(lambda z, _: float(cost @ z), cost, near=near)
        return Model(
            lambda z, _: float(cost @ z) + weight * jumps.squares(z),
            cost + 2.0 * weight * (jumps.matrix.T @ jumps.at(state.z)),
            math.sqrt(2.0 * weight) * jumps.matrix,
            near,
        )


class AnyMotion(MinimumTime):
    """The duration, as far as it leads to any motion that keeps its limits."""

    any_will_do = True

    def better(
        self, program: NonlinearProgram, state: Iterate, best: Iterate | None
    ) -> Iterate | None:
        """The motion as slow as it has to be to keep its limits, if that is a cure."""
        if self._curable(program, state):
            for factor in TIME_SCALINGS:
                z, values = program.slower(state.z, factor, state.values)
                trial = replace(state, z=z, values=values)
                if trial.violation <= self.feasibility:
                    return trial
        return super().better(program, state, best)
