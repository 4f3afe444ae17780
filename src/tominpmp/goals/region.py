"""Goal region: a box for the origin of a frame, and a range of orientations."""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Converted, default, frozen_array, is_single, record
from tominpmp.checks import Corner, FrameName, array, vector, wrong
from tominpmp.exceptions import ProblemError
from tominpmp.goals.frames import (
    FrameGoal,
    PoseOrNone,
    VelocityOrNone,
    rotation_vector,
)
from tominpmp.goals.place import Place
from tominpmp.kinematics import RobotKinematics

ANGLES = "an angle >= 0 or three of them [rad]"


def _checked_angles(given: Any, name: str) -> float | Array:
    one = is_single(given)
    row, size = ([given], 1) if one else (given, 3)
    angles = vector(row, name, ANGLES, size, infinite=True)
    if np.any(angles < 0.0):
        raise wrong(given, name, ANGLES)
    angles = np.minimum(angles, np.pi)
    return float(angles[0]) if one else frozen_array(angles)


Angles: TypeAlias = Annotated[Converted[ArrayLike, float | Array], _checked_angles]


@record
class RegionGoal(FrameGoal):
    """Bring the origin of a frame into a box, in any orientation or in some.

    MoveIt's position constraint with a box, and its orientation constraint with
    tolerances about three axes, together.

    Attributes:
        frame: Name of the frame.
        lower: Lower corner of the box, along the axes of the pose, shape (3,) [m];
            minus infinity for none.
        upper: Upper corner, shape (3,) [m]; infinity for none.
        pose: Placement box_to_world; None for the world itself.
        angle_tolerance: Largest component of the rotation vector from the axes of the
            pose to those of the frame, one for all axes or shape (3,) [rad]; pi for
            any.
        v: Final linear velocity of the origin, shape (3,) [m/s]; None for rest.
    """

    frame: FrameName
    lower: Corner
    upper: Corner
    pose: PoseOrNone = default(None)
    angle_tolerance: Angles = default(np.pi)
    v: VelocityOrNone = default(None)

    def __post_init__(self) -> None:
        """Check and copy the values."""
        super().__post_init__()
        for axis, low, high in zip("xyz", self.lower, self.upper, strict=True):
            if low > high or low == np.inf or high == -np.inf:
                raise ProblemError(
                    f"goal.lower is {low:g} and goal.upper {high:g} along {axis}, "
                    "expected the lower corner below the upper one",
                    "goal.lower",
                )
        if not (np.any(np.isfinite([self.lower, self.upper])) or self._turns.size):
            raise ProblemError(
                "goal: the box is infinite and any orientation will do: nothing is "
                "asked for",
                "goal",
            )

    @property
    def _turns(self) -> Array:
        """Tolerances of the axes about which not any angle will do."""
        angles = np.broadcast_to(np.asarray(self.angle_tolerance), 3)
        return angles[angles < np.pi]

    def nearest_point(self) -> Array:
        """Point of the box that is nearest to the origin of the world."""
        pose = pin.SE3.Identity() if self.pose is None else self.pose
        origin = np.asarray(pose.actInv(np.zeros(3)))
        return np.asarray(pose.act(np.clip(origin, self.lower, self.upper)))

    def distances(self, points: Array) -> Array:
        """Distances of points from the box, shape (m, 3) to (m,) [m]."""
        pose = pin.SE3.Identity() if self.pose is None else self.pose
        points = array(points, "points", (None, 3), "coordinates [m]")
        local = (points - pose.translation) @ pose.rotation
        out = local - np.clip(local, self.lower, self.upper)
        return np.asarray(np.linalg.norm(out, axis=1))

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Position in the axes of the box [m], and rotation vector [rad]."""
        pose = pin.SE3.Identity() if self.pose is None else self.pose
        there, jacobian = self._placed(kinematics, q, local=True)
        place = pose.actInv(there)
        position = Place(
            np.asarray(place.translation),
            place.rotation @ jacobian[:3],
            self.lower,
            self.upper,
            (self.label("m"),) * 3,
        ).kept(np.isfinite(self.lower) | np.isfinite(self.upper))
        if not self._turns.size:
            return position
        turn, by_turn = rotation_vector(np.asarray(place.rotation))
        angles = np.broadcast_to(np.asarray(self.angle_tolerance), 3)
        by_q, labels = by_turn @ jacobian[3:], (self.label("rad"),) * 3
        rotation = Place(turn, by_q, -angles, angles, labels)
        return position.joined(rotation.kept(angles < np.pi))
