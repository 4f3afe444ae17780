"""Sizes of the shapes of a mesh file after expansion, as it may repeat a shape often.

A file of two kilobytes may contain a tree in which each branch repeats the previous one
twice, or declare an array of a billion zeros.
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
        (length,) = struct.unpack("<I", data[12:16])
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
    instances = [
        meshes[node["mesh"]] for node in document.get("nodes", ()) if "mesh" in node
    ]
    names = [buffer.get("uri", "data:") for buffer in document.get("buffers", ())]
    files = [path.parent / name for name in names if not name.startswith("data:")]
    nodes = len(document.get("nodes", ()))
    external = sum(file.stat().st_size for file in files)
    return float(sum(arrays) + sum(instances) + nodes + external)


def _collada_size(root: Element) -> float:
    for element in root.iter():
        element.tag = element.tag.rpartition(":")[2]
    named = {element.get("id"): element for element in root.iter()}
    sizes: dict[Element, float] = {}

    def size(element: Element) -> float:
        """Size of an element's content, including the shapes that it refers to."""
        if element not in sizes:
            sizes[element] = math.inf  # a cyclic reference has no end
            total = len(element.text or "") + sum(map(size, element))
            if element.tag.startswith("instance"):
                shape = named.get(element.get("url", "").removeprefix("#"))
                total += INSTANCE + (0.0 if shape is None else size(shape))
            sizes[element] = total
        return sizes[element]

    try:
        return sum(map(size, root.findall("scene")))
    except RecursionError as error:
        raise ValueError("its shapes contain each other too deeply") from error
