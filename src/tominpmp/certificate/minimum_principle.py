r"""Certificate of the minimum principle: how near a motion is to an extremal.

The duration T is minimised: with the costates :math:`p = \partial T / \partial x`, the
derivatives of the remaining time by the state, the Hamiltonian is

.. math:: H = 1 + p^T f(x, u) = 0

all along an optimal motion (Pontryagin, Boltyanskii, Gamkrelidze and Mishchenko, 1962),
and its torques minimise it: where the switching function :math:`\sigma = H_u` of a
joint is positive its torque is at the lower limit, where it is negative at the upper
limit. On state limits, as of speeds, the costate falls, and H does not (Hartl, Sethi
and Vickson, 1995). Where obstacles move, their effect on later clearances is part of H.

The certificate takes no result of the solver that planned the motion: costates and
multipliers come from a linear program about the motion
(:mod:`tominpmp.certificate.dual_program`). These costates are compared with the adjoint
equation of the paper's differentials (equations 12 and 13) in real time,

.. math:: \dot p = -f_x^T p

between the instants at which a state limit is active, where the costate falls by the
multiplier times the gradient of the limit: the program uses accelerations and the
inverse dynamics, this equation torques and the forward dynamics. Each checks the other.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.blas_threads import on_one_thread
from tominpmp.certificate.allowances import clock_share
from tominpmp.certificate.certificate import ActiveLimit, Certificate
from tominpmp.certificate.dual_program import (
    PLACES,
    DualSolution,
    solve_dual_program,
)
from tominpmp.certificate.limits import PASSIVE
from tominpmp.certificate.motion import Motion
from tominpmp.certificate.optimality_report import (
    conditions_kept,
    failed_conditions,
    name_of,
)
from tominpmp.certificate.stays import without_stays
from tominpmp.checks import instance, number
from tominpmp.motion.joining import checked_motion
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Tolerances
from tominpmp.problem.controls import need_smooth
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import spans_of
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.verification.replay import Replay
from tominpmp.verification.stages import with_segments
from tominpmp.verification.verification import Verification, verify

# Largest predicted gain of a motion that is certified, as a share of the duration.
TOLERANCE = 0.01
# Share of the tolerance below which the predicted gain need not be exact.
ENOUGH = 0.3
# A torque obeys its switching function within this share of half its range from its
# limit, or where the function is below the second number; a limit with slack below the
# third is active.
AT_LIMIT = 0.02
NO_SLOPE = 0.02
ON_LIMIT = 0.01
# Limits whose multiplier is below this, as a density over time, do not count as active.
HOLDING = 0.01


@on_one_thread
def certify(
    problem: Problem,
    trajectory: Trajectory | Samples,
    *,
    verification: Verification | None = None,
    tolerance: float = TOLERANCE,
    control_period: float | None = None,
) -> Certificate:
    """Check the first-order conditions of a motion, of any origin.

    Args:
        problem: The problem that the motion solves.
        trajectory: The motion; samples, from a file say, are joined to a motion first.
        verification: Its replay; None makes one. Costates are integrated along it, and
            a motion that fails it is not certified.
        tolerance: Largest predicted gain of small changes, as a share of the duration.
        control_period: Period of the clock that the motion is on, if there is one [s]:
            no motion on that clock is faster by less than a period.

    Returns:
        The certificate.

    Raises:
        ProblemError: If the motion has other joints, or values that are not finite, or
            a dwell while obstacles move.
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
    robot = problem.robot
    trajectory = checked_motion(trajectory, robot, problem.q_start, problem.v_start)
    trajectory = with_segments(problem, trajectory, Tolerances())
    # Alternatives of a goal may have another number of rows.
    asked, problem = problem, problem.alternative_of(trajectory)
    if verification is None:
        verification = verify(asked, trajectory)
    problem, trajectory = without_stays(problem, trajectory)
    rounding = 0.0 if period is None else clock_share(trajectory, period)
    seen = examine(problem, trajectory, verification, tolerance, rounding=rounding)
    out = seen.certificate
    return replace(out, seconds=time.perf_counter() - begin)


class Findings(NamedTuple):
    """A certificate and the multipliers that it is read from.

    Attributes:
        certificate: The certificate.
        motion: The motion on its grid; None if the conditions cannot be evaluated.
        found: Its multipliers; None likewise.
    """

    certificate: Certificate
    motion: Motion | None
    found: DualSolution | None


