"""The last word of a search: is the motion an optimum, and if not, go on.

An iteration ends when it makes no more progress, which proves nothing: rows of
distances beside the nearest instants may hold it, a small trust region, or a padding
that costs time. So the best motion is put to the test of its certificate. Where small
changes of it promise too much it is improved, with less padding where the padding is
the gain. Only a motion that passes is called locally optimal; else the status says
which limit was reached, and the message how much small changes promise still.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.certificate.minimum_principle import TOLERANCE, Findings, examine
from tominpmp.certificate.motion import LONGEST
from tominpmp.certificate.stays import stays_where_it_moves, without_stays
from tominpmp.options import Options
from tominpmp.planner.automatic_options import near_to_it
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.first_program import rested
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import Schedule, Work
from tominpmp.problem.problem import Problem
from tominpmp.solvers.exchange import RowExchange
from tominpmp.solvers.loop import solve
from tominpmp.solvers.objective import MinimumTime
from tominpmp.solvers.trust_region_step import ACCURACY, trust_regions
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.distance_rows import with_rows_at
from tominpmp.transcription.layout import Layout
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

logger = logging.getLogger(__name__)

# Rounds of improvement, each ended by a certificate; iterations of a round, and its
# trust region as a share of the usual one.
ROUNDS, ITERATIONS, RADIUS = 4, 25, 0.1
# Iterations that there may be in any case.
FEWEST = 60
# Iteration limit of a motion whose gap to the lower bound is at most this share of T.
FEW, SMALL_GAP = 10, 0.03
# Where the padding of distances is worth this share of the promise, this much of it is
# left for the next round.
PADDING_SHARE, LESS_PADDING = 0.3, 0.3
# A motion is near to whatever is within this share of the reach beyond its margin.
CLOSE = 0.01
# The rounds end with one that has gained no more than this share of T.
LITTLE = 5e-4
# Predicted decrease of an optimal motion at most, as a share of T, where effort is
# "thorough".
THOROUGH = 1e-3
# A motion that the certificate accepts is improved all the same if its predicted
# decrease exceeds this share of T: two of 120 motions in clutter, for which other
# orders of obstacles and other solvers find the gain at once.
WORTH_A_TRY = 5e-3
# Without close pairs the certificate is skipped if the last predicted decrease,
# extrapolated to the changes that the certificate allows, is below this share of the
# tolerance.
SKIPPED = 0.3


def certified(state: PlanState) -> Schedule[None]:
    """Go on with the best motion until it keeps the first-order conditions.

    Motions that stay where obstacles move have no certificate, and are left as they
    are.

    Args:
        state: The plan.
    """
    best, options, problem = state.incumbent, state.options, state.problem
    tolerance = tolerance_of(options)
    if best is None or stays_where_it_moves(problem):
        return
    if best.status is Status.CONVERGED and last_step_suffices(
        problem, options, best, tolerance
    ):
        return
    bound = state.lower_bound(problem).T
    if (1.0 - tolerance) * best.duration <= bound:
        # No motion at all is faster by more than that.
        state.amend(best, status=Status.CONVERGED)
        return
    # As many iterations as the search has had, some at least, and none too many.
    had = sum(len(candidate.history) for candidate in state.candidates)
    limit = min(max(had, FEWEST), options.max_iterations)
    if (1.0 - SMALL_GAP) * best.duration <= bound:
        limit = min(limit, FEW)

    def make(system: ProblemFunctions, *_: object) -> Candidate:
        return CertifiedDescent(system, state, tolerance, limit).run(best)

    settled = yield Work.from_best(state, best, make)
    if settled is None or settled.duration > best.duration:
        status = best.status
        if settled is None and status is Status.CONVERGED:
            # The test was cut short, or failed: nothing is known of the motion.
            status = state.cut_short or Status.STALLED
        state.amend(best, status=status)


def tolerance_of(options: Options) -> float:
    """Gain that small changes of an optimal motion may promise, as a share of T."""
    return THOROUGH if options.effort == "thorough" else TOLERANCE


def last_step_suffices(
    problem: Problem, options: Options, candidate: Candidate, tolerance: float
) -> bool:
    """Whether the last step of an iteration makes the certificate needless.

    The gain that a linear program predicts within a trust region is at least the share
    of its gain within a larger one that the region is of the larger one.
    """
    if len(candidate.history) < 2 or candidate.layout is None:
        return False  # other methods have steps and radii of other kinds
    h = np.diff(candidate.trajectory.t)
    if np.max(h) > LONGEST * h.sum():
        return False  # the certificate allows of more changes than the grid
    if np.any(problem.robot.friction):
        return False  # nor does a program let joints turn elsewhere
    if _anything_near(problem, candidate):
        return False
    before, last = candidate.history[-2:]
    radius = min(options.trust_region * min(before.radius, last.radius), 1.0)
    # The linear program was solved to this gap: it may have predicted too little.
    gap = ACCURACY * options.tolerance
    promised = (last.predicted / last.duration + gap) / max(radius, 1e-300)
    return last.accepted and promised <= SKIPPED * tolerance


def _anything_near(problem: Problem, candidate: Candidate) -> bool:
    """Whether the replay of a motion has come near anything."""
    judged = candidate.verification
    if judged is None:
        return True
    # Margins by pair would have all meshes cut; the links of a single arm have none.
    scenes = any(len(phase.scene) for phase in problem.phases)
    alone = not scenes and not problem.robot.parts
    margin = 0.0 if alone else problem.margin
    close = CLOSE * ProblemFunctions.of(problem).reach
    return judged.min_clearance < margin + close


@dataclass(eq=False)
class CertifiedDescent:
    """Improves a motion until its certificate accepts it.

    Attributes:
        system: The functions of the problem.
        state: The plan.
        tolerance: Gain that small changes may promise, as a share of T.
        limit: How many iterations there may be.
    """

    system: ProblemFunctions
    state: PlanState
    tolerance: float
    limit: int

    @property
    def spent(self) -> bool:
        """Whether there have been as many iterations as there may be."""
        return len(self.state.records) >= self.limit

    def run(self, candidate: Candidate) -> Candidate:
        """The motion, or a faster one, with the status that it deserves."""
        best, seen = candidate, self.examine(candidate)
        segments = self.system.problem.segments
        layout = candidate.layout or Layout.of_motion(candidate.trajectory, segments)
        gain = np.inf
        for _ in range(ROUNDS):
            spent = self._spend_padding(seen)
            idle = gain <= LITTLE and not spent
            if self._enough(seen) or layout is None or idle or self.spent:
                break
            further = self._further(best, layout)
            gain = 1.0 - further.duration / best.duration
            if gain > self.tolerance:
                # The search had not come to its end.
                more = min(FEWEST, self.state.options.max_iterations)
                self.limit = max(self.limit, len(self.state.records) + more)
            if gain > 0.0:
                best, layout = further, further.layout
                seen = self.examine(best)
        return self._concluded(best, seen)

    def _enough(self, seen: Findings) -> bool:
        promise = seen.certificate.stationarity
        return seen.certificate.ok and promise <= min(self.tolerance, WORTH_A_TRY)

    def examine(self, candidate: Candidate) -> Findings:
        """The certificate of a motion, and its findings."""
        problem, judged = self.system.problem, candidate.verification
        near = _anything_near(problem, candidate)
        motion = candidate.trajectory
        if problem.segments:
            problem, motion = without_stays(problem, motion)
        seen = examine(problem, motion, judged, self.tolerance, near=near)
        promise = seen.certificate.stationarity
        logger.info("T %.5f s, small changes promise %.1e", candidate.duration, promise)
        return seen

    def _spend_padding(self, seen: Findings) -> bool:
        """Reduce the padding where that is the gain; whether it is."""
        if seen.found is None:
            return False
        given = seen.found.multipliers
        gained = float(given.promise[given.of("clearance")].sum())
        promised = max(seen.certificate.stationarity, self.tolerance)
        spent = gained > PADDING_SHARE * promised
        if spent:
            self.system = self.system.padded(LESS_PADDING)
        return spent

    def _further(self, best: Candidate, layout: Layout) -> Candidate:
        """A faster motion, replayed; the same where there is none."""
        of, z = layout.represented(self.system, best.trajectory)
        program = with_rows_at(NonlinearProgram.of(of).at(z), z, best.row_times)
        program, z = rested(program, z)
        near = near_to_it(self.state.options, RADIUS, ITERATIONS)
        result = solve(
            program,
            MinimumTime.of(near, near.smoothing or 0.0),
            z,
            *trust_regions(near),
            exchange=RowExchange(level=0.0),
            callback=self._seen,
            keep=self.state.keep,
        )
        if result.best is None:
            return best
        found = Candidate.of(best.name, best.initial, result)
        found = replace(found, remark=best.remark, history=())
        if found.trajectory.duration >= best.duration:
            return best
        found = found.verified(self.system.problem, self.state.options)
        return found if found.found else best

    def _seen(self, record: IterationRecord) -> Status | None:
        """See a record; a status ends the iteration."""
        status = self.state(record)
        return status or (Status.ITERATION_LIMIT if self.spent else None)

    def _concluded(self, best: Candidate, seen: Findings) -> Candidate:
        """The motion with the status that it deserves."""
        history = tuple(self.state.records)
        if seen.certificate.ok:
            return replace(best, status=Status.CONVERGED, history=history)
        status = Status.ITERATION_LIMIT if self.spent else Status.STALLED
        if best.status not in (Status.CONVERGED, Status.STALLED):
            status = best.status
        promise = 100.0 * seen.certificate.stationarity
        remark = f"Small changes promise {promise:.2g} % of T"
        intervals = best.trajectory.t.size - 1
        if seen.motion is not None and seen.motion.changes.N > intervals:
            remark += f", some of them on a grid finer than its {intervals} intervals"
        if seen.certificate.stationarity <= self.tolerance:
            remark += f". {seen.certificate.message}".rstrip(".")  # another condition
        remark = f"{best.remark} {remark}.".strip()
        return replace(best, status=status, history=history, remark=remark)
