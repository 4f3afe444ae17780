r"""Certificate of the minimum principle: how close a motion is to an extremal.

The duration T is minimised: with the costates :math:`p = \partial T / \partial x`, the
derivatives of the remaining time with respect to the state, the Hamiltonian is

.. math:: H = 1 + p^T f(x, u) = 0

at all times of an optimal motion (Pontryagin, Boltyanskii, Gamkrelidze and Mishchenko,
1962), and the torques minimise it: where the switching function :math:`\sigma = H_u` of
a joint is positive, the torque is at the lower limit, and where it is negative, at the
upper limit. On state limits, for example of speeds, the costate jumps and H does not
(Hartl, Sethi and Vickson, 1995). Where obstacles move, their effect on later clearances
is part of H.

The certificate uses no result of the solver that planned the motion: costates and
multipliers come from a linear program at the motion
(:mod:`tominpmp.certificate.dual_program`). These costates are compared with the adjoint
equation of the paper's differentials (equations 12 and 13) in real time,

.. math:: \dot p = -f_x^T p

between the instants at which a state limit is active, where the costate decreases by
the multiplier times the gradient of the limit. The program uses accelerations and the
inverse dynamics, the adjoint equation torques and the forward dynamics: each checks the
other.

On the clock of a controller, segments last whole periods: a predicted gain may then be
as large as the share of T that rounding to periods may have cost (:func:`clock_share`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from tominpmp.arrays import Array, BoolArray
from tominpmp.blas_threads import on_one_thread
from tominpmp.certificate.certificate import ActiveLimit, Certificate
from tominpmp.certificate.dual_program import PLACES, DualSolution, solve_dual_program
from tominpmp.certificate.dwells import without_dwells
from tominpmp.certificate.limits import PASSIVE
from tominpmp.certificate.motion import GridMotion
from tominpmp.certificate.optimality_report import (
    conditions_kept,
    failed_conditions,
    subject_name,
)
from tominpmp.checks import instance, number
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import FEWEST_PERIODS
from tominpmp.problem.joint_limits import need_smooth
from tominpmp.problem.problem import Problem
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.verification.stages import checked_in_segments
from tominpmp.verification.verification import Verification, verify

# Largest predicted gain of a certified motion, as a share of the duration.
TOLERANCE = 0.01
# Slack, as a share of half the torque range, up to which a torque is at its limit;
# switching function below which any torque obeys; and slack up to which a limit is
# active.
AT_LIMIT = 0.02
SINGULAR = 0.02
ON_LIMIT = 0.01
# Multiplier, as a density over time, above which a limit counts as active.
LEAST_MULTIPLIER = 0.01
# Rounding error of the number of periods of a segment, and largest speed of a joint at
# rest [rad/s or m/s].
SAME = 1e-6


@on_one_thread
def certify(
    problem: Problem,
    trajectory: Trajectory | Samples,
    *,
    verification: Verification | None = None,
    tolerance: float = TOLERANCE,
    control_period: float | None = None,
) -> Certificate:
    """Check the first-order conditions of a motion, planned by any method.

    Args:
        problem: The problem that the motion solves.
        trajectory: The motion; samples, for example from a file, are joined into a
            motion first.
        verification: Verification of the motion; None to replay it here. A motion that
            fails the verification is not certified.
        tolerance: Largest predicted gain of small changes, as a share of the duration.
        control_period: Period of the controller clock of the motion [s], on which no
            motion is faster by less than a period: the share of the duration that
            rounding to it may have cost is added to the tolerance. None without a
            clock.

    Returns:
        The certificate.

    Raises:
        ProblemError: If the motion has other joints than the robot, values that are not
            finite, or a dwell while obstacles move; or another argument is invalid.
        ScenarioError: If the samples have other joints than the robot.
    """
    begin = time.perf_counter()
    instance(problem, Problem, "problem")
    if verification is not None:
        instance(verification, Verification, "verification", "a Verification or None")
    expected = "a share of the duration, >= 0"
    tolerance = number(tolerance, "tolerance", expected, least=0.0)
    period, expected = control_period, "seconds > 0 or None"
    if period is not None:
        period = number(period, "control_period", expected, above=0.0)
    trajectory = checked_in_segments(problem, trajectory)
    # Alternatives of a goal may differ in their number of rows.
    whole, problem = problem, problem.alternative_of(trajectory)
    if verification is None:
        verification = verify(whole, trajectory)
    findings = examine(problem, trajectory, verification, tolerance, period=period)
    return replace(findings.certificate, seconds=time.perf_counter() - begin)


class Examination(NamedTuple):
    """A certificate, and the multipliers from which it is derived.

    Attributes:
        certificate: The certificate.
        dual: Costates and multipliers; None if the conditions cannot be evaluated.
    """

    certificate: Certificate
    dual: DualSolution | None


def examine(
    problem: Problem,
    trajectory: Trajectory,
    verification: Verification,
    tolerance: float,
    *,
    enough: float = 0.0,
    period: float | None = None,
) -> Examination:
    """Check the first-order conditions of a motion whose joints were checked before.

    Args:
        problem: The problem that the motion solves.
        trajectory: The motion, whose dwells are left out.
        verification: Verification of the motion.
        tolerance: Largest predicted gain of small changes, as a share of the duration.
        enough: Predicted gain up to which distances need not be evaluated.
        period: Period of the controller clock of the motion [s]: the share of the
            duration that rounding to it may have cost is added to the tolerance. None
            without a clock.

    Raises:
        ProblemError: If the motion has a dwell while obstacles move.
    """
    problem, trajectory = without_dwells(problem, trajectory)
    rounding = 0.0 if period is None else clock_share(trajectory, period)
    tolerance += rounding
    with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
        motion = GridMotion.of(ProblemFunctions.of(problem), trajectory)
        dual = solve_dual_program(motion, enough)
        if dual is not None:
            out = _certificate(motion, dual, verification, tolerance, rounding)
            return Examination(out, dual)
    return Examination(_unevaluated(trajectory, verification, tolerance), None)


def _unevaluated(
    trajectory: Trajectory, verification: Verification, tolerance: float
) -> Certificate:
    """Certificate of a motion whose conditions cannot be evaluated."""
    n, N, T = trajectory.n, trajectory.t.size - 1, trajectory.duration
    stands = verification.ok and not T
    moves = T and (np.any(trajectory.v) or np.any(np.ptp(trajectory.q, axis=0)))
    return Certificate(
        joint_names=trajectory.joint_names,
        ok=stands,
        message="The first-order conditions of the motion could not be evaluated: the "
        "linear program of its small changes has no solution."
        if moves
        else "The arm does not move, so that no change can shorten the motion.",
        t=trajectory.t,
        costates=np.zeros((N + 1, 2 * n)),
        switching=np.zeros((N, n)),
        hamiltonian=np.zeros(N),
        obeys=np.zeros((N, n), dtype=bool),
        tolerance=tolerance,
    )


def _certificate(
    motion: GridMotion,
    dual: DualSolution,
    verification: Verification,
    tolerance: float,
    rounding: float,
) -> Certificate:
    """The certificate of a motion from its costates and multipliers."""
    h, driven, sigma = motion.changes.h, motion.system.driven, dual.switching
    T, H, limits = float(h.sum()), dual.hamiltonian, motion.system.motion_limits
    # Slack of the torques to their limits, in half ranges, shape (N, n).
    above = np.maximum(1.0 - motion.loads.max(axis=1), 0.0)
    below = np.maximum(1.0 + motion.loads.min(axis=1), 0.0)
    slack, slope = np.where(sigma < 0.0, above, below), np.abs(sigma)
    # Torques also obey where the Hamiltonian can decrease only within the tolerance.
    obeys = (slack <= AT_LIMIT) | (slope <= SINGULAR) | (slope * slack <= tolerance)
    obeys[:, ~driven] = True
    saturated = (np.minimum(above, below) <= ON_LIMIT)[:, driven].any(axis=1)
    # Additional gain of torques that switch within the intervals.
    mean = np.where(sigma < 0.0, 1.0 - motion.load, 1.0 + motion.load)
    more = slope * np.maximum(mean - slack, 0.0) * h[:, None]
    active = tuple(_active(motion, dual))
    begins = [item.begin for item in active]
    limited = np.isin(motion.changes.t[:-1], np.concatenate([np.zeros(0), *begins]))
    error: float | None = None
    first = dual.costates[:1]
    if not motion.system.problem.segments:
        integrated = _integrated(motion, dual)
        if not need_smooth(motion.system.problem.robot, limits):
            error = _disagreement(dual, integrated)
        first = integrated[:1]
    deviation = np.abs(H - np.average(H, weights=h))
    gain = dual.multipliers.predicted_gain

    def share(flags: Array | BoolArray) -> float:
        return float(np.average(flags, weights=h))

    out = Certificate(
        joint_names=motion.trajectory.joint_names,
        ok=False,
        message="",
        t=motion.changes.t,
        costates=np.vstack([first, dual.costates]),
        switching=sigma,
        hamiltonian=H,
        obeys=obeys,
        active=active,
        hamiltonian_deviation=float(deviation.max()),
        hamiltonian_mean_deviation=share(deviation),
        sign_share=share(obeys[:, driven].mean(axis=1)),
        saturated_share=share(saturated),
        active_share=share(saturated | limited),
        complementarity=float(gain[dual.multipliers.limits].sum()),
        stationarity=dual.predicted_gain,
        grid_gain=float(dual.predicted_gain + more[:, driven].sum() / T),
        costate_error=error,
        tolerance=tolerance,
    )
    failures = failed_conditions(motion, dual, out, verification, fastest=not rounding)
    failed = " ".join(failures)
    message = failed or conditions_kept(motion, out, rounding)
    return replace(out, ok=not failed, message=message)


def _active(motion: GridMotion, dual: DualSolution) -> Iterator[ActiveLimit]:
    """Active limits: limits without slack and with a multiplier above a threshold."""
    limits, (t, h) = dual.multipliers, (motion.changes.t, motion.changes.h)
    density = limits.value * float(t[-1]) / h[limits.at.interval]
    active = limits.limits & (density > LEAST_MULTIPLIER) & (limits.slack <= ON_LIMIT)
    active &= ~limits.of(PASSIVE)
    for kind in dict.fromkeys(limits.kind.tolist()):
        of_kind = active & limits.of(kind)
        for subject in np.unique(limits.subject[of_kind]).tolist():
            rows = np.flatnonzero(of_kind & (limits.subject == subject))
            interval = limits.at.interval[rows]
            held, first = np.unique(interval, return_index=True)
            total = np.bincount(interval, density[rows]).astype(float)
            yield ActiveLimit(
                kind,
                subject_name(motion, kind, subject),
                t[held],
                t[held + 1],
                total[held],
                limits.upper_active[rows[first]],
            )


def clock_share(trajectory: Trajectory, period: float) -> float:
    """Share of the duration of a motion that rounding to whole periods may have cost.

    The duration of each segment is rounded up separately, by less than a period. A part
    of the motion from rest to rest that takes no more periods than the fewest of any
    motion on a clock may be due to rounding as a whole.

    Args:
        trajectory: The motion.
        period: Period of the clock [s].
    """
    if not trajectory.duration:
        return 0.0
    durations = np.diff(trajectory._ends, prepend=0.0)
    speeds = np.abs(trajectory.v[np.searchsorted(trajectory.t, trajectory._ends)])
    rests = np.all(speeds <= SAME, axis=1)
    part = np.cumsum(rests) - rests
    shortest = np.bincount(part, durations) <= (FEWEST_PERIODS + SAME) * period
    rounding = np.where(shortest[part], durations, np.minimum(durations, period))
    return float(rounding.sum() / trajectory.duration)


# -- costates by the adjoint equation --------------------------------------------------


def _integrated(motion: GridMotion, dual: DualSolution) -> Array:
    """Integrate the adjoint equation backwards over each interval.

    The integration of each interval starts with the costate of the linear program at
    the end of the interval: if an arm is unstable, errors of an integration over the
    whole motion grow by powers of ten.

    Args:
        motion: The motion.
        dual: Costates just before the nodes, and multipliers of the motion.

    Returns:
        Costates just after the start and just before the nodes 1 to N - 1, shape
        (N, 2 n).
    """
    # Steps end at the positions at which costates may jump.
    n, changes = motion.changes.n, motion.changes
    shares = (np.arange(PLACES) + 0.5) / PLACES
    _, q, v, a, _ = motion.states(motion.instants(*shares.tolist()))
    u = motion.system.dynamics.inverse(q, v, a)  # torques minus dry friction
    x = np.concatenate([q, v], axis=1)
    slope = motion.system.dynamics.forward_jacobians(x, u).f_x
    slope = slope.reshape(changes.N, PLACES, 2 * n, 2 * n)
    steps = expm(slope * (changes.h / PLACES)[:, None, None, None])
    p = dual.costates
    for i in range(PLACES - 1, -1, -1):
        p = np.einsum("ki,kij->kj", p, steps[:, i]) + dual.jumps[:, i]
    p[1:] += dual.jumps[:-1, PLACES]
    return np.asarray(p)


def _disagreement(dual: DualSolution, integrated: Array) -> float:
    """Largest difference between costates, relative to the largest costate.

    Args:
        dual: Costates of the linear program.
        integrated: Costates of the adjoint equation, shape (N, 2 n).
    """
    scale = dual.state_scale
    largest = float(np.max(np.abs(dual.costates * scale), initial=0.0))
    difference = (dual.costates[:-1] - integrated[1:]) * scale
    return float(np.max(np.abs(difference), initial=0.0)) / max(largest, 1e-300)
