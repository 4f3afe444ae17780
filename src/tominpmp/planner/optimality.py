"""Certified optimality: check the incumbent by its certificate, and improve it.

An iteration ends when it makes no more progress, which proves nothing: it may be held
up by distance rows that miss the instants of closest approach, by a small trust region,
or by padding of distances that costs time. The incumbent is therefore certified. If
small changes predict too large a gain, it is improved, with less padding where the
padding causes the gain. Only a motion that passes is called locally optimal, or one
that the lower bound proves to be optimal. Otherwise the status says which limit was
reached, and the message has the remaining predicted gain.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial

import numpy as np

from tominpmp.certificate.dwells import no_certificate
from tominpmp.certificate.minimum_principle import TOLERANCE, Examination, examine
from tominpmp.options import Options
from tominpmp.planner.automatic_options import PROMISE, warm_start_options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.finer_grid import LITTLE_PROMISE
from tominpmp.planner.first_program import with_active_rows
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import LESS_PADDING, Schedule, Work
from tominpmp.solvers.objective import MinimumTime
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import Status
from tominpmp.transcription.layout import Layout
from tominpmp.transcription.problem_functions import ProblemFunctions

logger = logging.getLogger(__name__)

# Most rounds of improvement, each of which ends with a certificate.
ROUNDS = 4
# Largest predicted gain of an optimal motion, as a share of T, for effort "thorough".
THOROUGH = 1e-3


def certified(state: PlanState) -> Schedule[None]:
    """Improve the incumbent until it satisfies the first-order conditions.

    Motions with dwells among moving obstacles have no certificate: they are not
    changed, and called optimal only if the lower bound proves it.

    Args:
        state: The plan.
    """
    best, problem = state.incumbent, state.problem
    tolerance = tolerance_of(state.options)
    if best is None:
        return
    converged = best.status is Status.CONVERGED
    if (1.0 - tolerance) * best.duration <= state.lower_bound(problem).T:
        # By the lower bound no motion at all gains more than the tolerance.
        state.amend(best, status=Status.CONVERGED)
        return
    if reason := no_certificate(problem):
        if converged:
            state.amend(best, status=Status.STALLED, remark=f"{reason.capitalize()}.")
        return

    system = ProblemFunctions.of(problem.alternative_of(best.trajectory))
    examine = partial(_examined, best, tolerance)
    examined = yield Work(system, examine, self_collision_rows=best.clearance_rows)
    if converged and (examined is None or examined.duration > best.duration):
        # A certificate that was cut short, or failed, does not certify the motion.
        state.amend(best, status=state.cut_short or Status.STALLED)
    # A motion that the certificate accepts is nevertheless improved if the predicted
    # gain is worth it: for two of 120 motions in clutter, other orders of obstacles and
    # other solvers find the gain at once.
    gain, complete = np.inf, state.complete
    for _ in range(ROUNDS):
        if examined is None or examined.examination is None:
            return
        certificate = examined.examination.certificate
        # The result of a plan with less time would be the same: the time limit is the
        # regular end of an improvement of a motion that is accepted.
        state.complete = complete or certificate.ok
        spent = _is_spent_on_padding(examined.examination, tolerance)
        system = system.padded(LESS_PADDING) if spent else system
        optimal = certificate.ok and certificate.stationarity <= PROMISE
        worth = PROMISE if certificate.ok else LITTLE_PROMISE
        if optimal or (gain <= worth and not spent):
            return
        improve = partial(_improved, examined, best.remark, state, tolerance)
        further = yield Work(system, improve, self_collision_rows=best.clearance_rows)
        gain = 0.0 if further is None else 1.0 - further.duration / examined.duration
        examined = further if gain > 0.0 else examined


def tolerance_of(options: Options) -> float:
    """Largest predicted gain of small changes of an optimal motion, as a share of T."""
    return THOROUGH if options.effort == "thorough" else TOLERANCE


def _examined(
    candidate: Candidate, tolerance: float, system: ProblemFunctions, *_: object
) -> Candidate:
    """The candidate with its certificate, and with the status that follows from it.

    Args:
        candidate: The candidate.
        tolerance: Largest predicted gain of an optimal motion, as a share of T.
        system: Functions of the problem.
    """
    motion, replay = candidate.trajectory, candidate.verification
    assert replay is not None  # noqa: S101
    # Distances are evaluated only if the predicted gain without them is worth an
    # improvement, as meshes may have to be decomposed first.
    enough = min(tolerance, PROMISE)
    findings = examine(system.problem, motion, replay, tolerance, enough=enough)
    promise = findings.certificate.stationarity
    logger.info("T %.5f s, small changes promise %.1e", candidate.duration, promise)
    return replace(_with_status(candidate, findings, tolerance), examination=findings)


def _is_spent_on_padding(findings: Examination, tolerance: float) -> bool:
    """Whether the padding of distances causes most of the predicted gain."""
    if findings.dual is None:
        return False
    multipliers = findings.dual.multipliers
    gained = float(multipliers.predicted_gain[multipliers.of("clearance")].sum())
    promised = max(findings.certificate.stationarity, tolerance)
    return 2.0 * gained > promised


def _improved(
    best: Candidate,
    remark: str,
    state: PlanState,
    tolerance: float,
    system: ProblemFunctions,
    *_: object,
) -> Candidate:
    """A faster motion with its certificate, or the same candidate.

    Args:
        best: The candidate, with its certificate.
        remark: Remark on the candidate before it was examined.
        state: The plan.
        tolerance: Largest predicted gain of an optimal motion, as a share of T.
        system: Functions of the problem.
    """
    layout = best.layout or Layout.of_motion(best.trajectory, system.problem.segments)
    if layout is None:
        return best
    program, z = with_active_rows(*layout.represented(system, best.trajectory))
    warm = warm_start_options(state.options)
    objective = MinimumTime.of(warm, warm.smoothing or 0.0)
    # After a stop a motion with a certificate is worth more than a slightly faster one.
    keep = None if best.status is Status.CONVERGED else state.keep
    result = state.solve(program, objective, z, *trust_regions(warm), keep=keep)
    if result.best is None or result.best.duration >= best.duration:
        return best
    faster = replace(Candidate.of(best.initial, result), remark=remark)
    faster = faster.verified(system.problem, state.options)
    return _examined(faster, tolerance, system) if faster.confirmed else best


def _with_status(best: Candidate, findings: Examination, tolerance: float) -> Candidate:
    """The motion with its certified status, and a remark on the predicted gain."""
    certificate = findings.certificate
    if certificate.ok:
        return replace(best, status=Status.CONVERGED)
    status = Status.STALLED if best.status is Status.CONVERGED else best.status
    remark = f"Small changes promise {100.0 * certificate.stationarity:.2g} % of T"
    intervals = best.trajectory.t.size - 1
    if certificate.t.size - 1 > intervals:
        remark += f", some of them on a grid finer than its {intervals} intervals"
    if certificate.stationarity <= tolerance:  # other condition
        remark += f". {certificate.message}".rstrip(".")
    if findings.dual is None:
        remark = certificate.message.rstrip(".")
    remark = f"{best.remark} {remark}.".strip()
    return replace(best, status=status, remark=remark)
