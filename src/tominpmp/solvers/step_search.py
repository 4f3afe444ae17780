"""Search along a step: second-order corrections, then a line search on the merit.

The error of a linearisation is put into the right-hand side and the same program is
solved once more, which keeps steps along curved constraints from being refused
(Maratos effect; Fletcher and Sainz de la Maza, 1989). If the merit still does not fall,
a shorter step is sought: that costs evaluations, while a smaller trust region would
cost another program.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from tominpmp.arrays import Array
from tominpmp.solvers.iterate import Outcome, Trial
from tominpmp.solvers.subproblem import Subproblem
from tominpmp.solvers.trust_region import ACCEPT
from tominpmp.stopping import check
from tominpmp.transcription.base import Program

# Another correction follows while one leaves at most this share of the violation.
CONTRACTION = 0.5


@dataclass(frozen=True, eq=False)
class StepSearch:
    """Looks for a step that lowers the merit.

    Attributes:
        nlp: The nonlinear program.
        merit: Merit of unknowns and row values.
        frame: The program of the iteration, to correct its right-hand side.
        corrections: How many corrections are made at most.
        dampings: Shares of the step that the line search tries, falling.
        room: Rows that have more of it need not be exact.
    """

    nlp: Program
    merit: Callable[[Array, Array], float]
    frame: Subproblem
    corrections: int
    dampings: tuple[float, ...]
    room: float = math.inf

    def run(
        self,
        origin: Trial,
        step: Array,
        predicted: float,
        resolve: Callable[[Array], Array | None],
        enough: Callable[[Trial, float], bool],
        reached: Array | None = None,
    ) -> Outcome:
        """Try the step, corrections of it, then shorter ones.

        Args:
            origin: Where the iteration stands.
            step: The step of the program.
            predicted: By how much it is to lower the merit.
            resolve: Solves the program again for the error of its rows; the step, None
                if that fails.
            enough: Whether a trial, with its violation, needs no correction.
            reached: Row values where the step leads, if they are known.
        """
        frame, rows = self.frame, self.nlp.rows
        z, values = origin.z, origin.values
        trial = best = self.attempt(z, step, known=reached)
        for _ in range(self.corrections):
            left = rows.largest_violation(trial.values)
            if enough(trial, left):
                break
            error = trial.values[frame.rows] - (
                values[frame.rows] + frame.change(trial.z - z)
            )
            again = resolve(error)
            if again is None:
                break
            trial = self.attempt(z, again)
            best = min(best, trial, key=lambda trial: trial.merit)
            if rows.largest_violation(trial.values) > CONTRACTION * left:
                break
        ratio = (origin.merit - best.merit) / max(predicted, 1e-12)
        if ratio < ACCEPT:
            for damping in self.dampings:
                trial = self.attempt(z, step, damping)
                if origin.merit - trial.merit > ACCEPT * damping * predicted:
                    best = trial
                    break
            else:
                best = replace(best, damping=self.dampings[-1])
        actual = origin.merit - best.merit
        return Outcome(best, predicted, actual, ratio, actual > 0.0)

    def attempt(
        self, z: Array, step: Array, damping: float = 1.0, known: Array | None = None
    ) -> Trial:
        """Evaluate a share of a step, unless the row values there are known."""
        check()
        there = z + damping * step
        values = self.nlp.evaluate(there, self.room) if known is None else known
        return Trial(there, values, self.merit(there, values), damping)
