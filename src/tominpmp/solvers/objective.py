"""Objectives: the quantity that an iteration minimises, and its convex models.

An objective also says which of two motions is better, and how slowing a motion down
restores its feasibility.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.options import Options
from tominpmp.solvers.iterate import Iterate
from tominpmp.transcription.base import Linearization, StepBounds, Variation
from tominpmp.transcription.program import NonlinearProgram

# Violations up to this are removed at the end by slowing down.
RESTORABLE = 1e-2
# Most trials to restore feasibility.
RESTORATIONS = 8
# Relative increase of the duration that removes a violation, as a share of it: torques
# go with the square of the speed.
SLOWDOWN = 0.5
# Weight of the proximal term, without a total variation: cost of a step of all unknowns
# to the bounds of the trust region, as a share of T. Without it, 69 problems of
# MotionBenchMaker take a fifth more programs; in free space a third of it takes as many
# iterations, and with three times as much motions end 0.05 % slower.
PROXIMAL = 3e-3


@dataclass(frozen=True, eq=False)
class Model:
    r"""An objective near an iterate z, with a convex model of its change in a step d.

    .. math::
        g^T d + |R d|^2 / 2 + w \sum (|G (z + d) + G_0| - |G z + G_0|)

    Attributes:
        value: The objective as a function of unknowns and row values.
        gradient: g, shape (size,).
        root: R, root of the curvature and of proximal terms, which keep unknowns near
            z, shape (k, size), without rows if there is none.
        variation: G and G_0: differences whose absolute values are added up; None
            without a total variation.
        weight: w, the weight of the total variation.
    """

    value: Callable[[Array, Array], float]
    gradient: Array
    root: sp.csr_matrix
    variation: Variation | None = None
    weight: float = 0.0

    def without_curvature(self, z: Array) -> float:
        """Linear and total-variation terms at an iterate, up to a constant."""
        total = float(self.gradient @ z)
        if self.variation is not None:
            total += self.weight * self.variation.total(z)
        return total

    def curvature_term(self, step: Array) -> float:
        """Quadratic term of a step."""
        return 0.5 * float(np.sum((self.root @ step) ** 2))

    def with_curvature(self, root: sp.csr_matrix) -> Model:
        """The model with a further curvature, given by its root."""
        return replace(self, root=sp.vstack([self.root, root], format="csr"))


@dataclass(frozen=True, eq=False)
class Objective(ABC):
    """An objective to be minimised.

    Attributes:
        tolerance: Relative reduction of the objective below which progress has settled.
        feasibility: Largest tolerated violation.
        any_will_do: Whether the iteration ends with the first feasible motion.
    """

    tolerance: float
    feasibility: float
    any_will_do: bool = field(default=False, kw_only=True)

    @abstractmethod
    def value(self, program: NonlinearProgram, z: Array, values: Array) -> float:
        """The objective at an iterate.

        Args:
            program: The program.
            z: Unknowns.
            values: Row values there.
        """

    @abstractmethod
    def model(
        self, program: NonlinearProgram, state: Iterate, linearization: Linearization
    ) -> Model:
        """Convex model of the objective near an iterate, with regularisation.

        Args:
            program: The program.
            state: The iterate.
            linearization: Jacobian of the rows that may become active, with the box for
                the step.
        """

    def within(self, program: NonlinearProgram, steps: StepBounds) -> StepBounds:
        """The part of the box for the step that the objective allows."""
        return steps

    def better(
        self, program: NonlinearProgram, state: Iterate, best: Iterate | None
    ) -> Iterate | None:
        """The better of two iterates: the new one must be feasible and have less cost.

        Args:
            program: The program.
            state: The new iterate.
            best: The best iterate so far; None if none is feasible.
        """
        if state.violation > self.feasibility:
            return best
        now = self.value(program, state.z, state.values)
        if best is None or now < self.value(program, best.z, best.values):
            return state
        return best

    def restorable(self, program: NonlinearProgram, state: Iterate) -> bool:
        """Whether slowing down can remove the remaining violations.

        It cannot remove violations of equations.
        """
        rows = program.rows
        violation = rows.violation(state.values)
        equations = violation[rows.lower == rows.upper]
        small = np.max(violation, initial=0.0) <= RESTORABLE
        return bool(small and np.max(equations, initial=0.0) <= self.feasibility)

    def slowed(self, program: NonlinearProgram, state: Iterate) -> Iterate:
        """Restore feasibility by slowing a motion down; unchanged if that fails.

        The iteration stops when the objective has settled, which may be before the last
        second-order errors are removed. Slowing down by half of such an error removes
        it, at that cost in T. For small errors another program would do no better.
        """
        if state.violation <= self.feasibility or not self.restorable(program, state):
            return state
        former, violation = 1.0, state.violation
        factor = 1.0 + SLOWDOWN * violation
        for _ in range(RESTORATIONS):
            z, values = program.slower(state.z, factor, state.values)
            trial = replace(state, z=z, values=values)
            if trial.violation <= self.feasibility:
                return trial
            rate = (violation - trial.violation) / (factor - former)
            former, violation = factor, trial.violation
            # If the violation keeps falling at this rate, it vanishes at this factor.
            beyond = factor + violation / rate if rate > 0.0 else np.inf
            factor = min(beyond, 1.0 + 2.0 * (factor - 1.0))
        return state


@dataclass(frozen=True, eq=False)
class MinimumTime(Objective):
    """The duration, and a small weight on the jumps of the controls.

    Attributes:
        jump_weight: Weight of the jumps [s].
        squared: Whether the squares of the jumps are added up (regularisation,
            Tikhonov, 1963); otherwise their absolute values, the total variation.
    """

    jump_weight: float = 0.0
    squared: bool = False

    @staticmethod
    def of(
        options: Options, jump_weight: float = 0.0, *, squared: bool = False
    ) -> MinimumTime:
        """Minimum time, or any feasible motion, as options ask for.

        Args:
            options: Options with the kind of objective and the tolerances.
            jump_weight: Weight of the jumps of the controls [s].
            squared: Whether the squares of the jumps are added up.
        """
        return MinimumTime(
            options.tolerance,
            options.feasibility,
            jump_weight,
            squared,
            any_will_do=options.objective == "feasible",
        )

    def value(self, program: NonlinearProgram, z: Array, values: Array) -> float:
        """The duration [s]."""
        return float(program.cost @ z)

    def model(
        self, program: NonlinearProgram, state: Iterate, linearization: Linearization
    ) -> Model:
        """Model of the duration and the jumps, with a proximal term if needed.

        A linear program leaves unknowns that do not affect the duration anywhere in the
        trust region, which causes violations that later steps have to remove. The total
        variation determines them, or else a small weight on the square of the step
        (proximal points, Rockafellar, 1976).
        """
        cost, weight = program.cost, self.jump_weight
        jumps = program.transcription.variation(state.z) if weight > 0.0 else None

        def value(z: Array, _: Array) -> float:
            varied = 0.0
            if jumps is not None:
                varied = jumps.squares(z) if self.squared else jumps.total(z)
            return float(cost @ z) + weight * varied

        if jumps is not None and not self.squared:
            return Model(value, cost, sp.csr_matrix((0, cost.size)), jumps, weight)
        reach = np.max(np.abs(linearization.steps), axis=0)
        moving = (reach > 0.0) & (cost == 0.0)
        share = 2.0 * PROXIMAL * state.duration / max(int(moving.sum()), 1)
        near = sp.diags(np.sqrt(share) * moving / np.where(moving, reach, 1.0))
        if jumps is None:
            return Model(value, cost, near.tocsr())
        slope = jumps.matrix.T @ jumps.at(state.z)
        root = sp.vstack([math.sqrt(2.0 * weight) * jumps.matrix, near], format="csr")
        return Model(value, cost + 2.0 * weight * slope, root)
