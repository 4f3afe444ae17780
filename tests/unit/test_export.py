"""Motion files in CSV and NPZ: written, read back, and rejected when damaged."""

from __future__ import annotations

import csv
import io
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motion_samples import planar_motions

from tominpmp.cli.output_files import check_target
from tominpmp.description.paths import why_unwritable, write_file
from tominpmp.exceptions import ProblemError, ScenarioError, TominpmpWarning
from tominpmp.files.export import export, load_motion
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory

HEADER = (
    "time,q_joint1,q_joint2,q_joint3,v_joint1,v_joint2,v_joint3,"
    "a_joint1,a_joint2,a_joint3,u_joint1,u_joint2,u_joint3"
)
KEYS = ("t", "q", "v", "a", "u")
ENDINGS = ("csv", "npz")
ROS_ENDINGS = ("yaml", "yml", "json")


@pytest.fixture(scope="module")
def motions() -> tuple[Trajectory, Trajectory]:
    return planar_motions()[1:]


def assert_same(left: Samples, right: Samples) -> None:
    assert left.joint_names == right.joint_names
    for key in KEYS:
        np.testing.assert_array_equal(getattr(left, key), getattr(right, key), key)


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("number", [0, 1], ids=["held torque", "held acceleration"])
def test_exported_nodes_are_read_back_exactly(
    motions: tuple[Trajectory, Trajectory], number: int, ending: str, tmp_path: Path
) -> None:
    motion = motions[number]
    path = export(motion, tmp_path / f"motion.{ending}")
    assert path == tmp_path / f"motion.{ending}"
    back = load_motion(path)
    assert back.joint_names == motion.joint_names
    for key in ("t", "q", "v", "u"):
        np.testing.assert_array_equal(getattr(back, key), getattr(motion, key))
    np.testing.assert_array_equal(back.a, motion(motion.t).a)


@pytest.mark.parametrize("ending", ENDINGS)
def test_export_with_dt_samples_at_a_fixed_rate(
    motions: tuple[Trajectory, Trajectory], ending: str, tmp_path: Path
) -> None:
    back = load_motion(export(motions[1], tmp_path / f"m.{ending}", dt=0.1))
    np.testing.assert_allclose(back.t, [*np.arange(10) / 10, 0.95])
    assert_same(back, motions[1].sample(0.1))
    assert not back.q.flags.writeable


def test_csv_has_a_header_and_shortest_decimals(
    motions: tuple[Trajectory, Trajectory], tmp_path: Path
) -> None:
    motion = motions[0]
    text = export(motion, tmp_path / "m.csv").read_bytes().decode("ascii")
    lines = text.splitlines()
    assert lines[0] == HEADER
    assert len(lines) == 1 + motion.t.size
    assert "\r" not in text
    assert text.endswith("\n")
    assert lines[1].startswith("0.0,0.5,1.7,-1.7,0.0,")
    assert lines[2].split(",")[1] == repr(float(motion.q[1, 0]))


def test_npz_has_named_arrays(
    motions: tuple[Trajectory, Trajectory], tmp_path: Path
) -> None:
    path = export(motions[0], tmp_path / "m.npz")
    with np.load(path, allow_pickle=False) as archive:
        assert set(archive.files) == {"joint_names", *KEYS}
        assert archive["joint_names"].tolist() == ["joint1", "joint2", "joint3"]
        assert archive["q"].shape == (21, 3)


@pytest.mark.parametrize("ending", ENDINGS)
def test_unusual_joint_names_are_read_back(
    motions: tuple[Trajectory, Trajectory], ending: str, tmp_path: Path
) -> None:
    names = ('a,"b"', "q_v_ ü", "line\nbreak")
    motion = replace(motions[0], joint_names=names)
    assert load_motion(export(motion, tmp_path / f"m.{ending}")).joint_names == names


def test_unknown_file_extension_names_the_known_ones(
    motions: tuple[Trajectory, Trajectory], tmp_path: Path
) -> None:
    for path in (tmp_path / "m.xlsx", tmp_path / "m"):
        with pytest.raises(ProblemError, match=r"\.csv, \.npz"):
            export(motions[0], path)
        with pytest.raises(ProblemError, match=r"\.csv, \.npz"):
            load_motion(path)
    assert list(tmp_path.iterdir()) == []


def test_invalid_dt_is_rejected(
    motions: tuple[Trajectory, Trajectory], tmp_path: Path
) -> None:
    for dt in (0.0, -1.0, float("nan")):
        with pytest.raises(ProblemError, match="dt"):
            export(motions[0], tmp_path / "m.csv", dt=dt)


# Atomic writing


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, OSError])
def test_interrupted_writing_keeps_the_former_file(
    error: type[BaseException], tmp_path: Path
) -> None:
    path = tmp_path / "m.csv"
    path.write_text("old")

    def write(file: io.BufferedIOBase) -> None:
        file.write(b"half of the new")
        raise error

    expected = ScenarioError if error is OSError else error
    with pytest.raises(expected):
        write_file(path, write)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_error_of_a_full_disk_has_the_path(tmp_path: Path) -> None:
    def write(file: io.BufferedIOBase) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(ScenarioError, match=r"m\.csv .*No space left") as caught:
        write_file(tmp_path / "m.csv", write)
    assert caught.value.path == tmp_path / "m.csv"
    assert list(tmp_path.iterdir()) == []


