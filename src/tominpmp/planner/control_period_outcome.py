"""Outcome of the search for a motion on the clock of a controller."""

from __future__ import annotations

from dataclasses import dataclass, replace

from tominpmp.certificate.allowances import clock_share
from tominpmp.certificate.minimum_principle import TOLERANCE, certify
from tominpmp.certificate.stays import stays_where_it_moves
from tominpmp.motion.trajectory import Trajectory
from tominpmp.solution import Solution
from tominpmp.status import STOPPED, IterationRecord, Status
from tominpmp.transcription.grid import ticks_of
from tominpmp.verification.verification import Verification

# A motion on the clock that takes this share of the tolerance more than rounding is
# put to the test again.
TESTED_AGAIN = 0.5
# How a plan ends that has found no motion on the clock.
NO_CLOCK = (*STOPPED, Status.UNVERIFIED)


@dataclass(frozen=True, eq=False)
class Clocked:
    """What the search for a motion on the clock led to.

    Attributes:
        status: How it ended.
        trajectory: The motion; None if there is none.
        verification: Its replay, or that of the last motion that did not pass.
        history: Records of all iterations.
    """

    status: Status
    trajectory: Trajectory | None = None
    verification: Verification | None = None
    history: tuple[IterationRecord, ...] = ()


def succeeded(
    solution: Solution, outcome: Clocked, remark: str, period: float, status: Status
) -> Solution:
    """The solution with the motion on the clock, and the status that it deserves."""
    motion, free = outcome.trajectory, solution.trajectory
    assert motion is not None and free is not None  # noqa: S101
    T = motion.duration
    message = (
        f"{status.value} T = {T:.4f} s, {ticks_of(T, period)} periods of "
        f"{period:g} s, {100 * (T / free.duration - 1.0):.2f} % above the motion "
        "without such a clock"
    )
    solution = replace(
        solution,
        status=status,
        trajectory=motion,
        verification=outcome.verification,
        violations={},
    )
    bound = solution.lower_bound
    near = "" if bound is None else bound.comparison(T)
    if near:
        message += f" and {near}"
    return replace(solution, message=f"{message}. {remark}".rstrip())


def status_on_clock(
    solution: Solution, outcome: Clocked, period: float
) -> tuple[Status, str]:
    """What a motion on the clock deserves to be called, and a remark on it.

    One that was called locally optimal without a clock still is where it takes less
    than a period more, and a part of what small changes may promise. Where it takes
    more it is put to the test again, and a period is no promise. One that takes no more
    periods than any motion on a clock is called so in any case.

    Args:
        solution: The motion without a clock.
        outcome: The motion on the clock.
        period: The period [s].
    """
    status, problem = solution.status, solution.problem
    motion, free = outcome.trajectory, solution.trajectory
    assert motion is not None and free is not None  # noqa: S101
    share, bound = clock_share(motion, period), solution.lower_bound
    if share == 1.0 and status not in STOPPED:
        return Status.CONVERGED, ""
    if status is not Status.CONVERGED or stays_where_it_moves(problem):
        return status, ""
    needed = (1.0 - share - TESTED_AGAIN * TOLERANCE) * motion.duration
    if needed <= free.duration:
        return status, ""
    if bound is not None and (1.0 - share - TOLERANCE) * motion.duration <= bound.T:
        return status, ""
    judged = outcome.verification
    found = certify(problem, motion, verification=judged, control_period=period)
    if found.ok:
        return status, ""
    return Status.STALLED, (
        f"Small changes promise {100.0 * found.stationarity:.2g} % of T, of which "
        f"{100.0 * share:.2g} % is the rounding of the clock."
    )


def failed(solution: Solution, outcome: Clocked, period: float) -> Solution:
    """The solution as a failure: the motion that it keeps knows no clock."""
    status = outcome.status if outcome.status in NO_CLOCK else Status.INFEASIBLE
    reasons = {
        Status.TIME_LIMIT: "the planning time was used up",
        Status.INTERRUPTED: "the planning was interrupted",
    }
    reason = reasons.get(status, "none of the numbers of periods tried would do")
    if status is Status.UNVERIFIED and outcome.verification is not None:
        reason = outcome.verification.message.rstrip(".")
    replay = solution.verification
    rest = "keeps all else, but its knots are not on the clock"
    if replay is None:
        rest = "is not on the clock, and there was no time to verify it"
    elif not replay.ok:
        rest = f"is not on the clock, nor right: {replay.message.rstrip('.')}"
    message = (
        f"{status.value} No motion on a clock of {period:g} s was found: {reason}. The "
        f"motion that is kept, T = {solution.T:.4f} s, {rest}."
    )
    return replace(solution, status=status, message=message, feasible=False)
