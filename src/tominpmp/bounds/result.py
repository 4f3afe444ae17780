"""Lower bounds as records: a time and its reason."""

from __future__ import annotations

from dataclasses import dataclass

from tominpmp.checks import number

# Bounds below this share of the duration are not reported.
USEFUL = 0.5
USELESS = "no useful bound"


@dataclass(frozen=True)
class LowerBound:
    """Time that no motion can beat.

    Attributes:
        T: The time [s]; 0 without a bound.
        reason: Its reason, in a clause.
        joint: Name of the joint of the reason; None for several joints.
    """

    T: float
    reason: str
    joint: str | None = None

    def useful(self, T: float) -> bool:
        """Whether it is at least half of the duration of a motion.

        Args:
            T: Duration of the motion [s].
        """
        T = number(T, "T", "a duration [s]", infinite=True)
        return 0.0 < USEFUL * T <= self.T

    def comparison(self, T: float) -> str:
        """Clause on the excess of a motion over it; empty for bounds without use.

        Args:
            T: Duration of the motion [s].
        """
        if not self.useful(T):
            return ""
        return f"{100.0 * max(T / self.T - 1.0, 0.0):.1f} % above the lower bound"

    def in_words(self, T: float) -> str:
        """The time and its reason, or that it is not useful.

        Args:
            T: Duration of the motion that it is compared with [s].
        """
        return f"{self.T:.4f} s ({self.reason})" if self.useful(T) else USELESS
