"""Common mistakes in URDF files: missing visual meshes and limits in degrees."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import pytest

from tominpmp.exceptions import RobotLoadError, TominpmpWarning
from tominpmp.robot.robot import load_robot

ARM = Path(__file__).parents[2] / "docs" / "static" / "arm.urdf"
MESH = '<geometry><mesh filename="package://my_arm/a.stl"/></geometry>'


def warning_of(text: str, folder: Path) -> str:
    """The message of the only warning from loading the file; the robot is complete."""
    path = folder / "own.urdf"
    path.write_text(text)
    with pytest.warns(TominpmpWarning) as caught:
        robot = load_robot(path)
        assert robot.visual_model.ngeoms == load_robot(ARM).visual_model.ngeoms
    assert robot.n == 4
    (warning,) = caught
    return str(warning.message)


def test_missing_visual_meshes_warn_and_missing_collision_meshes_fail(
    tmp_path: Path,
) -> None:
    text = ARM.read_text().replace("</link>", f"<visual>{MESH}</visual></link>")
    message = warning_of(text, tmp_path)
    assert "not shown" in message
    assert "link base_link, visual" in message
    assert message.count("('package://my_arm/a.stl')") == min(text.count(MESH), 5)
    assert "package_dirs" in message
    # Long names leave room for the advice at the end.
    many = text.replace("</link>", f"{f'<visual>{MESH}</visual>' * 20}</link>")
    message = warning_of(many.replace("base_link", "base_link" * 20), tmp_path)
    assert re.search(r"; and \d+ more; folders .* package_dirs$", message)
    # A collision mesh must exist.
    path = tmp_path / "own.urdf"
    path.write_text(
        text.replace("<visual>", "<collision>").replace("</visual>", "</collision>")
    )
    with pytest.raises(RobotLoadError, match="package_dirs"):
        load_robot(path)


def test_limits_that_look_like_degrees_are_warned_about(tmp_path: Path) -> None:
    old = 'lower="-2.9" upper="2.9"'
    text = ARM.read_text()
    assert old in text
    message = warning_of(text.replace(old, 'lower="-170" upper="170"'), tmp_path)
    assert re.search("look like degrees: turn; a URDF file has radians", message)
    # Values that are no angles of a data sheet stand for an absent limit.
    path = tmp_path / "free.urdf"
    for limit in ("12.57", "1e6"):
        path.write_text(text.replace(old, f'lower="-{limit}" upper="{limit}"'))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert load_robot(path).n == 4
