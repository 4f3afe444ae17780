"""Descriptions that leave out mass or inertia behind a moving joint are told of."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from sample_arms import describe, rod

import tominpmp as tm

ARM = describe([rod(2.0, 1.0), rod(1.0, 0.8)])
INERTIAL = ARM[ARM.rindex("<inertial>") : ARM.rindex("</inertial>") + 11]
MOMENTS = 'ixx="{}" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"'
NONE = MOMENTS.replace('"1"', '"0"').format(0)
BALL = '<visual><geometry><sphere radius="0.1"/></geometry></visual>'


def told(tmp_path: Path, text: str, **options: object) -> list[str]:
    """What is warned of when a description is loaded."""
    path = tmp_path / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        tm.load_robot(path, **options)  # type: ignore[arg-type]
    assert all(item.category is tm.TominpmpWarning for item in found)
    assert all(item.filename == __file__ for item in found)
    return [str(item.message) for item in found]


def with_moments(mass: float, moments: str) -> str:
    """The arm with another inertia of its second link."""
    return ARM.replace(
        INERTIAL,
        f'<inertial><mass value="{mass}"/><inertia {moments}/></inertial>',
    )


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (
            ARM.replace(
                INERTIAL, "<visual><geometry><sphere radius='0.1'/></geometry></visual>"
            ),
            "has no mass",
        ),
        (with_moments(0.0, MOMENTS.format(0)), "has no mass"),
        (
            with_moments(1.0, MOMENTS.format(0).replace('"1"', '"0"')),
            "as if it were a point",
        ),
        (with_moments(1.0, MOMENTS.format(-0.5)), "negative moment of inertia"),
        (with_moments(1.0, MOMENTS.format(3)), "that no body has"),
    ],
)
def test_inertia_that_is_left_out_is_told_of(
    tmp_path: Path, text: str, fault: str
) -> None:
    messages = told(tmp_path, text, armature=0.1)
    assert len(messages) == 1
    assert fault in messages[0]
    assert "link link2" in messages[0]
    assert "behind joint joint2" in messages[0]
    assert "too fast for the arm" in messages[0]


def test_frames_without_mass_are_not(tmp_path: Path) -> None:
    assert "tip" in ARM  # a link without mass, fixed to the second one
    assert told(tmp_path, ARM) == []


def test_links_that_are_locked_are_not(tmp_path: Path) -> None:
    text = ARM.replace(INERTIAL, "")
    assert told(tmp_path, text, locked_joints={"joint2": 0.0}) == []


def test_links_between_joints_in_one_place_are_not(tmp_path: Path) -> None:
    # The first link becomes the middle of a universal joint.
    first = ARM[ARM.index("<inertial>") : ARM.index("</inertial>") + 11]
    text = ARM.replace(first, "").replace('<origin xyz="1.0 0 0"/><axis', "<axis")
    text = text.replace('<axis xyz="0.0 0.0 1.0"/>', '<axis xyz="0 1 0"/>', 1)
    assert told(tmp_path, text) == []


@pytest.mark.parametrize("name", ["panda", "ur5", "xarm7", "kinova", "z1", "planar3r"])
def test_arms_are_not(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tm.load_robot(name)
