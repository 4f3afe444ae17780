"""Descriptions without mass or inertia behind a joint, or with that of no body."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
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
        (with_moments(1.0, MOMENTS.format(-0.5)), "principal moments -0.5, 1 and 1"),
        (with_moments(1.0, MOMENTS.format(3)), "principal moments 1, 1 and 3"),
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


# Bodies that cannot be


def refusal(text: object, **options: object) -> str:
    with pytest.raises(tm.RobotLoadError) as caught:
        tm.load_robot(text, **options)  # type: ignore[arg-type]
    return str(caught.value)


@pytest.mark.parametrize("moments", [-0.5, 3, -1e3])
def test_moments_of_no_body_are_refused_with_a_way_out(moments: float) -> None:
    text = with_moments(1.0, MOMENTS.format(moments))
    told = refusal(text)
    assert "link link2 with what is fixed to it (tip) behind joint joint2" in told
    assert f"{moments:.3g}" in told and "above the sum of the other two" in told
    assert "armature={'joint2': ...}" in told and "correct the <inertial>" in told
    # The other joint's rotor is no excuse, its own is.
    assert "principal moments" in refusal(text, armature={"joint1": 5.0})
    with pytest.warns(tm.TominpmpWarning, match="principal moments"):
        robot = tm.load_robot(text, armature={"joint2": 5.0})
    with pytest.raises(tm.RobotLoadError, match="principal moments"):
        robot.with_changes(armature=0.0)


def test_a_link_with_inertia_is_not_said_to_have_none() -> None:
    assert "no <inertial>" in refusal(ARM.replace(INERTIAL, ""))
    told = refusal(with_moments(1.0, NONE))
    assert "no <inertial>" not in told and "give is 0 kg m^2" in told
    told = refusal(with_moments(1.0, MOMENTS.format(-0.5)))
    assert "no <inertial>" not in told and "without any inertia" not in told
    # Its rotor is too small for the moments below zero.
    text = with_moments(1.0, 'ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="-1"')
    told = refusal(text, armature={"joint2": 0.1})
    assert "no <inertial>" not in told and "give is -0.9 kg m^2" in told


def rounded(tensor: np.ndarray, digits: int = 3) -> np.ndarray:
    return np.vectorize(lambda x: float(f"{x:.{digits - 1}e}"))(tensor)


def inertial(tensor: np.ndarray) -> str:
    names = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    words = (f'i{"xyz"[i]}{"xyz"[k]}="{float(tensor[i, k])!r}"' for i, k in names)
    return " ".join(words)


@pytest.mark.parametrize("thickness", [0.0, 1e-3])
def test_moments_in_three_digits_are_taken(
    thickness: float, rng: np.random.Generator
) -> None:
    """Those of flat and thin bodies break the rule by what is rounded."""
    broken = 0
    for _ in range(40):
        turn = pin.exp3(rng.normal(size=3))
        second = 10.0 ** rng.uniform(-4, 0) * np.array([1.0, rng.uniform() ** 3, 0.0])
        moments = np.diag(second.sum() - second * (1.0 + thickness))
        tensor = rounded(turn @ moments @ turn.T)
        small, middle, large = np.linalg.eigvalsh(tensor)
        broken += bool(small + middle < large)
        robot = tm.load_robot(with_moments(1.0, inertial(tensor)), armature=1e-3)
        assert robot.n == 2
        payload = tm.Payload(1.0, "tip", inertia=tensor)
        assert np.array_equal(payload.inertia, tensor)
    assert broken > 5


def test_payloads_are_judged_as_links_are() -> None:
    for moments in ([1.0, 1.0, 3.0], [1.0, 1.0, -0.1], [-1.0, -1.0, -1.0]):
        text = with_moments(1.0, inertial(np.diag(moments)))
        with pytest.raises(tm.ProblemError) as caught:
            tm.Payload(1.0, "tip", inertia=np.diag(moments))
        rule = str(caught.value).partition("has the principal moments")[2]
        assert rule and rule in refusal(text)


def test_what_is_fixed_to_a_link_is_part_of_its_body() -> None:
    """A sensor of wrong moments does no harm on a link; nor does what never moves."""
    sensor = '<inertial><mass value="0.1"/><inertia ' + inertial(-1e-6 * np.eye(3))
    text = ARM.replace(
        '<link name="tip"/>', f'<link name="tip">{sensor}/></inertial></link>'
    )
    assert text != ARM
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tm.load_robot(text)
        wrong = with_moments(1.0, inertial(np.diag([1e-3, 1e-3, -1e-3])))
        assert tm.load_robot(wrong, locked_joints={"joint2": 0.3}).n == 1
    assert "link link2" in refusal(wrong)


def test_a_mass_below_zero_is_refused() -> None:
    assert "link link2: mass value=-1" in refusal(with_moments(-1.0, NONE))
    model = pin.buildModelFromXML(ARM)
    model.inertias[2] = pin.Inertia(-1.0, np.zeros(3), np.eye(3))
    told = refusal(model, effort=10.0, velocity=1.0)
    assert "behind joint joint2 has a mass of -1 kg" in told and "armature=" in told
