"""How large the shapes of a mesh file become, which may show one of them many times.

A file of two kilobytes may hold a tree of which each branch is the one before it twice,
or say that it has an array of a billion zeros.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from tominpmp.description.xml_reader import parse_xml

# What showing a shape takes beside the shape, and a number of one [bytes].
INSTANCE = 2000
NUMBER = 16


def expanded_size(suffix: str, data: bytes, path: Path) -> float:
    """Bytes that the shapes of a file take, each as often as it is shown.

    Args:
        suffix: Ending of its name, which says what it is.
        data: Its content.
        path: The file.

    Returns:
        An estimate from above, infinite where a shape contains itself; the size of the
        file where shapes cannot be shown twice.

    Raises:
        Exception: Of any kind, if the file is not what its name says.
    """
    if suffix == ".dae":
        return _collada_size(parse_xml(data, path))
    if suffix == ".glb":
        (length,) = struct.unpack("<I", data[12:16])
        return _gltf_size(json.loads(data[20 : 20 + length]), path)
    if suffix == ".gltf":
        return _gltf_size(json.loads(data), path)
    return len(data)


def _gltf_size(document: Mapping[str, Any], path: Path) -> float:
    arrays = [NUMBER * abs(found["count"]) for found in document.get("accessors", ())]
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
    shown = [
        meshes[node["mesh"]] for node in document.get("nodes", ()) if "mesh" in node
    ]
    names = [buffer.get("uri", "data:") for buffer in document.get("buffers", ())]
    files = [path.parent / name for name in names if not name.startswith("data:")]
    nodes = len(document.get("nodes", ()))
    beside = sum(file.stat().st_size for file in files)
    return float(sum(arrays) + sum(shown) + nodes + beside)


def _collada_size(root: Element) -> float:
    for element in root.iter():
        element.tag = element.tag.rpartition(":")[2]
    named = {element.get("id"): element for element in root.iter()}
    sizes: dict[Element, float] = {}

    def size(element: Element) -> float:
        """Size of what is below an element, and of what that refers to."""
        if element not in sizes:
            sizes[element] = math.inf  # what contains itself has no end
            total = len(element.text or "") + sum(map(size, element))
            if element.tag.startswith("instance"):
                shape = named.get(element.get("url", "").removeprefix("#"))
                total += INSTANCE + (0.0 if shape is None else size(shape))
            sizes[element] = total
        return sizes[element]

    return sum(map(size, root.findall("scene")))
