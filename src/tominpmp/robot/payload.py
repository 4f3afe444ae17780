"""Payloads: bodies that an arm carries, as part of its description.

A payload becomes a link that is fixed to the link that carries it: its mass enters the
dynamics, its shapes collisions and pictures, and its name becomes the name of a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import (
    Array,
    Converted,
    Record,
    array_or_nan,
    default,
    frozen_array,
    record,
)
from tominpmp.checks import HUGE, Centre, instance, non_negative, text, wrong
from tominpmp.description.inertials import impossible_moments
from tominpmp.description.tree import SIZES, LinkDescription, Shape
from tominpmp.exceptions import ProblemError, brief, warn_caller
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.obstacles import Box, Capsule, Cylinder, Obstacle, Sphere

# Relative asymmetry that an inertia matrix may have by rounding.
ROUNDING = 1e-6
# Distance of a centre of mass from which it is probably given in millimetres [m].
FAR = 10.0


Mass: TypeAlias = Annotated[float, partial(non_negative, unit="kg")]
Name: TypeAlias = Annotated[str, partial(text, expected="a name")]


def _checked_inertia(value: object, name: str) -> Array:
    """Check that a rigid body can have an inertia, and symmetrise it, shape (3, 3).

    Raises:
        ProblemError: If it is not a symmetric matrix, or impossible for a rigid body.
    """
    array = array_or_nan(value)
    shaped = array.shape == (3, 3) and bool(np.all(np.abs(array) <= HUGE))
    if not shaped or not np.allclose(array, array.T, rtol=ROUNDING, atol=1e-15):
        raise wrong(value, name, "a symmetric matrix of 3x3 numbers [kg m^2]")
    fault = impossible_moments(array)
    if fault is not None:
        raise ProblemError(f"{name} {fault}", name)
    return frozen_array(0.5 * (array + array.T))


InertiaOrNone: TypeAlias = Annotated[
    Converted[ArrayLike | None, Array | None], _checked_inertia
]


def _checked_shapes(shapes: Any, name: str) -> tuple[Obstacle, ...]:
    """Check the shapes of a payload."""
    if isinstance(shapes, Obstacle):
        shapes = (shapes,)
    shown = "a list of Box, Sphere, Cylinder, Capsule and Mesh (of a file)"
    expected = f"{shown}, which go with the frame, without a motion of their own"
    for item in instance(shapes, Sequence, name, expected):
        known = isinstance(item, (Box, Sphere, Cylinder, Capsule, Mesh))
        without = known and isinstance(item, Mesh) and item.path is None
        if not known or without or item.motion is not None:
            raise ProblemError(f"{name} holds {brief(item)}, expected {expected}", name)
    return tuple(shapes)


Shapes: TypeAlias = Annotated[
    Converted[Sequence[Obstacle] | Obstacle, tuple[Obstacle, ...]], _checked_shapes
]


@record
class Payload(Record):
    """A body fixed to a frame of a robot.

    Attributes:
        mass: Mass [kg].
        frame: Name of the frame that carries it.
        com: Centre of mass in the frame, shape (3,) [m].
        inertia: Inertia about the centre of mass, in the axes of the frame, shape (3,
            3) [kg m^2]; None for a point mass.
        geometry: Its shapes, one or a list, with positions and rotations relative to
            the frame instead of the world.
        name: Name of the link that it becomes, which also appears in link pairs.
    """

    mass: Mass
    frame: Name
    com: Centre = default((0.0, 0.0, 0.0))
    inertia: InertiaOrNone = default(None)
    geometry: Shapes = default(())
    name: Name = "payload"

    _owner = "payload."

    def __post_init__(self) -> None:
        """Check the values, and warn of a centre of mass that is far away."""
        super().__post_init__()
        distance = float(np.linalg.norm(self.com))
        if distance > FAR:
            warn_caller(
                f"payload.com is {distance:.4g} m from the frame, as if it were in "
                "millimetres: lengths and positions are in metres"
            )

    @property
    def _link(self) -> LinkDescription:
        """The link that it becomes."""
        inertia = np.zeros((3, 3)) if self.inertia is None else self.inertia
        shapes = tuple(map(_shape, self.geometry))
        return LinkDescription(self.name, self.mass, self.com, inertia, shapes, shapes)


def _shape(item: Obstacle) -> Shape:
    place = pin.SE3(np.array(item.rotation), np.array(item.position))
    if isinstance(item, Mesh):
        file = str(Path(str(item.path)).absolute())
        return Shape("mesh", tuple(item.scale.tolist()), place, file)
    # The class may be a caller's own, derived from one of the library.
    names = (base.__name__.lower() for base in type(item).__mro__)
    kind = next(name for name in names if name in SIZES)
    sizes = [np.ravel(getattr(item, name)) for name in SIZES[kind]]
    return Shape(kind, tuple(np.concatenate(sizes).tolist()), place)
