"""Records of lower bounds: a time and its reason."""

from __future__ import annotations

from dataclasses import dataclass

from tominpmp.checks import number

# Least share of the duration of a motion from which a bound is reported.
USEFUL = 0.5
USELESS = "no useful bound"


@dataclass(frozen=True)
class LowerBound:
    """Lower bound on the duration of all motions that solve a problem.

    Attributes:
        T: The bound [s]; 0 if no bound is known.
        reason: Reason of the bound, as a clause.
        joint: Name of the joint that causes the bound; None for other bounds.
    """

    T: float
    reason: str
    joint: str | None = None

    def useful(self, T: float) -> bool:
        """Whether the bound is at least half of the duration of a motion.

        Args:
            T: Duration of the motion [s].
        """
        T = number(T, "T", "a duration [s]", infinite=True)
        return 0.0 < USEFUL * T <= self.T

    def comparison(self, T: float) -> str:
        """Clause on the excess of a motion over the bound; empty for a useless bound.

        Args:
            T: Duration of the motion [s].
        """
        if not self.useful(T):
            return ""
        return f"{100.0 * max(T / self.T - 1.0, 0.0):.1f} % above the lower bound"

    def in_words(self, T: float) -> str:
        """The bound and its reason in words, or a remark that it is not useful.

        Args:
            T: Duration of the motion with which the bound is compared [s].
        """
        return f"{self.T:.4f} s ({self.reason})" if self.useful(T) else USELESS
