"""Small arms with known equations of motion, written as robot descriptions.

All arms move in the x-y plane: sliders along a given axis, turning joints about z.
Gravity is off unless it is given; "vertical" arms have it along -y.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from numpy.typing import ArrayLike

from tominpmp.description.joint_table import JointValues
from tominpmp.robot.robot import Robot, load_robot

GRAVITY = 9.81
DOWNWARD = (0.0, -GRAVITY, 0.0)
WEIGHTLESS = (0.0, 0.0, 0.0)
# Limits that never bind: of positions, for sliders [m] and turning joints [rad], and of
# velocities [m/s, rad/s].
FAR = {"prismatic": 4.0, "revolute": 10.0}
FAST = 1e3


@dataclass(frozen=True)
class Link:
    """A link and the joint that carries it.

    Attributes:
        mass: Mass [kg].
        length: Distance to the next joint, along x [m].
        centre: Distance of the centre of mass from the joint, along x [m].
        inertia: Moment of inertia about z through the centre of mass [kg m^2].
        kind: "revolute" about z, or "prismatic" along the axis.
        axis: Axis of a prismatic joint.
    """

    mass: float
    length: float = 0.0
    centre: float = 0.0
    inertia: float = 0.01
    kind: str = "revolute"
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def with_payload(self, mass: float) -> Link:
        """The link with a point mass at its far end."""
        total = self.mass + mass
        centre = (self.mass * self.centre + mass * self.length) / total
        inertia = (
            self.inertia
            + self.mass * (self.centre - centre) ** 2
            + mass * (self.length - centre) ** 2
        )
        return replace(self, mass=total, centre=centre, inertia=inertia)


def rod(mass: float, length: float) -> Link:
    """A slender uniform rod that turns about one end."""
    return Link(mass, length, 0.5 * length, mass * length**2 / 12.0)


def slide(mass: float, axis: tuple[float, float, float] = (1.0, 0.0, 0.0)) -> Link:
    """A mass on a rail."""
    return Link(mass, kind="prismatic", axis=axis)


def describe(links: Sequence[Link]) -> str:
    """Robot description of links one after another, with joints joint1, joint2, ...

    The frame "tip" is at the far end of the last link.
    """
    parts = ['<link name="base"/>']
    parent, origin = "base", 0.0
    for number, link in enumerate(links, 1):
        axis = " ".join(str(part) for part in link.axis)
        # Only the inertia about z matters; the others make the tensor a possible one.
        parts.append(
            f'<link name="link{number}"><inertial><origin xyz="{link.centre} 0 0"/>'
            f'<mass value="{link.mass}"/><inertia ixx="{0.6 * link.inertia}" ixy="0" '
            f'ixz="0" iyy="{0.6 * link.inertia}" iyz="0" izz="{link.inertia}"/>'
            f'</inertial></link><joint name="joint{number}" type="{link.kind}">'
            f'<parent link="{parent}"/><child link="link{number}"/>'
            f'<origin xyz="{origin} 0 0"/><axis xyz="{axis}"/>'
            f'<limit lower="{-FAR[link.kind]}" upper="{FAR[link.kind]}" effort="1" '
            f'velocity="{FAST}"/></joint>'
        )
        parent, origin = f"link{number}", link.length
    parts.append(
        '<link name="tip"/><joint name="tip_joint" type="fixed">'
        f'<parent link="{parent}"/><child link="tip"/><origin xyz="{origin} 0 0"/>'
        "</joint>"
    )
    return f'<robot name="sample">{"".join(parts)}</robot>'


def make_arm(
    *links: Link,
    effort: JointValues,
    gravity: ArrayLike = WEIGHTLESS,
    **limits: JointValues | None,
) -> Robot:
    """Load an arm of links one after another.

    Args:
        *links: The links, from the base on.
        effort: Effort limits, as for :func:`~tominpmp.load_robot`.
        gravity: Gravity [m/s^2].
        **limits: Other values per joint that :func:`~tominpmp.load_robot` takes.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / "sample.urdf"
        path.write_text(describe(links), encoding="utf-8")
        return load_robot(path, effort=effort, gravity=gravity, **limits)


def swinging_arm(*effort: float) -> Robot:
    """Two turning joints of 1 and 0.7 m, pulled down by 2 m/s^2, with a frame "tip".

    Args:
        *effort: Torque limits [N m].
    """
    return make_arm(
        rod(1.0, 1.0),
        rod(1.0, 0.7),
        effort=effort,
        gravity=(0.0, -2.0, 0.0),
    )


def two_link_arm(length: float = 1.0) -> Robot:
    """Two turning joints with a frame at the end, and torque limits that never bind.

    Args:
        length: Length of both links [m].
    """
    return make_arm(
        rod(1.0, length),
        rod(1.0, length),
        Link(0.1, kind="prismatic"),
        effort=1e4,
        velocity=2.0,
    ).with_locked({"joint3": 0.0})