def test_export_to_a_missing_folder_or_a_folder_is_an_error(
    motions: tuple[Trajectory, Trajectory], tmp_path: Path
) -> None:
    with pytest.raises(ScenarioError, match="there is no folder"):
        export(motions[0], tmp_path / "nowhere" / "m.csv")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(ScenarioError, match="is a folder"):
        export(motions[0], tmp_path / "folder.csv")


def test_symbolic_link_to_itself_is_replaced(
    motions: tuple[Trajectory, Trajectory], tmp_path: Path
) -> None:
    """Python 3.11 raises a RuntimeError for a symbolic link to itself."""
    loop = tmp_path / "loop.csv"
    loop.symlink_to(loop)
    export(motions[0], loop)
    assert load_motion(loop).t.size == motions[0].t.size


def test_export_through_a_symbolic_link_writes_its_target(
    motions: tuple[Trajectory, Trajectory], tmp_path: Path
) -> None:
    target = tmp_path / "target.csv"
    target.write_text("old")
    link = tmp_path / "link.csv"
    link.symlink_to(target)
    export(motions[0], link)
    assert link.is_symlink()
    assert target.read_text().startswith(HEADER)


def test_writing_to_a_device_is_an_error() -> None:
    with pytest.raises(ScenarioError, match="not a regular file"):
        write_file("/dev/null", lambda file: file.write(b"x"))
    assert not Path("/dev/null").is_file()


def test_new_file_has_the_usual_permissions(tmp_path: Path) -> None:
    usual = tmp_path / "usual"
    usual.touch()
    path = write_file(tmp_path / "m.csv", lambda file: file.write(b"x"))
    assert path.stat().st_mode == usual.stat().st_mode