def examine(
    problem: Problem,
    trajectory: Trajectory,
    verification: Verification | None,
    tolerance: float,
    *,
    near: bool = True,
    rounding: float = 0.0,
) -> Findings:
    """Check the first-order conditions of a motion of the right joints.

    Args:
        problem: The problem that the motion solves.
        trajectory: The motion.
        verification: Its replay, if there is one.
        tolerance: Largest predicted gain of small changes, as a share of the duration.
        near: Whether obstacles are near; else distances become rows only where the
            predicted gain without them is too large.
        rounding: Share of the duration that rounding to a clock may have cost, which is
            added to the tolerance.
    """
    tolerance += rounding
    # A segment of zero duration has no interval.
    if all(span.begin < span.end for span in spans_of(trajectory, ())):
        with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
            motion = Motion.of(ProblemFunctions.of(problem), trajectory)
            found = solve_dual_program(motion, ENOUGH * tolerance, near=near)
            if found is not None:
                out = _read(motion, found, verification, tolerance, rounding)
                return Findings(out, motion, found)
    return Findings(_nothing(trajectory, verification, tolerance), None, None)


def _nothing(
    trajectory: Trajectory, verification: Verification | None, tolerance: float
) -> Certificate:
    """Certificate of a motion whose conditions cannot be evaluated."""
    n, N, T = trajectory.n, trajectory.t.size - 1, trajectory.duration
    stands = verification is not None and verification.ok and not T
    moves = T and (np.any(trajectory.v) or np.any(np.ptp(trajectory.q, axis=0)))
    return Certificate(
        joint_names=trajectory.joint_names,
        ok=stands,
        message="The first-order conditions of the motion could not be evaluated: the "
        "linear program of its small changes has no solution."
        if moves
        else "The arm does not move, so that small changes have nothing to shorten.",
        t=trajectory.t,
        costates=np.zeros((N + 1, 2 * n)),
        switching=np.zeros((N, n)),
        hamiltonian=np.zeros(N),
        obeys=np.zeros((N, n), dtype=bool),
        active=(),
        hamiltonian_deviation=np.inf,
        hamiltonian_mean_deviation=np.inf,
        sign_share=0.0,
        saturated_share=0.0,
        active_share=0.0,
        complementarity=np.inf,
        stationarity=np.inf,
        grid_gain=np.inf,
        costate_error=None,
        tolerance=tolerance,
        seconds=0.0,
    )


def _read(
    motion: Motion,
    found: DualSolution,
    verification: Verification | None,
    tolerance: float,
    rounding: float,
) -> Certificate:
    """The certificate of a motion from its multipliers."""
    h, driven, sigma = motion.changes.h, motion.driven, found.switching
    T, H, limits = float(h.sum()), found.hamiltonian, motion.system.motion_limits
    load = motion.loads
    if motion.changes.shape == "torques":
        load = motion.load[:, None]
    # Slack of the torques to their limits, in half ranges, shape (N, n).
    above = np.maximum(1.0 - load.max(axis=1), 0.0)
    below = np.maximum(1.0 + load.min(axis=1), 0.0)
    room, slope = np.where(sigma < 0.0, above, below), np.abs(sigma)
    # Torques obey also where the Hamiltonian could fall by no more than the tolerance.
    obeys = (room <= AT_LIMIT) | (slope <= NO_SLOPE) | (slope * room <= tolerance)
    obeys[:, np.setdiff1d(np.arange(motion.changes.n), driven)] = True
    busy = (np.minimum(above, below) <= ON_LIMIT)[:, driven].any(axis=1)
    # Predicted gain of torques that may switch within the intervals.
    mean = np.where(sigma < 0.0, 1.0 - motion.load, 1.0 + motion.load)
    more = slope * np.maximum(mean - room, 0.0) * h[:, None]
    active = tuple(_active(motion, found))
    begins = [item.begin for item in active]
    covered = np.isin(motion.changes.t[:-1], np.concatenate([np.zeros(0), *begins]))
    error: float | None = None
    first = found.costates[:1]
    if not motion.sections:
        replay = None if verification is None else verification.replay
        integrated = _integrated(motion, found, replay)
        if not need_smooth(motion.system.problem.robot, limits):
            error = _disagreement(found, integrated)
        first = integrated[:1]
    apart = np.abs(H - np.average(H, weights=h))
    promise = found.multipliers.promise

    def share(flags: Array | BoolArray) -> float:
        return float(np.average(flags, weights=h))

    out = Certificate(
        joint_names=motion.trajectory.joint_names,
        ok=False,
        message="",
        t=motion.changes.t,
        costates=np.vstack([first, found.costates]),
        switching=sigma,
        hamiltonian=H,
        obeys=obeys,
        active=active,
        hamiltonian_deviation=float(apart.max()),
        hamiltonian_mean_deviation=share(apart),
        sign_share=share(obeys[:, driven].mean(axis=1)),
        saturated_share=share(busy),
        active_share=share(busy | covered),
        complementarity=float(promise[found.multipliers.limits].sum()),
        stationarity=found.promise,
        grid_gain=float(found.promise + more[:, driven].sum() / T),
        costate_error=error,
        tolerance=tolerance,
        seconds=0.0,
    )
    failures = failed_conditions(motion, found, out, verification, fastest=not rounding)
    message = " ".join(failures)
    kept = message or conditions_kept(motion, out, rounding)
    if motion.system.problem.robot.kinematic:
        kept = kept.replace("torques", "accelerations")
        kept = kept.replace("Torques", "Accelerations")
    return replace(out, ok=not message, message=kept)


