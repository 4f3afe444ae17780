"""Meshcat's viewer without a server, and what its Python package lacks.

Scenes are drawn with Meshcat's own ``Visualizer``. Its meshes of triangles have no
normals, and four bytes for every number; so bodies have a geometry of this module, with
which sharp edges stay sharp and pages small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exceptions import optional
from tominpmp.viz.surfaces import Surface, shaded

Command = dict[str, Any]

# Types of arrays by their name in JavaScript: extension code in MessagePack.
ARRAY_CODES = {
    "int8": ("Int8Array", 0x11),
    "uint8": ("Uint8Array", 0x12),
    "uint32": ("Uint32Array", 0x16),
    "float32": ("Float32Array", 0x17),
}
# Names that every object of JavaScript has already.
RESERVED = frozenset(
    "constructor hasOwnProperty isPrototypeOf propertyIsEnumerable toLocaleString "
    "toString valueOf __proto__ __defineGetter__ __defineSetter__ __lookupGetter__ "
    "__lookupSetter__".split()
)


def import_meshcat() -> Any:
    """Import Meshcat when it is needed: it brings a server and half of IPython.

    Raises:
        MissingDependency: If it is not installed.
    """
    with optional("meshcat", "viz", "playback"):
        import meshcat
    return meshcat


class Recorder:
    """Window of a ``meshcat.Visualizer`` that keeps what it is sent.

    Attributes:
        commands: The commands as the viewer reads them, in order.
    """

    def __init__(self) -> None:
        self.commands: list[Command] = []

    def send(self, command: Any) -> None:
        """Take a command of Meshcat."""
        self.commands.append(command.lower())


def node_name(name: str) -> str:
    """Turn a name into one that can stand in a path of the viewer."""
    escaped = name.replace("%", "%25").replace("/", "%2F")
    return f"{escaped}_" if escaped in RESERVED else escaped


@dataclass(frozen=True)
class ShadedGeometry:
    """A geometry of Meshcat: triangles with normals, and colours if they have any.

    Attributes:
        uuid: Name that meshes refer to it by.
        surface: The surface.
    """

    uuid: str
    surface: Surface

    def intrinsic_transform(self) -> Array:
        """Placement of the geometry in its mesh."""
        return np.eye(4)

    def lower_in_object(self, data: Command) -> None:
        """Add it to the geometries of an object."""
        drawn = shaded(self.surface)
        attributes = {
            "position": _packed(drawn.positions),
            "normal": _packed(drawn.normals, normalized=True),
        }
        if drawn.colors is not None:
            attributes["color"] = _packed(drawn.colors, normalized=True)
        buffers = {"attributes": attributes, "index": _packed(drawn.faces)}
        geometry = {"uuid": self.uuid, "type": "BufferGeometry", "data": buffers}
        data["geometries"].append(geometry)


def _packed(values: np.ndarray[Any, Any], normalized: bool = False) -> Command:
    """Typed array: attribute of a geometry, one row a vertex."""
    import umsgpack

    kind, code = ARRAY_CODES[values.dtype.name]
    return {
        "itemSize": int(values.shape[1]),
        "type": kind,
        "array": umsgpack.Ext(code, np.ascontiguousarray(values).tobytes()),
        "normalized": normalized,
    }


def put_body(
    viewer: Any,
    surface: Surface,
    color: Sequence[float],
    placement: Array | None = None,
) -> None:
    """Put a body of one surface into the scene; colours are RGBA from 0 to 1."""
    viewer.set_object(_mesh(viewer.path.lower(), surface, color))
    if placement is not None:
        viewer.set_transform(placement)


def _mesh(path: str, surface: Surface, color: Sequence[float]) -> Any:
    """A ``meshcat.geometry.Mesh``, named so that pages are the same every time."""
    geometry = import_meshcat().geometry
    colored = surface.colors is not None
    *rgb, opacity = np.clip(color, 0.0, 1.0).tolist()
    red, green, blue = (round(255 * value) for value in rgb)
    material = geometry.MeshPhongMaterial(
        # Vertices with colours of their own are multiplied with this one.
        color=0xFFFFFF if colored else red << 16 | green << 8 | blue,
        opacity=opacity,
        vertexColors=colored,
        specular=0x222222,
        shininess=25,
        depthWrite=opacity >= 1.0,
    )
    material.uuid = f"{path}#m"
    body = geometry.Mesh(ShadedGeometry(f"{path}#g", surface), material)
    body.uuid = path
    return body


@dataclass(frozen=True, eq=False)
class SetCopies:
    """Command that shows copies of bodies, which share geometry and material.

    Attributes:
        path: Where in the tree of the scene.
        bodies: Surface and colour of each body.
        placements: Where the copies of each body are, homogeneous, shape (m, 4, 4).
    """

    path: str
    bodies: Sequence[tuple[Surface, Sequence[float]]]
    placements: Sequence[Array]

    def lower(self) -> Command:
        """The command as the viewer reads it."""
        data: Command = {"geometries": [], "materials": []}
        children = []
        for i, (body, places) in enumerate(
            zip(self.bodies, self.placements, strict=True)
        ):
            mesh = _mesh(f"{self.path}#{i}", *body).lower()
            data["geometries"] += mesh["geometries"]
            data["materials"] += mesh["materials"]
            for k, place in enumerate(places):
                # The viewer takes matrices by columns.
                own = {
                    "uuid": f"{self.path}#{i}.{k}",
                    "matrix": place.T.ravel().tolist(),
                }
                children.append({**mesh["object"], **own})
        group = {"uuid": self.path, "type": "Group", "children": children}
        metadata = {"version": 4.5, "type": "Object"}
        return {
            "type": "set_object",
            "path": self.path,
            "object": {"metadata": metadata, **data, "object": group},
        }
