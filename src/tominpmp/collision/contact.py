"""Results of a collision checker: contacts, and derivatives of distances."""

from __future__ import annotations

from typing import NamedTuple

from tominpmp.arrays import Array


class Contact(NamedTuple):
    """The pair that comes closest in a configuration.

    Attributes:
        link: Name of the link.
        obstacle: Name of what it comes close to.
        distance: Signed distance [m].
        own: Whether that is another link of the robot, or of one combined with it.
        margin: Distance to keep [m].
    """

    link: str
    obstacle: str
    distance: float
    own: bool = False
    margin: float = 0.0

    @property
    def lack(self) -> float:
        """Room that it lacks [m]; negative where there is some."""
        return self.margin - self.distance

    @property
    def pair(self) -> str:
        """Both of them, in words."""
        if self.own:
            return f"links {self.link!r} and {self.obstacle!r}"
        return f"link {self.link!r} and obstacle {self.obstacle!r}"


class Derivatives(NamedTuple):
    """How distances change.

    Attributes:
        gradients: By configuration, shape (k, n) [m/rad or m/m].
        rates: By time, where obstacles move, shape (k,) [m/s].
    """

    gradients: Array
    rates: Array