def _active(motion: Motion, found: DualSolution) -> Iterator[ActiveLimit]:
    """Active limits, without slack and with a multiplier above a threshold."""
    given, (t, h) = found.multipliers, (motion.changes.t, motion.changes.h)
    density = given.value * float(t[-1]) / h[given.at.interval]
    holding = given.limits & (density > HOLDING) & (given.room <= ON_LIMIT)
    holding &= ~given.of(PASSIVE)
    for kind in dict.fromkeys(given.kind.tolist()):
        of_kind = holding & given.of(kind)
        for subject in np.unique(given.subject[of_kind]).tolist():
            rows = np.flatnonzero(of_kind & (given.subject == subject))
            interval = given.at.interval[rows]
            held, first = np.unique(interval, return_index=True)
            total = np.bincount(interval, density[rows]).astype(float)
            yield ActiveLimit(
                kind,
                name_of(motion, kind, subject),
                t[held],
                t[held + 1],
                total[held],
                given.held_above[rows[first]],
            )


# -- costates by the adjoint equation --------------------------------------------------


def _integrated(
    motion: Motion, found: DualSolution, replay: Replay | None = None
) -> Array:
    """Integrate the adjoint equation backwards over each interval.

    Each interval begins with the costate of the program at its end. Where an arm is
    unstable, errors of an integration from one end of the motion to the other grow by
    powers of ten.

    Args:
        motion: The motion.
        found: Its multipliers, and the costates just before the nodes.
        replay: Replay of the torques, whose states the equation is integrated along;
            None takes the states of the plan.

    Returns:
        Costates just after the start and just before the nodes 1 to N - 1, shape
        (N, 2 n).
    """
    # A step ends wherever costates may jump.
    n, changes = motion.changes.n, motion.changes
    shares = (np.arange(PLACES) + 0.5) / PLACES
    times, q, v, a, _ = motion.states(motion.instants(*shares.tolist()))
    left = motion.system.dynamics.inverse(q, v, a)  # torques less dry friction
    if replay is not None and replay.complete:
        q = np.stack([np.interp(times, replay.t, x) for x in replay.q.T], axis=1)
        v = np.stack([np.interp(times, replay.t, x) for x in replay.v.T], axis=1)
    x = np.concatenate([q, v], axis=1)
    slope = motion.system.dynamics.forward_jacobians(x, left).f_x
    steps = _transitions(slope, np.repeat(changes.h / PLACES, PLACES))
    steps = steps.reshape(changes.N, PLACES, 2 * n, 2 * n)
    p = found.costates
    for i in range(PLACES - 1, -1, -1):
        p = np.einsum("ki,kij->kj", p, steps[:, i]) + found.falls[:, i]
    p[1:] += found.falls[:-1, PLACES]
    return np.asarray(p)


def _transitions(slope: Array, h: Array) -> Array:
    """State transition matrices of steps by Radau IIA of order 3, shape (m, k, k).

    Args:
        slope: f_x in the middle of each step, shape (m, k, k).
        h: Lengths of the steps [s], shape (m,).
    """
    z = slope * h[:, None, None]
    eye = np.eye(slope.shape[1])
    return np.asarray(np.linalg.solve(eye - 2 / 3 * z + z @ z / 6, eye + z / 3))


def _disagreement(found: DualSolution, integrated: Array) -> float:
    """Largest difference between costates, relative to the largest costate.

    Args:
        found: Costates of the linear program.
        integrated: Costates of the adjoint equation, shape (N, 2 n).
    """
    scale = found.state_scale
    largest = float(np.max(np.abs(found.costates * scale), initial=0.0))
    apart = (found.costates[:-1] - integrated[1:]) * scale
    return float(np.max(np.abs(apart), initial=0.0)) / max(largest, 1e-300)
