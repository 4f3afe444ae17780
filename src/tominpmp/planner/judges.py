"""Judges of iterations: when one that leads to no motion is ended early."""

from __future__ import annotations

from tominpmp.planner.progress import Judge, Progress
from tominpmp.status import IterationRecord, Status

# An iteration is given up after so many steps if it breaks limits by more than is near
# to a motion, and that has not fallen to this share of it in the last ones.
PATIENCE, LATELY, FALLING = 10, 5, 0.9
# One is lost that has become so many times as slow, and breaks limits by more than
# this share all the same.
EVER_SLOWER, FAR = 10.0, 1e-3
# A start of several segments is given up after so many iterations if its motion takes
# this many times as long as its guess and breaks limits by more than this share.
ITERATIONS, HOPELESS, ASTRAY = 15, 3.0, 1e-2


def stagnating(far: float) -> Judge:
    """Ends an iteration that comes no nearer to a motion.

    Args:
        far: Violations up to this share are near.
    """
    seen: list[float] = []

    def judge(record: IterationRecord) -> Status | None:
        seen.append(record.violation)
        late = len(seen) >= PATIENCE and record.violation > far
        stuck = late and min(seen[-LATELY:]) > FALLING * min(seen[:-LATELY])
        return Status.STALLED if stuck else None

    return judge


def ever_slower(duration: float) -> Judge:
    """Ends an iteration that is many times as slow as what it began with.

    Where nothing is clear, slower motions break the other limits less and less.

    Args:
        duration: T of what it began with [s].
    """

    def judge(record: IterationRecord) -> Status | None:
        slow = record.duration > EVER_SLOWER * duration
        return Status.STALLED if slow and record.violation > FAR else None

    return judge


def hopeless(duration: float, progress: Progress) -> Judge:
    """Ends a start that is slow and far from any motion.

    Args:
        duration: T of its guess [s].
        progress: Has seen its iterations.
    """

    def judge(record: IterationRecord) -> Status | None:
        slow = record.duration > HOPELESS * duration
        late = len(progress.records) >= ITERATIONS
        over = late and slow and record.violation > ASTRAY
        return Status.ITERATION_LIMIT if over else None

    return judge
