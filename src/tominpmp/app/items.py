"""Obstacles as one drags them: a kind, its sizes, and where it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from numpy.typing import ArrayLike

from tominpmp.app.numbers import rounded, tuple_text
from tominpmp.exceptions import SceneError, brief
from tominpmp.scene import Box, Capsule, Cylinder, Obstacle, Sphere

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)

# Sizes by kind, as the library's obstacles call them, and what a new one has [m].
SIZES: dict[str, dict[str, float]] = {
    "box": {"x": 0.15, "y": 0.15, "z": 0.15},
    "sphere": {"radius": 0.1},
    "cylinder": {"radius": 0.06, "length": 0.3},
    "capsule": {"radius": 0.06, "length": 0.2},
}

KINDS: dict[str, Callable[..., Obstacle]] = {
    "box": Box,
    "sphere": Sphere,
    "cylinder": Cylinder,
    "capsule": Capsule,
}


@dataclass(frozen=True)
class Item:
    """An obstacle.

    Attributes:
        kind: "box", "sphere", "cylinder" or "capsule".
        name: Its name, unique in the scene.
        size: Its sizes in the order of ``SIZES`` [m].
        position: Where its centre is [m].
        quaternion: How it is turned (x, y, z, w).

    Raises:
        SceneError: If there is no such kind, or the number of sizes is wrong.
    """

    kind: str
    name: str
    size: tuple[float, ...]
    position: Triple
    quaternion: Quaternion = UPRIGHT

    def __post_init__(self) -> None:
        """Check kind and number of sizes; the obstacle checks the rest."""
        if self.kind not in SIZES:
            raise SceneError(
                f"obstacle {self.name!r}: kind is {brief(self.kind)}, expected one of: "
                f"{', '.join(SIZES)}",
                self.name,
            )
        if len(self.size) != len(SIZES[self.kind]):
            raise SceneError(
                f"obstacle {self.name!r}: size is {brief(self.size)}, expected "
                f"{len(SIZES[self.kind])} lengths: {', '.join(SIZES[self.kind])} [m]",
                self.name,
            )

    def placed(self, position: ArrayLike, quaternion: ArrayLike) -> Item:
        """The same elsewhere; quaternion (x, y, z, w)."""
        turned = rounded(quaternion, 6)
        return replace(
            self,
            position=rounded(position),
            quaternion=UPRIGHT if turned[3] in (1.0, -1.0) else turned,
        )

    def resized(self, size: ArrayLike) -> Item:
        """The same with other sizes [m]."""
        return replace(self, size=rounded(size))

    def obstacle(self) -> Obstacle:
        """The obstacle that the library plans around.

        Raises:
            SceneError: If a size or a position is wrong.
        """
        return KINDS[self.kind](self.name, **self._arguments())

    def python(self) -> str:
        """The obstacle as an expression of Python."""
        given = [
            f"{name}={tuple_text(value) if isinstance(value, tuple) else repr(value)}"
            for name, value in self._arguments().items()
        ]
        return f"tm.{self.kind.capitalize()}({self.name!r}, {', '.join(given)})"

    def _arguments(self) -> dict[str, Any]:
        """Arguments of the library's obstacle, without those not needed."""
        found: dict[str, Any] = {"size": self.size}
        if self.kind != "box":
            found = dict(zip(SIZES[self.kind], self.size, strict=True))
        found["position"] = self.position
        if self.quaternion != UPRIGHT:
            found["rotation"] = self.quaternion
        return found


def new_item(kind: str, position: ArrayLike, taken: tuple[str, ...]) -> Item:
    """An obstacle of usual size, with a name that is not taken yet.

    Raises:
        SceneError: If there is no such kind.
    """
    number = 1
    while f"{kind}{number}" in taken:
        number += 1
    sizes = tuple(SIZES.get(kind, {}).values())
    return Item(kind, f"{kind}{number}", sizes, rounded(position))
