"""Sizes of the shapes of a mesh file after expansion, as it may repeat a shape often.

A file of two kilobytes may contain a tree in which each branch repeats the previous one
twice, or declare an array of a billion zeros.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from tominpmp.description.xml_reader import parse_xml

# Endings of formats in which a shape may be repeated.
INSTANCED = (".dae", ".glb", ".gltf")
# Memory of an instance in addition to its shape, and of a number of a shape [bytes].
INSTANCE = 2000
NUMBER = 16
# Most memory for shapes in addition to twice the size of their file [bytes].
MAX_EXPANDED = 50_000_000


def check_expanded(path: Path, data: bytes) -> None:
    """Check that the shapes of a mesh file, with all repetitions, fit into memory.

    Raises:
        ValueError: If they take much more memory than the file.
        Exception: Of any kind, if the content does not match the ending.
    """
    suffix = path.suffix.lower()
    size = 0.0
    if suffix == ".dae":
        size = _collada_size(parse_xml(data, path))
    elif suffix == ".glb":
        length = int.from_bytes(data[12:16], "little")
        size = _gltf_size(json.loads(data[20 : 20 + length]), path)
    elif suffix == ".gltf":
        size = _gltf_size(json.loads(data), path)
    most = MAX_EXPANDED + 2 * len(data)
    if size > most:
        raise ValueError(
            f"{path.name} says in {len(data)} bytes that it holds shapes of {size:g}, "
            f"more than {most}"
        )


def _gltf_size(document: Mapping[str, Any], path: Path) -> float:
    arrays = [NUMBER * abs(item["count"]) for item in document.get("accessors", ())]
    meshes = [
        INSTANCE
        + sum(
            arrays[index]
            for primitive in mesh["primitives"]
            for index in (*primitive["attributes"].values(), primitive.get("indices"))
            if index is not None
        )
        for mesh in document.get("meshes", ())
    ]
    names = [buffer.get("uri", "data:") for buffer in document.get("buffers", ())]
    files = [path.parent / name for name in names if not name.startswith("data:")]
    external = sum(file.stat().st_size for file in files)
    nodes = [
        (1 + (meshes[node["mesh"]] if "mesh" in node else 0), node.get("children", ()))
        for node in document.get("nodes", ())
    ]
    shown = [k for scene in document.get("scenes", ()) for k in scene.get("nodes", ())]
    return float(sum(arrays) + external + _expanded_size(shown, nodes.__getitem__))


def _collada_size(root: Element) -> float:
    for element in root.iter():
        element.tag = element.tag.rpartition(":")[2]
    named = {element.get("id"): element for element in root.iter()}

    def content(element: Element) -> tuple[float, Iterable[Element]]:
        size, shape = len(element.text or ""), None
        if element.tag.startswith("instance"):
            size += INSTANCE
            shape = named.get(element.get("url", "").removeprefix("#"))
        return size, [*element] if shape is None else [*element, shape]

    return _expanded_size(root.findall("scene"), content)


def _expanded_size(
    items: Iterable[Any], content: Callable[[Any], tuple[float, Iterable[Any]]]
) -> float:
    """Size of items with all that they contain, as often as it is repeated.

    Args:
        items: The items.
        content: Returns the size of an item itself, and the items that it contains.

    Raises:
        ValueError: If they contain each other so deeply that their reader may crash.
    """
    sizes: dict[Any, float] = {}

    def size(item: Any) -> float:
        if item not in sizes:
            sizes[item] = math.inf  # a cyclic reference has no end
            own, inside = content(item)
            sizes[item] = own + sum(map(size, inside))
        return sizes[item]

    try:
        return sum(map(size, items))
    except RecursionError as error:
        raise ValueError("its shapes are nested too deeply") from error
