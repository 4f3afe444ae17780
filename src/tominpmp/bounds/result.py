"""What is found: a time, and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass

from tominpmp.checks import number

# A motion is told to be near a bound if it takes no more than this times as long. Most
# bounds are not the minimum itself: of a motion that is farther away from one they tell
# nothing.
TELLING = 1.1


@dataclass(frozen=True)
class LowerBound:
    """Time that no motion can beat.

    Attributes:
        T: The time [s]; 0 if nothing could be proved.
        reason: What it comes from, in a clause.
        joint: Name of the joint that it comes from; None if several are involved.
    """

    T: float
    reason: str
    joint: str | None = None

    def comparison(self, T: float) -> str:
        """Clause on how near to it a motion comes; empty where that tells nothing.

        Args:
            T: Duration of the motion [s].
        """
        T = number(T, "T", "a duration [s]", infinite=True)
        if not 0.0 < T <= TELLING * self.T:
            return ""
        return f"{100.0 * max(T / self.T - 1.0, 0.0):.1f} % above what none can beat"
