"""Scenes: the obstacles of a workspace, by their names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

import numpy as np

from tominpmp.arrays import Array, Converted, Record
from tominpmp.checks import instance
from tominpmp.exceptions import SceneError, brief, counted, unknown, warn_caller
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.obstacles import Box, Obstacle

# Size or distance of an obstacle from which it is probably given in millimetres, and
# thickness up to which a large obstacle may be a floor [m].
LARGE, THICK = 100.0, 2.0


@dataclass(frozen=True, eq=False)
class Scene(Record):
    """The obstacles of a workspace.

    Attributes:
        obstacles: The obstacles, with distinct names, or a single one; stored as a
            tuple.
    """

    obstacles: Sequence[Obstacle] = ()

    def __post_init__(self) -> None:
        """Check the obstacles and their names."""
        by_name: dict[str, Obstacle] = {}
        listed = np.iterable(self.obstacles)
        for item in self.obstacles if listed else [self.obstacles]:
            if not isinstance(item, Obstacle):
                raise SceneError(
                    "a scene holds obstacles (Sphere, Box, Cylinder, Capsule, Mesh, "
                    f"HeightField, OcTree), not {type(item).__name__}"
                )
            if item.name in by_name:
                raise SceneError(f"two obstacles are named {item.name!r}", item.name)
            by_name[item.name] = item
        self._keep(obstacles=tuple(by_name.values()))
        _warn_of_units(self.obstacles)

    def __iter__(self) -> Iterator[Obstacle]:
        """Iterate over the obstacles."""
        return iter(self.obstacles)

    def __repr__(self) -> str:
        """Show the names of the obstacles on one line."""
        names = brief(", ".join(item.name for item in self.obstacles))[1:-1]
        return f"<Scene with {counted(len(self), 'obstacle')}: {names or 'none'}>"

    def __len__(self) -> int:
        """Return the number of obstacles."""
        return len(self.obstacles)

    def __getitem__(self, name: str) -> Obstacle:
        """Return an obstacle by its name.

        Raises:
            SceneError: If no obstacle has the name.
        """
        by_name = {item.name: item for item in self.obstacles}
        if not isinstance(name, str) or name not in by_name:
            raise SceneError(unknown("obstacle", name, list(by_name)), name)
        return by_name[name]

    @property
    def moving(self) -> tuple[Obstacle, ...]:
        """The obstacles that move."""
        return tuple(item for item in self.obstacles if item.motion is not None)

    @property
    def sorted(self) -> Scene:
        """The scene with its obstacles in the order of their placements.

        The order of the caller's list must not matter: rows of programs are in the
        order of the collision pairs, and the choice of a solver among equally good
        steps depends on the order of the rows.
        """
        ordered = sorted(self.obstacles, key=_placement_key)
        return self._altered(obstacles=tuple(ordered))

    def at(self, time: float) -> Scene:
        """The scene with all obstacles at rest at their placements at a time [s]."""
        still = [x if x.motion is None else x.frozen(time) for x in self.obstacles]
        return self._altered(obstacles=tuple(still))

    def resting(self) -> Scene:
        """The scene without the obstacles that move."""
        still = [item for item in self.obstacles if item.motion is None]
        return self._altered(obstacles=tuple(still))


def as_scene(given: Any, name: str) -> Scene:
    """Convert a caller's scene, obstacle, list of obstacles, or None to a scene.

    Raises:
        ProblemError: If the value has another type.
        SceneError: If a list has an item of another type, or two obstacles have the
            same name.
    """
    if isinstance(given, Scene):
        return given
    if given is None:
        return Scene()
    kinds, expected = (Obstacle, list, tuple), "a Scene or a list of obstacles"
    return Scene(instance(given, kinds, name, expected))


SceneLike: TypeAlias = Annotated[
    Converted[Scene | Sequence[Obstacle] | Obstacle | None, Scene], as_scene
]
SceneOrNone: TypeAlias = Annotated[
    Converted[Scene | Sequence[Obstacle] | Obstacle | None, Scene | None],
    as_scene,
]


def _warn_of_units(obstacles: Iterable[Obstacle]) -> None:
    """Warn of the first obstacle that is probably given in millimetres."""
    for item in obstacles:
        edges = _extents(item)
        size, distance = float(max(edges)), float(np.linalg.norm(item.position))
        is_far = distance - size > LARGE
        if is_far or (size > LARGE and min(edges) > THICK):
            measure = f"{distance:.4g} m away" if is_far else f"{size:.4g} m across"
            warn_caller(
                f"obstacle {item.name!r} is {measure}, as if it were in millimetres: "
                "lengths and positions are in metres"
            )
            return


def _extents(item: Obstacle) -> Array:
    """Extents of an obstacle along its axes, (3,) [m]; zero for (large) terrain."""
    if isinstance(item, Box):
        return item.size
    if isinstance(item, Mesh):
        return np.asarray(np.ptp(item.vertices * item.scale, axis=0))
    width = 2.0 * getattr(item, "radius", 0.0)
    return np.array([width, width, getattr(item, "length", width)])


def _placement_key(obstacle: Obstacle) -> tuple[object, ...]:
    """Sorting key of an obstacle: its placement and its kind."""
    position, rotation = obstacle.position.tolist(), obstacle.rotation.ravel().tolist()
    kind = type(obstacle).__name__
    return (obstacle.motion is not None, *position, kind, *rotation)
