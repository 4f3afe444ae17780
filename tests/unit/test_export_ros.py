"""Motions as ROS messages in YAML and JSON, and files without some quantities."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from motion_samples import planar_motions

from tominpmp.exceptions import ScenarioError
from tominpmp.files.export import export, load_motion
from tominpmp.motion.trajectory import Trajectory

ENDINGS = ("yaml", "yml", "json")


@pytest.fixture(scope="module")
def motions() -> tuple[Trajectory, Trajectory]:
    return planar_motions()[1:]


def message(**changes: Any) -> dict[str, Any]:
    points = [
        {
            "positions": [0.1 * k, 1.0],
            "velocities": [0.1, 0.0],
            "accelerations": [],
            "effort": [],
            "time_from_start": {"sec": k, "nanosec": 5},
        }
        for k in range(3)
    ]
    return {"joint_names": ["a", "b"], "points": points} | changes


def write(folder: Path, content: object, name: str = "m.json") -> Path:
    path = folder / name
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("dt", [None, 0.1, 0.001])
def test_exported_messages_are_read_back(
    motions: tuple[Trajectory, Trajectory],
    ending: str,
    dt: float | None,
    tmp_path: Path,
) -> None:
    motion = motions[1]
    path = export(motion, tmp_path / f"m.{ending}", dt=dt, with_effort=True)
    back = load_motion(path)
    full = load_motion(export(motion, tmp_path / "m.npz", dt=dt))
    assert back.joint_names == full.joint_names
    np.testing.assert_allclose(back.t, full.t, rtol=0.0, atol=0.5e-9)
    assert np.all(np.diff(back.t) > 0.0)
    # The written state is that of the motion at the written time, to the last bit.
    state = motion(back.t)
    np.testing.assert_array_equal(back.q[:-1], state.q[:-1])
    np.testing.assert_array_equal(back.v[:-1], state.v[:-1])
    np.testing.assert_array_equal(back.u[:-1], state.u[:-1])
    # At the end the arm is exactly at rest.
    np.testing.assert_array_equal(back.q[-1], motion.q[-1])
    np.testing.assert_array_equal(back.v[-1], np.zeros(3))
    # The accelerations jump: a polynomial of degree 5 would overshoot.
    assert np.isnan(back.a).all()


@pytest.mark.parametrize("ending", ENDINGS)
def test_messages_have_the_fields_of_ros(
    motions: tuple[Trajectory, Trajectory], ending: str, tmp_path: Path
) -> None:
    path = export(motions[0], tmp_path / f"m.{ending}", dt=0.25, with_effort=True)
    # ROS has a reader of YAML 1.1, which also reads JSON.
    found = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert list(found) == ["header", "joint_names", "points"]
    assert found["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    assert found["joint_names"] == ["joint1", "joint2", "joint3"]
    samples = motions[0].sample(0.25)
    assert len(found["points"]) == samples.t.size
    for k, point in enumerate(found["points"]):
        assert list(point) == [
            "positions",
            "velocities",
            "accelerations",
            "effort",
            "time_from_start",
        ]
        assert point["positions"] == pytest.approx(samples.q[k], abs=1e-14)
        assert point["effort"] == samples.u[k].tolist()
        time = point["time_from_start"]
        assert 0 <= time["nanosec"] < 10**9
        assert time["sec"] + time["nanosec"] / 1e9 == pytest.approx(samples.t[k])


def test_small_numbers_are_read_as_numbers_by_yaml_1_1(tmp_path: Path) -> None:
    q = np.array([[1e-5, -2e-300], [1e300, 1.5e-7]])
    motion = Trajectory(("a", "b"), np.array([0.0, 1.0]), q, 0 * q, 0 * q)
    path = export(motion, tmp_path / "m.yaml")
    points = yaml.safe_load(path.read_text())["points"]
    assert [point["positions"] for point in points] == q.tolist()


def test_nearly_coincident_nodes_are_merged(tmp_path: Path) -> None:
    t = np.array([0.0, 1e-10, 2e-10, 0.5, 0.5 + 1e-11, 12.345678901])
    q = np.arange(12.0).reshape(6, 2)
    motion = Trajectory(("a", "b"), t, q, 0 * q, 0 * q)
    back = load_motion(export(motion, tmp_path / "m.json"))
    assert back.t.tolist() == [0.0, 0.5, 12.345678901]


def test_moving_end_is_extrapolated_to_the_time_of_the_last_point(
    tmp_path: Path,
) -> None:
    """Regression: the last position was that of the end, half a nanosecond earlier.

    This was a jump of the torque.
    """
    t = np.array([0.0, 1.0, 1.0000200004])
    v, a = np.full((3, 1), 2.0), np.zeros((2, 1))
    motion = Trajectory(("a",), t, 2.0 * t[:, None], v, 0.0 * v, a)
    back = load_motion(export(motion, tmp_path / "m.yaml"))
    speeds = np.diff(back.q[:, 0]) / np.diff(back.t)
    np.testing.assert_allclose(speeds, 2.0, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    "wrap",
    [
        lambda m: {"joint_trajectory": m},
        lambda m: {"trajectory": [{"joint_trajectory": m}]},
        lambda m: {"goal": {"trajectory": m}},
    ],
)
def test_trajectory_is_found_inside_other_messages(wrap: Any, tmp_path: Path) -> None:
    samples = load_motion(write(tmp_path, wrap(message())))
    assert samples.joint_names == ("a", "b")
    np.testing.assert_allclose(samples.t, [5e-9, 1 + 5e-9, 2 + 5e-9])


def test_missing_quantities_of_a_message_are_nan(tmp_path: Path) -> None:
    samples = load_motion(write(tmp_path, message()))
    np.testing.assert_allclose(samples.q, [[0.0, 1.0], [0.1, 1.0], [0.2, 1.0]])
    assert np.all(samples.v == [0.1, 0.0])
    assert np.isnan(samples.a).all()
    assert np.isnan(samples.u).all()


@pytest.mark.parametrize("time", [1.5, {"secs": 1, "nsecs": 500_000_000}])
def test_time_from_start_may_be_a_number_or_of_ros_1(
    time: object, tmp_path: Path
) -> None:
    content = message()
    content["points"][1]["time_from_start"] = time
    assert load_motion(write(tmp_path, content)).t[1] == 1.5


def test_csv_and_npz_may_lack_velocities_and_efforts(tmp_path: Path) -> None:
    csv = tmp_path / "m.csv"
    csv.write_text("time,q_a,q_b,u_a,u_b\n0,1,2,7,8\n0.5,3,4,7,8\n")
    np.savez(tmp_path / "m.npz", joint_names=["a", "b"], t=[0, 1], q=np.ones((2, 2)))
    samples = load_motion(csv)
    np.testing.assert_array_equal(samples.u, [[7.0, 8.0]] * 2)
    assert np.isnan(samples.v).all()
    assert np.isnan(load_motion(tmp_path / "m.npz").u).all()


@pytest.mark.parametrize(
    ("path", "value", "key", "words"),
    [
        (("joint_names",), None, "joint_names", "is missing"),
        (("joint_names",), ["a"], "points[0].positions", "expected 1 numbers"),
        (("joint_names",), ["a", "a"], "joint_names", "all of them different"),
        (("points",), [], None, "holds 0 rows"),
        (("points",), 7, "points", "expected a list"),
        (("points", 1, "positions"), [1.0], "points[1].positions", "2 numbers"),
        (("points", 1, "positions"), None, "points[1].positions", "2 numbers"),
        (("points", 1, "positions", 0), "x", "points[1].positions[0]", "finite number"),
        (
            ("points", 1, "positions", 0),
            1e300,
            "points[1].positions[0]",
            "is 1e[+]300, expected a finite number, of at most 1e[+]150 in size",
        ),
        (("points", 1, "velocities"), [], "points[1].velocities", "2 numbers"),
        (("points", 2, "effort"), [1.0, 2.0], "points[0].effort", "2 numbers"),
        (
            ("points", 1, "time_from_start"),
            None,
            "points[1].time_from_start",
            "is missing",
        ),
        (
            ("points", 1, "time_from_start", "sec"),
            0.5,
            "points[1].time_from_start.sec",
            "whole number",
        ),
        (
            ("points", 1, "time_from_start", "sec"),
            10**400,
            "points[1].time_from_start.sec",
            "whole number of 64 bits",
        ),
        (("points", 1, "time_from_start", "sec"), 9, "time", "must increase"),
    ],
)
def test_invalid_message_field_is_named_in_the_error(
    path: tuple[Any, ...], value: object, key: str, words: str, tmp_path: Path
) -> None:
    content: Any = message()
    inner = content
    for step in path[:-1]:
        inner = inner[step]
    inner[path[-1]] = value
    file = write(tmp_path, content)
    with pytest.raises(ScenarioError, match=words) as caught:
        load_motion(file)
    assert caught.value.path == file
    assert caught.value.key == key
    assert str(file) in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "[1, 2", "[" * 100_000, '{"a": NaN}', '{"a": 1, "a": 1}', "7"]
)
@pytest.mark.parametrize("ending", ENDINGS)
def test_file_without_a_message_is_an_error(
    text: str, ending: str, tmp_path: Path
) -> None:
    path = tmp_path / f"m.{ending}"
    path.write_text(text)
    with pytest.raises(ScenarioError) as caught:
        load_motion(path)
    assert str(path) in str(caught.value)
