"""Commands of the Meshcat viewer.

The viewer (three.js in a browser page) is driven by small dictionaries whose format
its documentation gives. They are built here without Meshcat's Python package, so that a
page is written without a server.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exceptions import MissingDependency
from tominpmp.output.surfaces import Surface, shaded

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


def node_name(name: str) -> str:
    """Turn a name into one that can stand in a path of the viewer."""
    escaped = name.replace("%", "%25").replace("/", "%2F")
    return f"{escaped}_" if escaped in RESERVED else escaped


def packed(command: Command) -> bytes:
    """Turn a command into MessagePack, as the viewer reads it.

    Raises:
        MissingDependency: If Meshcat, which brings what this needs, is not installed.
    """
    return bytes(_message_pack().packb(command))


def _message_pack() -> Any:
    try:
        import umsgpack
    except ImportError as error:
        raise MissingDependency("meshcat", "viz", "playback") from error
    return umsgpack


def _array(values: np.ndarray[Any, Any], normalized: bool = False) -> Command:
    """Typed array: attribute of a geometry, one row a vertex."""
    kind, code = ARRAY_CODES[values.dtype.name]
    return {
        "itemSize": int(values.shape[1]),
        "type": kind,
        "array": _message_pack().Ext(code, np.ascontiguousarray(values).tobytes()),
        "normalized": normalized,
    }


def geometry(uuid: str, surface: Surface) -> Command:
    """Describe a geometry by its triangles.

    Args:
        uuid: Name that meshes refer to it by.
        surface: The surface.

    Raises:
        MissingDependency: If Meshcat is not installed.
    """
    drawn = shaded(surface)
    attributes = {
        "position": _array(drawn.positions),
        "normal": _array(drawn.normals, normalized=True),
    }
    if drawn.colors is not None:
        attributes["color"] = _array(drawn.colors, normalized=True)
    data = {"attributes": attributes, "index": _array(drawn.faces)}
    return {"uuid": uuid, "type": "BufferGeometry", "data": data}


def material(uuid: str, color: Sequence[float], colored: bool) -> Command:
    """Describe a material.

    Args:
        uuid: Name that meshes refer to it by.
        color: Red, green, blue and opacity from 0 to 1.
        colored: Whether the geometry has colours of its own, which take the place of
            this one.
    """
    red, green, blue = (
        round(255 * float(np.clip(value, 0.0, 1.0))) for value in color[:3]
    )
    opacity = float(np.clip(color[3], 0.0, 1.0))
    return {
        "uuid": uuid,
        "type": "MeshPhongMaterial",
        # Vertices with colours of their own are multiplied with this one.
        "color": 0xFFFFFF if colored else red << 16 | green << 8 | blue,
        "specular": 0x222222,
        "shininess": 25,
        "side": 2,
        "transparent": opacity < 1.0,
        "opacity": opacity,
        "depthWrite": opacity >= 1.0,
        "vertexColors": colored,
    }


def set_object(path: str, shapes: Iterable[Command], root: Command) -> Command:
    """Put an object into the scene.

    Args:
        path: Where in the tree of the scene.
        shapes: Geometries and materials of its meshes.
        root: The mesh or group of meshes.
    """
    parts: dict[str, list[Command]] = {"geometries": [], "materials": []}
    for shape in shapes:
        kind = "geometries" if shape["type"] == "BufferGeometry" else "materials"
        parts[kind].append(shape)
    metadata = {"version": 4.5, "type": "Object"}
    return {
        "type": "set_object",
        "path": path,
        "object": {"metadata": metadata, **parts, "object": root},
    }


def solid(path: str, surface: Surface, color: Sequence[float]) -> Command:
    """Put a body of one surface into the scene.

    Args:
        path: Where in the tree of the scene.
        surface: Its surface.
        color: Red, green, blue and opacity from 0 to 1.

    Raises:
        MissingDependency: If Meshcat is not installed.
    """
    shapes = [
        geometry(f"{path}#g", surface),
        material(f"{path}#m", color, surface.colors is not None),
    ]
    root = {
        "uuid": path,
        "type": "Mesh",
        "geometry": f"{path}#g",
        "material": f"{path}#m",
    }
    return set_object(path, shapes, root)


def columns(placement: Array) -> list[float]:
    """List a homogeneous matrix by columns, as the viewer takes it."""
    return [float(value) for value in placement.T.reshape(-1)]


def set_transform(path: str, placement: Array) -> Command:
    """Place what is at a path by a homogeneous matrix, shape (4, 4)."""
    return {"type": "set_transform", "path": path, "matrix": columns(placement)}


def set_property(path: str, name: str, value: Any) -> Command:
    """Set a property of what is at a path."""
    return {"type": "set_property", "path": path, "property": name, "value": value}
