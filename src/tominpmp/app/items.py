"""Obstacles as one drags them: a kind, its sizes, and where it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

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

    def alike(self, other: Item) -> bool:
        """Whether another one looks the same, wherever it is."""
        return (self.kind, self.size) == (other.kind, other.size)

    def resized(self, size: ArrayLike) -> Item:
        """The same with other sizes [m]."""
        return replace(self, size=rounded(size))

    def obstacle(self) -> Obstacle:
        """The obstacle that the library plans around.

        Raises:
            SceneError: If a size or a position is wrong.
        """
        place = {"position": self.position, "rotation": self.quaternion}
        if self.kind == "box":
            return Box(self.name, size=self.size, **place)  # type: ignore[arg-type]
        if self.kind == "sphere":
            return Sphere(self.name, radius=self.size[0], **place)  # type: ignore[arg-type]
        kind = Cylinder if self.kind == "cylinder" else Capsule
        radius, length = self.size
        return kind(self.name, radius=radius, length=length, **place)  # type: ignore[arg-type]

    def python(self) -> str:
        """The obstacle as an expression of Python."""
        if self.kind == "box":
            sizes = f"size={tuple_text(self.size)}"
        else:
            names = SIZES[self.kind]
            sizes = ", ".join(
                f"{name}={value!r}"
                for name, value in zip(names, self.size, strict=True)
            )
        turned = ""
        if self.quaternion != UPRIGHT:
            turned = f", rotation={tuple_text(self.quaternion)}"
        place = tuple_text(self.position)
        kind = self.kind.capitalize()
        return f"tm.{kind}({self.name!r}, {sizes}, position={place}{turned})"


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
