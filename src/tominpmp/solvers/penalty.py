r"""The exterior penalty function method, with which the paper compares its method.

.. math::
    \min_{u, T} \; T + K \Big( \sum_i g_i^2
        + \sum_l \frac{1}{N} \sum_k \max(0, b_l(x_k))^2 \Big), \qquad u_l \le u \le u_u

for growing K (sequential unconstrained minimisation; Fiacco and McCormick, 1968). Each
round starts from the result of the last one, and is solved by a quasi-Newton method
with bounds (L-BFGS-B; Byrd, Lu, Nocedal and Zhu, 1995). A gradient takes one backward
sweep of the adjoint equation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from tominpmp.arrays import Array
from tominpmp.options import Options
from tominpmp.solvers.iterate import WEIGHT_GROWTH, StepOutcome, TrialPoint
from tominpmp.solvers.loop import Loop, Rule, until_settled
from tominpmp.stopping import check
from tominpmp.transcription.adjoint import AdjointTranscription

# The first weight K, as a multiple of T. With a smaller one T is up to 7 % shorter on
# the paper's example, and planning takes twice as long. The weight that ends the
# rounds, as a multiple of T.
FIRST_WEIGHT = 30.0
LARGEST_WEIGHT = 1e12
# Most quasi-Newton iterations of a round, and of all rounds for each iteration of
# ``options.max_iterations``: one of them costs about a tenth of an iteration with a
# linear program. A round that ends early is completed by the next one, which has
# smaller violations.
ROUND_ITERATIONS = 100
ITERATION_FACTOR = 20
MEMORY = 30
# Bounds of the duration, as multiples of the initial one. Without the lower bound, the
# round with the smallest weight would shrink the duration to almost nothing.
DURATIONS = (0.3, 20.0)


def penalty_rounds(options: Options, z: Array) -> tuple[PenaltyRound, Rule]:
    """Rounds of the penalty method, and their stop rule.

    Args:
        options: Options with the iteration limit.
        z: The initial iterate.
    """
    most = ITERATION_FACTOR * options.max_iterations
    return PenaltyRound(z, most), until_settled(LARGEST_WEIGHT, most)


@dataclass(frozen=True, eq=False)
class PenaltyRound:
    """A round of the exterior penalty function method on the adjoint transcription.

    Each quasi-Newton iteration has a record.

    Attributes:
        first: The initial iterate, whose duration scales units and bounds.
        most: Most quasi-Newton iterations of all rounds.
    """

    first: Array
    most: int

    def first_weight(self, kind: str) -> float:
        """The weight K, which is that of all kinds of violations."""
        return FIRST_WEIGHT

    def __call__(self, loop: Loop) -> None:
        """Minimise for the present weight, and raise it for the next round."""
        self.minimise(loop)
        settled = loop.state.violation <= loop.objective.feasibility
        if loop.outcome is not None:
            loop.outcome = replace(loop.outcome, settled=settled)
        if not settled:
            weights = WEIGHT_GROWTH * loop.state.weights
            loop.state = replace(loop.state, weights=weights)

    def minimise(self, loop: Loop) -> None:
        """Minimise the duration plus the penalty, within the limits of a round."""
        nlp, rows = loop.program, loop.program.rows
        torques = nlp.transcription
        assert isinstance(torques, AdjointTranscription)  # noqa: S101
        scale, lower, upper = _scaled(torques, self.first)
        weight = float(loop.state.weights[0])
        # The mean over the instants stands for the integral over tau.
        goal = rows.kind == rows.kinds.index("goal")
        share = np.where(goal, 1.0, 1.0 / np.bincount(rows.group)[rows.group])
        latest = TrialPoint(loop.state.z, loop.state.values, np.inf)

        def function(y: Array) -> tuple[float, Array]:
            nonlocal latest
            check()
            z = y * scale
            values = nlp.evaluate(z)
            excess = np.maximum(values - rows.upper, 0.0)
            excess += np.minimum(values - rows.lower, 0.0)
            total = float(nlp.cost @ z) + weight * float(share @ excess**2)
            latest = TrialPoint(z, values, total)
            gradient = nlp.cost
            # Where the motion is not finite, the line search shortens its step.
            if nlp.transcription.motion(z).finite:
                gradient = gradient + nlp.gradient(z, 2.0 * weight * share * excess)
            return total, gradient * scale

        def callback(y: Array) -> None:
            nonlocal nlp
            z, state = y * scale, loop.state
            values = latest.values if np.array_equal(z, latest.z) else nlp.evaluate(z)
            gained = state.duration - float(nlp.cost @ z)
            trial = TrialPoint(z, values, latest.merit)
            state = replace(state, z=z, values=values)
            loop.advance(state, StepOutcome(trial, 0.0, gained, 1.0, True))
            nlp = loop.program
            if len(loop.history) >= self.most:
                raise StopIteration

        minimize(
            function,
            loop.state.z / scale,
            jac=True,
            method="L-BFGS-B",
            bounds=np.stack([lower, upper], axis=1),
            callback=callback,
            options={
                "maxiter": ROUND_ITERATIONS,
                "maxfun": 2 * ROUND_ITERATIONS,
                "maxcor": MEMORY,
                "ftol": 1e-8,
                "gtol": 1e-7,
            },
        )


def _scaled(torques: AdjointTranscription, z: Array) -> tuple[Array, Array, Array]:
    """Units of the unknowns, and their bounds in these units.

    Torques are scaled as functions of time: the torque of an interval is weighted by
    the length of the interval. In the same time, the iterations then end 6 % to 10 %
    lower than with torques in shares of their ranges.
    """
    columns, intervals = torques.shares.shape[1], torques.intervals
    count = z.size - columns
    lengths = torques.shares @ z[count:]
    units = np.repeat(np.sqrt(lengths.sum() / lengths), count // intervals)
    least, most = torques.torque_bounds
    rest = np.ones(columns)
    return (
        np.concatenate([units, z[count:]]),
        np.append(least.ravel() / units, DURATIONS[0] * rest),
        np.append(most.ravel() / units, DURATIONS[1] * rest),
    )