def test_replaced_file_keeps_its_permissions(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.touch(mode=0o600)
    write_file(path, lambda file: file.write(b"x"))
    assert (path.read_bytes(), path.stat().st_mode & 0o777) == (b"x", 0o600)


def test_reason_against_a_file_to_write_is_that_of_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "m.csv"
    assert why_unwritable(path) == ""
    path.touch()
    monkeypatch.setattr(os, "access", lambda place, _: place != path)
    with pytest.raises(ScenarioError, match=r"m\.csv' is read-only"):
        write_file(path, lambda file: file.write(b"x"))
    with pytest.raises(ScenarioError, match=r"^--output: .*m\.csv' is read-only"):
        check_target(path, "--output", (".csv",))
    monkeypatch.setattr(os, "access", lambda place, _: place != tmp_path)
    with pytest.raises(ScenarioError, match="cannot be written to"):
        write_file(path, lambda file: file.write(b"x"))


def test_missing_folder_of_a_link_is_named(tmp_path: Path) -> None:
    link = tmp_path / "m.csv"
    link.symlink_to(tmp_path / "gone" / "x.csv")
    with pytest.raises(ScenarioError, match=r"there is no folder '.*gone'"):
        write_file(link, lambda file: file.write(b"x"))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write to any file")
def test_read_only_file_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text("old")
    path.chmod(0o400)
    with pytest.raises(ScenarioError, match=r"m\.csv' is read-only"):
        write_file(path, lambda file: file.write(b"x"))
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


# Reading invalid files


@pytest.mark.parametrize("ending", [".csv", ".yaml"])
def test_times_in_milliseconds_cause_a_warning(
    motions: tuple[Trajectory, Trajectory], ending: str, tmp_path: Path
) -> None:
    """Regression: the replay of such a file took a minute, without a hint."""
    motion = motions[0]
    late = replace(motion, t=1e3 * motion.t, segment_ends=None)
    path = export(late, tmp_path / f"m{ending}")
    with pytest.warns(TominpmpWarning, match=r"1\d{3} times as .* times in seconds\?"):
        load_motion(path)


def changed_csv(
    motion: Trajectory, folder: Path, row: int, column: int, to: str
) -> Path:
    path = export(motion, folder / "m.csv")
    lines = list(csv.reader(path.read_text().splitlines()))
    lines[row][column] = to
    path.write_text("\n".join(",".join(line) for line in lines) + "\n")
    return path


@pytest.mark.parametrize(
    ("row", "column", "to", "message"),
    [
        (0, 0, "t", "line 1: expected the columns time"),
        (0, 1, "x_joint1", "line 1: expected the columns time"),
        (0, 5, "v_joint9", "line 1: expected the columns time"),
        (3, 2, "one", "q_joint2: 'one' in line 4 is not a number"),
        (3, 2, "", "q_joint2: '' in line 4 is not a number"),
        (3, 2, "1_0", "q_joint2: '1_0' in line 4 is not a number"),
        (
            3,
            2,
            "\N{FULLWIDTH DIGIT ONE}",
            "q_joint2: .* in line 4 is not a number",
        ),
        (3, 2, "1,2", "line 4: 14 values for 13 columns"),
        (3, 2, "nan", "q: is nan in row 3, at 0.11 s, joint 'joint2'"),
        (3, 11, "inf", "u: is inf in row 3, at 0.11 s, joint 'joint2'"),
        (3, 0, "0.0", "time: must increase, but is 0.055"),
        (2, 0, "1e-300", "time: must increase, but is 0.0"),
        (0, 0, "\x1b[1m", r"line 1: .* found: '\\x1b\[1m, q_joint1"),
        (0, 0, "time;q_joint1", "with commas between them .* found: 'time;q_joint1, q"),
        (3, 0, "nan", "t: is nan in row 3: expected a finite number"),
    ],
)
def test_invalid_csv_entry_is_named_in_the_error(
    motions: tuple[Trajectory, Trajectory],
    row: int,
    column: int,
    to: str,
    message: str,
    tmp_path: Path,
) -> None:
    path = changed_csv(motions[0], tmp_path, row, column, to)
    with pytest.raises(ScenarioError, match=message) as caught:
        load_motion(path)
    assert caught.value.path == path
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "line 1: expected the columns"),
        (b"\xff\xfe\x00", "is not a CSV file"),
        (b"time\n0.0\n", "line 1: expected the columns"),
        (HEADER.encode() + b"\n", "holds 0 rows"),
        (b"time,q_a,q_a,v_a,v_a,a_a,a_a,u_a,u_a\n", "all of them different"),
        (b'time,"q_a\n', "is not a CSV file"),
    ],
)
def test_invalid_csv_file_is_rejected(
    content: bytes, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "m.csv"
    path.write_bytes(content)
    with pytest.raises(ScenarioError, match=message):
        load_motion(path)


def test_csv_with_byte_order_mark_and_blank_lines_is_read(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    text = "\ufefftime,q_a,v_a,a_a,u_a\r\n0,1,2,3,4\r\n\r\n1e-1, 5,6,7,8\r\n"
    path.write_bytes(text.encode("utf-8"))
    samples = load_motion(path)
    np.testing.assert_array_equal(samples.t, [0.0, 0.1])
    np.testing.assert_array_equal(samples.u, [[4.0], [8.0]])


def write_npz(path: Path, **changes: object) -> Path:
    arrays: dict[str, object] = {
        "joint_names": np.array(["a", "b"]),
        "t": np.array([0.0, 1.0, 2.0]),
        **{key: np.zeros((3, 2)) for key in KEYS[1:]},
        **changes,
    }
    np.savez(path, **{k: v for k, v in arrays.items() if v is not None})  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"q": None}, "q: is missing; the file holds: "),
        ({"a": np.zeros((3, 1))}, r"a has shape \(3, 1\), expected \(3, 2\)"),
        ({"t": np.zeros(3)}, "time: must increase"),
        ({"t": np.zeros((3, 1))}, "t has shape"),
        ({"u": np.array([["x", "y"]] * 3)}, "u is .*, expected 2 numbers, one for"),
        ({"q": np.full((3, 2), np.inf)}, "row 1, at 0 s, joint 'a'"),
        ({"joint_names": np.array(["a", "a"])}, "all of them different"),
        ({"joint_names": np.zeros(2)}, "not a list of names"),
        ({"q": np.array([[{}, {}]] * 3)}, "is not an NPZ file"),
    ],
)
def test_invalid_npz_array_is_named_in_the_error(
    changes: dict[str, object], message: str, tmp_path: Path
) -> None:
    path = write_npz(tmp_path / "m.npz", **changes)
    with pytest.raises(ScenarioError, match=message):
        load_motion(path)


def test_missing_or_damaged_npz_file_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    with pytest.raises(ScenarioError, match="there is no file"):
        load_motion(path)
    whole = write_npz(tmp_path / "whole.npz").read_bytes()
    array = io.BytesIO()
    np.save(array, np.zeros(3))
    for content in (b"", b"nonsense", array.getvalue(), whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(ScenarioError, match="is not an NPZ file"):
            load_motion(path)


@pytest.mark.parametrize("ending", ENDINGS)
def test_damaged_motion_files_raise_scenario_errors_only(
    motions: tuple[Trajectory, Trajectory],
    ending: str,
    rng: np.random.Generator,
    tmp_path: Path,
) -> None:
    path = export(motions[0], tmp_path / f"m.{ending}")
    whole = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    refused = 0
    for case in range(120):
        damaged = whole.copy()
        damaged[rng.integers(len(whole), size=3)] = rng.integers(256, size=3)
        end = int(rng.integers(len(whole))) if case % 3 == 0 else len(whole)
        path.write_bytes(damaged[:end].tobytes())
        try:
            load_motion(path)
        except ScenarioError:
            refused += 1
    assert refused > 60
