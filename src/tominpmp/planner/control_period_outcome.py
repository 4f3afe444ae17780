"""Outcome of the search for a motion on the clock of a controller."""

from __future__ import annotations

from dataclasses import dataclass, replace

from tominpmp.solution import Solution
from tominpmp.status import STOPPED, IterationRecord, Status
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.ticks import ticks_of
from tominpmp.verification.verification import Verification

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
    solution: Solution, outcome: Clocked, remark: str, period: float
) -> Solution:
    """The solution with the motion on the clock."""
    motion, free = outcome.trajectory, solution.trajectory
    assert motion is not None and free is not None  # noqa: S101
    T = motion.duration
    message = (
        f"{solution.status.value} T = {T:.4f} s, {ticks_of(T, period)} periods of "
        f"{period:g} s, {100 * (T / free.duration - 1.0):.2f} % above the motion "
        "without such a clock"
    )
    solution = replace(
        solution,
        trajectory=motion,
        verification=outcome.verification,
        violations={},
    )
    bound = solution.lower_bound
    near = "" if bound is None else bound.comparison(T)
    if near:
        message += f" and {near}"
    return replace(solution, message=f"{message}. {remark}".rstrip())


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
