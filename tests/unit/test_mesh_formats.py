"""Mesh files of each format, and small files that repeat one shape a million times."""

from __future__ import annotations

import json
import struct
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from robot_samples import one_shape
from robot_samples import write as write_robot

import tominpmp as tm
from tominpmp.robot.robot import load_robot

FORMATS = ("stl", "obj", "dae", "glb", "gltf", "off", "ply")


def write(path: Path, shape: trimesh.Trimesh | trimesh.Scene) -> Path:
    """Write a mesh or a scene, which in glTF is more than one file."""
    found: Any = shape.export(file_type=path.suffix[1:])
    if isinstance(found, dict):
        for name, data in found.items():
            (path.parent / name.replace("model.gltf", path.name)).write_bytes(data)
    else:
        path.write_bytes(found.encode() if isinstance(found, str) else found)
    return path


def volume(mesh: tm.Mesh) -> float:
    a, b, c = np.moveaxis(mesh.points[mesh.triangles], 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


@pytest.mark.parametrize("ending", FORMATS)
def test_every_format_yields_the_same_bodies(ending: str, tmp_path: Path) -> None:
    """A file has a shape twice, the second time moved: the mesh has both."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box((1.0, 2.0, 3.0)), geom_name="box")
    place = trimesh.transformations.translation_matrix((5.0, 0.0, 0.0))
    scene.graph.update("second", geometry="box", matrix=place)
    shape = scene if ending in ("glb", "gltf") else scene.to_mesh()
    mesh = tm.Mesh("m", path=write(tmp_path / f"a.{ending}", shape))
    assert len(mesh.triangles) == 24
    assert volume(mesh) == pytest.approx(12.0)
    np.testing.assert_allclose(mesh.points.min(axis=0), [-0.5, -1.0, -1.5], atol=1e-6)
    np.testing.assert_allclose(mesh.points.max(axis=0), [5.5, 1.0, 1.5], atol=1e-6)


def test_relative_path_refers_to_the_folder_at_the_time_of_the_call(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path / "a.stl", trimesh.creation.box())
    mesh = tm.Mesh("m", path="a.stl")
    monkeypatch.chdir(tmp_path.parent)
    assert mesh.path == path and replace(mesh, vertices=None, triangles=None) == mesh


def assert_refused(path: Path, message: str) -> None:
    """Check that a file is refused, and takes little memory."""
    tracemalloc.start()
    try:
        with pytest.raises(tm.SceneError, match=message):
            tm.Mesh("m", path=path)
        assert tracemalloc.get_traced_memory()[1] < 2**25
    finally:
        tracemalloc.stop()


def collada(nodes: str, shown: str) -> str:
    """A COLLADA file with a triangle `g`, given nodes, and the node that is shown."""
    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><up_axis>Z_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="9">0 0 0 1 0 0 0 1 0</float_array>
<technique_common><accessor source="#pa" count="3" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p>
</triangles></mesh></geometry></library_geometries>
<library_nodes>{nodes}</library_nodes><library_visual_scenes><visual_scene id="s">
<node id="root"><instance_node url="#{shown}"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""


def doubling(times: int) -> str:
    """A COLLADA file of nodes that each contain the previous node twice."""
    nodes = '<node id="n0"><instance_geometry url="#g"/></node>'
    for i in range(1, times + 1):
        twice = f'<instance_node url="#n{i - 1}"/>' * 2
        nodes += f'<node id="n{i}">{twice}</node>'
    return collada(nodes, f"n{times}")


def test_collada_nodes_that_double_repeatedly_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.dae"
    path.write_text(doubling(5))
    assert len(tm.Mesh("m", path=path).triangles) == 2**5
    here = '<instance_geometry url="#g"/>'
    moved = f'<node id="b"><translate>5 0 0</translate>{here}</node>'
    path.write_text(collada(f'<node id="a">{here}{moved}</node>', "a"))
    found = tm.Mesh("m", path=path)
    assert sorted(found.points[found.triangles][..., 0].min(axis=1)) == [0.0, 5.0]
    for times in (16, 40):
        path.write_text(doubling(times))
        assert_refused(path, "says in .* that it holds shapes of")
    path.write_text(doubling(400))  # Python 3.10 counts further frames
    assert_refused(path, "says in .* that it holds shapes of|are nested too deeply")
    path.write_text(doubling(2000))  # the reader of such a file may crash
    assert_refused(path, "its shapes are nested too deeply")
    path.write_text(collada('<node id="a"><instance_node url="#a"/></node>', "a"))
    assert_refused(path, "says in .* that it holds shapes of inf")
    path.write_text(doubling(0).replace("<COLLADA", "<!DOCTYPE a><COLLADA"))
    assert_refused(path, "document type")


@pytest.mark.parametrize("tag", ["collision", "visual"])
def test_robot_meshes_that_double_repeatedly_are_refused(
    tag: str, tmp_path: Path
) -> None:
    path = write_robot(tmp_path, one_shape('<mesh filename="a.dae"/>', tag))
    (tmp_path / "a.dae").write_text(doubling(5))
    model = getattr(load_robot(path), f"{tag}_model")
    assert model.geometryObjects[-1].geometry.num_tris == 2**5
    (tmp_path / "a.dae").write_text(doubling(40))
    with pytest.raises(tm.RobotLoadError, match=r"a\.dae says in .* that it holds"):
        getattr(load_robot(path), f"{tag}_model")


def gltf(count: float, nodes: int = 1) -> dict[str, Any]:
    """A glTF file whose only array has no data, which means zeros."""
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(nodes))}],
        "nodes": [{"mesh": 0}] * nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"componentType": 5126, "count": count, "type": "VEC3"}],
    }


@pytest.mark.parametrize("ending", ["glb", "gltf"])
@pytest.mark.parametrize(
    "document",
    [gltf(10**8), gltf(10**30), gltf(-(10**9)), gltf(10_000, 2000), gltf(float("inf"))],
)
def test_gltf_files_of_too_many_zeros_are_refused(
    ending: str, document: dict[str, Any], tmp_path: Path
) -> None:
    path = tmp_path / f"a.{ending}"
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text))
    head += struct.pack("<II", len(text), 0x4E4F534A)
    path.write_bytes(head + text if ending == "glb" else text)
    assert_refused(path, "says in .* that it holds shapes of")


def test_gltf_nodes_that_double_repeatedly_are_refused(tmp_path: Path) -> None:
    """Regression: a node was counted once, however often its parents repeat it."""
    path = tmp_path / "a.gltf"

    def shown(*nodes: dict[str, Any]) -> dict[str, Any]:
        return gltf(3) | {"nodes": nodes, "scenes": [{"nodes": [0]}]}

    twice = [{"children": [k + 1, k + 1]} for k in range(40)]
    path.write_text(json.dumps(shown(*twice, {"mesh": 0})))
    assert_refused(path, "says in .* that it holds shapes of")
    path.write_text(json.dumps(shown({"children": [0], "mesh": 0})))
    assert_refused(path, "says in .* that it holds shapes of inf")
    deep = [{"children": [k + 1]} for k in range(5000)]
    path.write_text(json.dumps(shown(*deep, {"mesh": 0})))
    assert_refused(path, "its shapes are nested too deeply")


def test_gltf_files_may_not_refer_to_other_folders(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    path = tmp_path / "in" / "a.gltf"
    view = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
    document = gltf(3) | {
        "accessors": [view],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
    }
    (tmp_path / "b.bin").write_bytes(np.eye(3, dtype="<f4").tobytes())
    for name in ("../b.bin", "/dev/zero", str(tmp_path / "b.bin")):
        buffers = {"buffers": [{"byteLength": 36, "uri": name}]}
        path.write_text(json.dumps(document | buffers))
        assert_refused(path, "cannot be read")
    (path.parent / "b.bin").write_bytes(np.eye(3, dtype="<f4").tobytes())
    buffers = {"buffers": [{"byteLength": 36, "uri": "b.bin"}]}
    path.write_text(json.dumps(document | buffers))
    assert len(tm.Mesh("m", path=path).triangles) == 1
    with (path.parent / "b.bin").open("ab") as file:
        file.truncate(10**9)  # takes no space
    assert_refused(path, "says in .* that it holds shapes of")


@pytest.mark.parametrize(
    "text",
    ["[]", "{", '{"nodes": 3}', '{"accessors": [{"count": "x"}]}', "[" * 10**5, ""],
)
def test_invalid_gltf_files_are_refused(text: str, tmp_path: Path) -> None:
    for name in ("a.gltf", "a.glb"):
        path = tmp_path / name
        path.write_text(text)
        assert_refused(path, "cannot be read")


def test_error_says_that_a_mesh_path_is_a_folder(tmp_path: Path) -> None:
    """Regression: the message said that the parent folder has no file of this name."""
    with pytest.raises(tm.SceneError, match=r"mesh .* is a folder, expected a file"):
        tm.Mesh("m", path=tmp_path)
