"""Judges of iterations: when one that leads to no motion is ended early."""

from __future__ import annotations

from tominpmp.planner.progress import Judge
from tominpmp.status import IterationRecord, Status

# An iteration is given up after so many steps if it breaks limits by more than is near
# to a motion, and that has not fallen to this share of it in the last ones.
PATIENCE, LATELY, FALLING = 10, 5, 0.9
# One is lost that has become so many times as slow, and breaks limits by more than
# this share all the same.
EVER_SLOWER, FAR = 10.0, 1e-3


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
