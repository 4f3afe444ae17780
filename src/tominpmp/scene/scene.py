"""Scenes: obstacles by their names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

import numpy as np

from tominpmp.arrays import Array, Converted, Record
from tominpmp.checks import of_kind, optional
from tominpmp.exceptions import SceneError, brief, warn_caller
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.obstacles import Box, Obstacle

# No arm works around anything so large or so far away [m], unless it is a ground, which
# is thinner than the other number; a scene in millimetres has such things.
LARGE, THICK = 100.0, 2.0


@dataclass(frozen=True, eq=False)
class Scene(Record):
    """The obstacles of a workspace.

    Attributes:
        obstacles: The obstacles, each with a name of its own; kept as a tuple.
    """

    obstacles: Sequence[Obstacle] = ()

    def __post_init__(self) -> None:
        """Check the obstacles and their names."""
        if not isinstance(self.obstacles, Iterable):
            raise SceneError(
                f"a scene is made from a list of obstacles, not from a "
                f"{type(self.obstacles).__name__}"
            )
        found: dict[str, Obstacle] = {}
        for item in self.obstacles:
            if not isinstance(item, Obstacle):
                raise SceneError(
                    "a scene holds obstacles (Sphere, Box, Cylinder, Capsule, Mesh, "
                    "HeightField, OcTree), not "
                    f"{type(item).__name__}"
                )
            if item.name in found:
                raise SceneError(f"two obstacles are named {item.name!r}", item.name)
            found[item.name] = item
        self._keep(obstacles=tuple(found.values()))
        _warn_of_units(self.obstacles)

    def __iter__(self) -> Iterator[Obstacle]:
        """Iterate over the obstacles."""
        return iter(self.obstacles)

    def __repr__(self) -> str:
        """Names of the obstacles, on one line."""
        names = brief(", ".join(item.name for item in self.obstacles))[1:-1]
        count = "1 obstacle" if len(self) == 1 else f"{len(self)} obstacles"
        return f"<Scene with {count}: {names or 'none'}>"

    def __len__(self) -> int:
        """Return how many obstacles there are."""
        return len(self.obstacles)

    def __getitem__(self, name: str) -> Obstacle:
        """Return an obstacle by its name.

        Raises:
            SceneError: If no obstacle has the name.
        """
        for item in self.obstacles:
            if isinstance(name, str) and item.name == name:
                return item
        known = ", ".join(item.name for item in self.obstacles) or "none"
        raise SceneError(
            f"there is no obstacle {brief(name)}; there are: {known}", name
        )

    @property
    def moving(self) -> tuple[Obstacle, ...]:
        """The obstacles that move."""
        return tuple(item for item in self.obstacles if item.motion is not None)

    @property
    def sorted(self) -> Scene:
        """The obstacles in the order of their places, whatever the order of the list.

        Rows of programs are in the order of the pairs, and the choice of a solver among
        equally good steps depends on it.
        """
        ordered = sorted(self.obstacles, key=_whereabouts)
        return self._altered(obstacles=tuple(ordered))

    def at(self, time: float) -> Scene:
        """The scene with all obstacles at rest at their placements of a time [s]."""
        still = [x if x.motion is None else x.frozen(time) for x in self.obstacles]
        return self._altered(obstacles=tuple(still))

    def resting(self) -> Scene:
        """The scene without the obstacles that move."""
        still = [item for item in self.obstacles if item.motion is None]
        return self._altered(obstacles=tuple(still))


def as_scene(given: Any, name: str) -> Scene:
    """A scene from a scene, an obstacle, a list of obstacles, or None.

    Raises:
        ProblemError: If the value has another type.
        SceneError: If a list has an item of another type, or a name twice.
    """
    if isinstance(given, Scene):
        return given
    if given is None:
        return Scene()
    if isinstance(given, Obstacle):
        return Scene((given,))
    return Scene(of_kind(given, (list, tuple), name, "a Scene or a list of obstacles"))


SceneLike: TypeAlias = Annotated[
    Converted[Scene | Sequence[Obstacle] | Obstacle | None, Scene], as_scene
]
SceneOrNone: TypeAlias = Annotated[
    Converted[Scene | Sequence[Obstacle] | Obstacle | None, Scene | None],
    optional(as_scene),
]


def _warn_of_units(obstacles: Iterable[Obstacle]) -> None:
    """Warn of the first obstacle that is as large or as far away as in millimetres."""
    for item in obstacles:
        edges = _extents(item)
        size, away = float(max(edges)), float(np.linalg.norm(item.position))
        is_far = away - size > LARGE
        if is_far or (size > LARGE and min(edges) > THICK):
            what = f"{away:.4g} m away" if is_far else f"{size:.4g} m across"
            warn_caller(
                f"obstacle {item.name!r} is {what}, as if it were in millimetres: "
                "lengths and positions are in metres"
            )
            return


def _extents(item: Obstacle) -> Array:
    """Extents along the axes of an obstacle [m]; zero for terrain, which is large."""
    if isinstance(item, Box):
        return item.size
    if isinstance(item, Mesh):
        return np.asarray(np.ptp(item.vertices * item.scale, axis=0))
    width = 2.0 * getattr(item, "radius", 0.0)
    return np.array([width, width, getattr(item, "length", width)])


def _whereabouts(obstacle: Obstacle) -> tuple[object, ...]:
    """Key of an obstacle: its placement and its kind."""
    position, rotation = obstacle.position.tolist(), obstacle.rotation.ravel().tolist()
    kind = type(obstacle).__name__
    return (obstacle.motion is not None, *position, kind, *rotation)
