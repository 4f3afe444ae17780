r"""The exterior penalty function method, which the paper compares itself with.

.. math::
    \min_{u, T} \; T + K \Big( \sum_i g_i^2
        + \sum_l \frac{1}{N} \sum_k \max(0, b_l(x_k))^2 \Big), \qquad u_l \le u \le u_u

for growing K (sequential unconstrained minimisation; Fiacco and McCormick, 1968). Each
round starts from the last and is solved by a quasi-Newton method with bounds (L-BFGS-B;
Byrd, Lu, Nocedal and Zhu, 1995); gradients come from one backward sweep of the adjoint
equation.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from tominpmp.arrays import Array
from tominpmp.options import Options
from tominpmp.solvers.callbacks import Callback, Keep, go_on, keep_nothing
from tominpmp.solvers.iterate import Iterate, SlpResult
from tominpmp.solvers.merit import Merit
from tominpmp.solvers.trust_region import TrustRegion
from tominpmp.status import IterationRecord, Status
from tominpmp.stopping import check
from tominpmp.transcription.adjoint import AdjointTranscription
from tominpmp.transcription.program import NonlinearProgram

# The first weight K, in shares of T, and its growth from round to round. From a smaller
# one the motions end faster, up to 7 % on the paper's example, and take twice as long.
FIRST_WEIGHT = 30.0
WEIGHT_GROWTH = 10.0
ROUNDS = 11
# Violations fall like 1 / K; where two rounds leave more than this share of them, no
# weight will remove the rest.
STUCK = 0.5
# Quasi-Newton iterations a round, and in all for each of ``options.max_iterations``:
# one of them costs about a tenth of an iteration with a linear program. What a round
# leaves undone the next one does, with smaller violations.
ROUND_ITERATIONS = 100
ITERATION_FACTOR = 20
MEMORY = 30
# Bounds of the duration in shares of the initial one; without the first, the round with
# the smallest weight begins with a motion that hardly lasts.
DURATIONS = (0.3, 20.0)


class _Stop(Exception):
    """Leaves the quasi-Newton method.

    Attributes:
        status: Why.
    """

    def __init__(self, status: Status) -> None:
        super().__init__(status.value)
        self.status = status


@dataclass(frozen=True, eq=False)
class PenaltySolver:
    """Exterior penalty function method on the adjoint transcription.

    Attributes:
        nlp: The nonlinear program.
        options: Tolerances and limits.
        callback: Sees every record; a status ends the iteration.
        keep: Is given the best motion so far, or the present one.
    """

    nlp: NonlinearProgram
    options: Options
    callback: Callback = go_on
    keep: Keep = keep_nothing

    def run(self, z: Array) -> SlpResult:
        """Minimise with growing weights until the violations are gone."""
        run = _Run(self, z)
        status = Status.INFEASIBLE
        weight = FIRST_WEIGHT * run.duration
        left: list[float] = []
        try:
            for _ in range(ROUNDS):
                run.minimise(weight)
                left.append(run.iterate.violation)
                if left[-1] <= self.options.feasibility:
                    status = Status.CONVERGED
                    break
                if len(left) > 2 and left[-1] > STUCK * left[-3]:
                    break
                weight *= WEIGHT_GROWTH
        except _Stop as stop:
            status = stop.status
        return SlpResult(status, run.iterate, run.best, tuple(run.history))


class _Run:
    """One run: the present iterate, the best one and the history."""

    def __init__(self, solver: PenaltySolver, z: Array) -> None:
        nlp = solver.nlp
        self.solver, self.nlp = solver, nlp
        self.begin = time.perf_counter()
        self.history: list[IterationRecord] = []
        self.best: Iterate | None = None
        self.rows = nlp.rows
        # The mean over the instants stands for the integral over tau.
        counts = np.bincount(self.rows.group)
        goal = self.rows.kind == self.rows.kinds.index("goal")
        self.share = np.where(goal, 1.0, 1.0 / counts[self.rows.group])
        transcription = nlp.transcription
        assert isinstance(transcription, AdjointTranscription)  # noqa: S101
        intervals, columns = transcription.shares.shape
        torques = z.size - columns
        # The torques as functions of time: one of an interval counts by its length.
        # With these units the iterations end 6 % to 10 % lower than with each torque
        # in its range, in the same time.
        lengths = transcription.shares @ z[torques:]
        unit = np.sqrt(lengths.sum() / lengths)
        units = np.repeat(unit, torques // intervals)
        rest = np.ones(columns)
        self.scale = np.concatenate([units, z[torques:]])
        lower, upper = transcription.torque_bounds
        self.lower = np.concatenate([lower / units, DURATIONS[0] * rest])
        self.upper = np.concatenate([upper / units, DURATIONS[1] * rest])
        self.iterate = self.make(z, nlp.evaluate(z))
        solver.keep(nlp, self.iterate)
        # What the quasi-Newton method evaluated last: unknowns, rows and objective.
        self.trial = z, self.iterate.values, np.inf

    @property
    def duration(self) -> float:
        """T [s]."""
        return self.iterate.duration

    def make(self, z: Array, values: Array) -> Iterate:
        """Wrap unknowns and row values as an iterate."""
        merit = Merit(self.nlp.cost, self.rows, 0.0, np.zeros(len(self.rows.kinds)))
        return Iterate(z, values, merit, TrustRegion(), np.zeros(self.rows.size))

    def minimise(self, weight: float) -> None:
        """One round with the weight K."""

        def function(y: Array) -> tuple[float, Array]:
            check()
            z = y * self.scale
            values = self.nlp.evaluate(z)
            over = np.maximum(values - self.rows.upper, 0.0)
            under = np.minimum(values - self.rows.lower, 0.0)
            excess = over + under
            total = float(self.nlp.cost @ z)
            total += weight * float(self.share @ excess**2)
            self.trial = z, values, total
            gradient = self.nlp.cost
            if self.nlp.transcription.motion(
                z
            ).finite:  # else the line search turns back
                force = 2.0 * weight * self.share * excess
                gradient = gradient + self.nlp.gradient(z, force)
            return total, gradient * self.scale

        def callback(y: Array) -> None:
            self.note(y * self.scale)

        minimize(
            function,
            self.iterate.z / self.scale,
            jac=True,
            method="L-BFGS-B",
            bounds=np.stack([self.lower, self.upper], axis=1),
            callback=callback,
            options={
                "maxiter": ROUND_ITERATIONS,
                "maxfun": 2 * ROUND_ITERATIONS,
                "maxcor": MEMORY,
                "ftol": 1e-8,
                "gtol": 1e-7,
            },
        )

    def note(self, z: Array) -> None:
        """Record an iterate of the quasi-Newton method."""
        solver, before = self.solver, self.iterate
        known = np.array_equal(z, self.trial[0])
        values = self.trial[1] if known else self.nlp.evaluate(z)
        self.iterate = iterate = self.make(z, values)
        self.nlp = self.nlp.near(z)
        if iterate.violation <= solver.options.feasibility and (
            self.best is None or iterate.duration < self.best.duration
        ):
            self.best = iterate
        solver.keep(self.nlp, self.best or iterate)
        record = IterationRecord(
            iteration=len(self.history),
            duration=iterate.duration,
            violation=iterate.violation,
            objective=self.trial[2],
            predicted=0.0,
            actual=before.duration - iterate.duration,
            radius=1.0,
            accepted=True,
            programs=0,
            pivots=0,
            program_seconds=0.0,
            seconds=time.perf_counter() - self.begin,
        )
        self.history.append(record)
        status = solver.callback(record)
        limit = ITERATION_FACTOR * solver.options.max_iterations
        if status is None and len(self.history) >= limit:
            status = Status.ITERATION_LIMIT
        if status is not None:
            raise _Stop(status)
