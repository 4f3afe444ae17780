"""Large files, and small files of large content, are refused or take little memory."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.files import ros, tables
from tominpmp.scene import mesh_files

HEAD = b"time,q_a\n"


def read(path: Path, content: bytes) -> tm.Samples:
    path.write_bytes(content)
    return tm.load_motion(path)


@pytest.mark.parametrize("kind", ["<U0", "|S0", "|V0", "<U1"])
@pytest.mark.parametrize("count", [10**9, 10**8])
def test_archive_member_with_a_false_size_is_refused_in_little_memory(
    kind: str, count: int, tmp_path: Path
) -> None:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for key in ("joint_names", "t", "q"):
            head = io.BytesIO()
            fields = {"descr": kind, "fortran_order": False, "shape": (count,)}
            np.lib.format.write_array_header_1_0(head, fields)
            archive.writestr(f"{key}.npy", head.getvalue())
    tracemalloc.start()
    try:
        with pytest.raises(tm.ScenarioError, match="says that it holds") as error:
            read(tmp_path / "a.npz", file.getvalue())
        assert tracemalloc.get_traced_memory()[1] < 2**24
    finally:
        tracemalloc.stop()
    assert len(str(error.value)) < 500


def test_archive_of_many_members_is_refused(tmp_path: Path) -> None:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for number in range(1000):
            archive.writestr(str(number), b"")
    with pytest.raises(tm.ScenarioError, match="more than 100 members"):
        read(tmp_path / "a.npz", file.getvalue())


def test_rows_of_a_table_take_little_more_memory_than_their_numbers(
    tmp_path: Path,
) -> None:
    count = 50_000
    read(tmp_path / "few.csv", HEAD + b"0,0.5\n1,0.5\n")  # imports its modules
    content = HEAD + b"".join(b"%d,0.5\n" % i for i in range(count))
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    tracemalloc.start()
    try:
        found = tm.load_motion(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found.q.shape == (count, 1)
    assert found.t[-1] == count - 1
    # The numbers, the numbers left out, copies of both, the file, and a batch.
    assert peak < 12 * 8 * count + len(content) + 2**21


def test_tables_beyond_the_limits_of_size_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.csv"
    monkeypatch.setattr(tables, "MAX_ROWS", 1000)
    rows = b"".join(b"%d,0.5\n" % i for i in range(1000))
    assert read(path, HEAD + rows).t.size == 1000
    for more in (b"1000,0.5\n", b"\n"):
        with pytest.raises(tm.ScenarioError, match=r"line 1002: .* or 1000 rows"):
            read(path, HEAD + rows + more)
    monkeypatch.setattr(tables, "MAX_NUMBERS", 1999)
    with pytest.raises(tm.ScenarioError, match="more than 1999 numbers"):
        read(path, HEAD + rows)
    monkeypatch.setattr(tables, "LONGEST_LINE", 100)
    for content in (b"," * 200, HEAD + b"," * 200, b"a" * 200):
        with pytest.raises(tm.ScenarioError, match="more than 100 characters"):
            read(path, content)


def test_wrong_value_far_down_is_named_by_line_and_column(tmp_path: Path) -> None:
    rows = b"".join(b"%d,0.5\n" % i for i in range(25_000))
    with pytest.raises(tm.ScenarioError, match="q_a: 'x' in line 25002"):
        read(tmp_path / "a.csv", HEAD + rows + b"25000,x\n")


def test_messages_of_too_many_values_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros, "MAX_VALUES", 1000)
    for content in (b"[" + b"[]," * 1000 + b"0]", b"[" + b'{"a":0},' * 400 + b"0]"):
        with pytest.raises(tm.ScenarioError, match="more than 1000 values"):
            read(tmp_path / "a.json", content)


def archive() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as found:
        found.writestr("a.stl", bytes(10**6))
    return file.getvalue()


@pytest.mark.parametrize("ending", [".stl", ".obj", ".ply", ".dae", ".glb", ".zip"])
@pytest.mark.parametrize("begin", [archive(), b"\x1f\x8b\x08", b"BZh9", b"\xfd7zXZ\0"])
def test_archive_is_refused_as_a_mesh(
    ending: str, begin: bytes, tmp_path: Path
) -> None:
    path = tmp_path / f"a{ending}"
    path.write_bytes(begin)
    with pytest.raises(tm.SceneError, match="it is an archive"):
        tm.Mesh("m", path=path)


def test_a_binary_mesh_may_begin_like_an_archive(tmp_path: Path) -> None:
    triangle = np.array([0, 0, 0, *np.eye(3).ravel()], "<f4").tobytes() + bytes(2)
    data = b"PKG-7 bracket".ljust(80) + struct.pack("<I", 1) + triangle
    (tmp_path / "a.stl").write_bytes(data)
    assert len(tm.Mesh("m", path=tmp_path / "a.stl").vertices) == 3


@pytest.mark.parametrize("ending", [".3mf", ".zae", ".txt", ""])
def test_unknown_file_extensions_of_meshes_are_refused(
    ending: str, tmp_path: Path
) -> None:
    path = tmp_path / f"a{ending}"
    path.write_bytes(b"solid")
    with pytest.raises(tm.SceneError, match="meshes are not read from"):
        tm.Mesh("m", path=path)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.obj", b"v 0 0 0\n" + b"f 1 1 1\n" * 20),
        ("a.obj", b"v 0 0 0\nf" + b" 1" * 30),
        ("a.obj", b"v 0 0 0\n" * 40),
        ("a.stl", b"solid\n" + b"vertex 0 0 0\n" * 40),
        ("a.stl", bytes(80) + struct.pack("<I", 20) + bytes(20 * 50)),
    ],
)
def test_meshes_of_too_many_triangles_are_refused(
    name: str, content: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mesh_files, "MAX_TRIANGLES", 10)
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(tm.SceneError, match="more than 10 triangles"):
        tm.Mesh("m", path=path)


@pytest.mark.parametrize("name", ["a.stl", "a.obj"])
def test_empty_lines_of_a_mesh_take_little_memory(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(b"solid\n" + b"\n" * 10**7 + b"vertex 0 0\nf 1\n")
    tracemalloc.start()
    try:
        with pytest.raises(tm.SceneError, match=r"line 1000000[23]: "):
            tm.Mesh("m", path=path)
        assert tracemalloc.get_traced_memory()[1] < 2 * 10**7 + 2**22
    finally:
        tracemalloc.stop()


def test_line_of_a_mesh_that_is_too_long_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_bytes(b"v 0 0 0\nf" + b" 1" * 100_000)
    with pytest.raises(tm.SceneError, match="line 2 is longer"):
        tm.Mesh("m", path=path)
