"""What is found: a time, and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass

from tominpmp.checks import number

# A bound is worth telling people of if it is at least this share of the duration.
USEFUL = 0.5
USELESS = "no useful bound"


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

    def useful(self, T: float) -> bool:
        """Whether it says something of a motion: it is at least half its duration.

        Args:
            T: Duration of the motion [s].
        """
        T = number(T, "T", "a duration [s]", infinite=True)
        return 0.0 < USEFUL * T <= self.T

    def comparison(self, T: float) -> str:
        """Clause on how near to it a motion comes; empty where it is not useful.

        Args:
            T: Duration of the motion [s].
        """
        if not self.useful(T):
            return ""
        return f"{100.0 * max(T / self.T - 1.0, 0.0):.1f} % above the lower bound"

    def in_words(self, T: float) -> str:
        """The time and its reason, or that it is not useful.

        Args:
            T: Duration of the motion that it is held against [s].
        """
        return f"{self.T:.4f} s ({self.reason})" if self.useful(T) else USELESS
