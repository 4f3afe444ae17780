"""Replays that wait: a motion that a finer grid takes the place of needs none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from tominpmp.options import Options
from tominpmp.planner.attempt import Attempt
from tominpmp.planner.progress import Progress
from tominpmp.problem import Problem
from tominpmp.stopping import Stop


def replays_last(options: Options) -> bool:
    """Whether the motion that a search ends with may be replayed after its last stages.

    Where time is limited, or somebody looks on, what was found has to be known to hold;
    and several motions that are compared have to.
    """
    return (
        options.objective == "time"
        and options.refine == "auto"
        and options.method == "inverse"
        and options.effort != "thorough"
        and options.starts is None
        and options.control_period is None
        and options.max_planning_time is None
    )


def replayed(
    problem: Problem,
    options: Options,
    progress: Progress,
    attempts: Sequence[Attempt],
) -> Iterator[Attempt]:
    """Replay the best motion, if that has waited.

    Args:
        problem: The problem.
        options: Options of the plan.
        progress: Learns that all was in vain if the replay fails: the search has not
            looked for others.
        attempts: What was found.

    Yields:
        The same motion with its replay.
    """
    if not progress.replays_last or progress.in_vain:
        return
    # Of those that are as good the last one, which was replayed if any was.
    found = [attempt for attempt in reversed(attempts) if attempt.found]
    best = min(found, key=lambda attempt: attempt.duration, default=None)
    if best is None or best.verification is not None:
        return
    attempt = best.verified(problem, options)
    if attempt.verification is not None:
        progress.replayed(attempt.verification.seconds)
    progress.in_vain = not attempt.found
    yield replace(attempt, history=())


def not_waiting(attempts: Sequence[Attempt]) -> list[Attempt]:
    """Attempts but for those whose replay has waited."""
    return [one for one in attempts if one.verification is not None or not one.found]


def all_replayed(
    problem: Problem,
    options: Options,
    progress: Progress,
    attempts: Sequence[Attempt],
) -> list[Attempt]:
    """All attempts, with the replay that has waited if the search was stopped.

    If it fails, or there is no time for it, nothing is known of motions that were not
    replayed.
    """
    try:
        more = list(replayed(problem, options, progress, attempts))
    except Stop:
        sure = not_waiting(attempts)
        return [
            one if one in sure else replace(one, unconfirmed=True) for one in attempts
        ]
    if progress.in_vain:
        attempts = not_waiting(attempts)
    return [*attempts, *more]
