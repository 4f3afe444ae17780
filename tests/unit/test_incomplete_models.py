"""Robot descriptions whose links have no mass or inertia, or an impossible inertia."""

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
ZERO_MOMENTS = MOMENTS.replace('"1"', '"0"').format(0)
BALL = '<visual><geometry><sphere radius="0.1"/></geometry></visual>'


def loading_warnings(tmp_path: Path, text: str, **options: object) -> list[str]:
    """Messages of the warnings when a description is loaded."""
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
def test_missing_or_impossible_inertia_gives_a_warning(
    tmp_path: Path, text: str, fault: str
) -> None:
    messages = loading_warnings(tmp_path, text, armature=0.1)
    assert len(messages) == 1
    assert fault in messages[0]
    assert "link link2" in messages[0]
    assert "behind joint joint2" in messages[0]
    assert "too fast for the arm" in messages[0]


def test_frames_without_mass_give_no_warning(tmp_path: Path) -> None:
    assert "tip" in ARM  # a link without mass, fixed to the second link
    assert loading_warnings(tmp_path, ARM) == []


def test_locked_links_without_inertia_give_no_warning(tmp_path: Path) -> None:
    text = ARM.replace(INERTIAL, "")
    assert loading_warnings(tmp_path, text, locked_joints={"joint2": 0.0}) == []


def test_massless_links_between_coincident_joints_give_no_warning(
    tmp_path: Path,
) -> None:
    # The first link becomes the middle of a universal joint.
    first = ARM[ARM.index("<inertial>") : ARM.index("</inertial>") + 11]
    text = ARM.replace(first, "").replace('<origin xyz="1.0 0 0"/><axis', "<axis")
    text = text.replace('<axis xyz="0.0 0.0 1.0"/>', '<axis xyz="0 1 0"/>', 1)
    assert loading_warnings(tmp_path, text) == []


@pytest.mark.parametrize("name", ["panda", "ur5", "xarm7", "kinova", "z1", "planar3r"])
def test_complete_robots_give_no_warning(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tm.load_robot(name)


# Inertia that no rigid body can have


def refusal(text: object, **options: object) -> str:
    with pytest.raises(tm.RobotLoadError) as caught:
        tm.load_robot(text, **options)  # type: ignore[arg-type]
    return str(caught.value)


@pytest.mark.parametrize("moments", [-0.5, 3, -1e3])
def test_error_on_impossible_moments_names_link_joint_and_remedy(
    moments: float,
) -> None:
    text = with_moments(1.0, MOMENTS.format(moments))
    message = refusal(text)
    assert "link link2 with what is fixed to it (tip) behind joint joint2" in message
    assert f"{moments:.3g}" in message and "at most the sum of the other two" in message
    assert "armature={'joint2': ...}" in message and "correct the <inertial>" in message
    # A rotor of joint 2 makes the moments usable, a rotor of joint 1 does not.
    assert "principal moments" in refusal(text, armature={"joint1": 5.0})
    with pytest.warns(tm.TominpmpWarning, match="principal moments"):
        robot = tm.load_robot(text, armature={"joint2": 5.0})
    with pytest.raises(tm.RobotLoadError, match="principal moments"):
        robot.with_changes(armature=0.0)


def test_error_distinguishes_wrong_inertia_from_missing_inertia() -> None:
    assert "no <inertial>" in refusal(ARM.replace(INERTIAL, ""))
    message = refusal(with_moments(1.0, ZERO_MOMENTS))
    assert "no <inertial>" not in message and "give is 0 kg m^2" in message
    message = refusal(with_moments(1.0, MOMENTS.format(-0.5)))
    assert "no <inertial>" not in message and "without any inertia" not in message
    # The rotor of its joint is too small for the negative moment.
    text = with_moments(1.0, 'ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="-1"')
    message = refusal(text, armature={"joint2": 0.1})
    assert "no <inertial>" not in message and "give is -0.9 kg m^2" in message


def rounded(tensor: np.ndarray, digits: int = 3) -> np.ndarray:
    return np.vectorize(lambda x: float(f"{x:.{digits - 1}e}"))(tensor)


def inertial(tensor: np.ndarray) -> str:
    names = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    words = (f'i{"xyz"[i]}{"xyz"[k]}="{float(tensor[i, k])!r}"' for i, k in names)
    return " ".join(words)


@pytest.mark.parametrize("thickness", [0.0, 1e-3])
def test_moments_rounded_to_three_digits_are_accepted(
    thickness: float, rng: np.random.Generator
) -> None:
    """Moments of flat and thin bodies break the triangle inequality by rounding."""
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


def test_payload_inertia_is_checked_by_the_rule_for_links() -> None:
    for moments in ([1.0, 1.0, 3.0], [1.0, 1.0, -0.1], [-1.0, -1.0, -1.0]):
        text = with_moments(1.0, inertial(np.diag(moments)))
        with pytest.raises(tm.ProblemError) as caught:
            tm.Payload(1.0, "tip", inertia=np.diag(moments))
        rule = str(caught.value).partition("has the principal moments")[2]
        assert rule and rule in refusal(text)


def test_inertia_is_checked_for_a_link_with_all_that_is_fixed_to_it() -> None:
    """Wrong moments of a sensor fixed to a link, or of a locked link, do no harm."""
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


def test_negative_mass_is_refused() -> None:
    assert "link link2: mass value='-1.0'" in refusal(with_moments(-1.0, ZERO_MOMENTS))
    model = pin.buildModelFromXML(ARM)
    model.inertias[2] = pin.Inertia(-1.0, np.zeros(3), np.eye(3))
    message = refusal(model, effort=10.0, velocity=1.0)
    assert (
        "behind joint joint2 has a mass of -1 kg" in message and "armature=" in message
    )
