"""Limits with a unit, in the notations of ROS and of xacro."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tominpmp as tm

FILE = "joint_limits:\n  joint1:\n    max_velocity: {}\n"


def limits_file(folder: Path, value: str) -> Path:
    path = folder / "joint_limits.yaml"
    path.write_text(FILE.format(value))
    return path


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("!degrees 90", np.pi / 2),
        ("!degrees  90.0", np.pi / 2),
        ('!degrees "90"', np.pi / 2),
        ("!radians 1.5", 1.5),
        ("!radians 2*pi/3", 2 * np.pi / 3),
        ("!radians -(pi - 4)", 4 - np.pi),
        ("!inches 10", 0.254),
        ("!millimeters 250", 0.25),
        ("deg(90)", np.pi / 2),
        ("deg(360/4)", np.pi / 2),
        ("rad(pi/2)", np.pi / 2),
    ],
)
def test_numbers_with_a_unit_are_converted_to_si(
    tmp_path: Path, written: str, value: float
) -> None:
    limits = tm.load_joint_limits(limits_file(tmp_path, written))
    assert limits.velocity["joint1"] == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("written", "message"),
    [
        ("!degrees fast", r"line 3: !degrees 'fast': expected a number, as"),
        ("!degrees", "line 3: !degrees '': expected a number"),
        ("!degrees 9_0", "line 3: !degrees '9_0': expected a number"),
        ("!radians pi.real", "expected a number, as 90 or pi/2"),
        ("!radians 2**9", "expected a number, as 90 or pi/2"),
        ("!radians 1/0", "expected a number, as 90 or pi/2"),
        (f"!radians {'1+' * 150}1", "expected a number, as 90 or pi/2"),
        ("!degrees [90]", "the tag '!degrees' is refused"),
        ("!gradians 100", "plain values only, and !degrees, "),
        ("deg(fast)", r"max_velocity: is 'deg\(fast\)', expected a number"),
        ('"deg(90)"', r"is 'deg\(90\)', expected a number"),
    ],
)
def test_wrong_number_with_a_unit_is_rejected(
    tmp_path: Path, written: str, message: str
) -> None:
    with pytest.raises(tm.ScenarioError, match=message):
        tm.load_joint_limits(limits_file(tmp_path, written))


def test_motion_limits_may_have_units(tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text("acceleration: !degrees 180\n")
    robot = tm.load_robot("planar3r")
    limits = tm.load_motion_limits(path, robot)
    found = limits.by_joint("acceleration", robot.joint_names)
    np.testing.assert_allclose(found, np.pi)
