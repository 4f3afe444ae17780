"""The skeleton of a robot in motion, and the direction of view that shows it best.

A picture looks along the normal of the plane of a flat arm; at any other arm it looks
from the side on which the bounding boxes of the obstacles hide least.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.checks import instance
from tominpmp.collision.placements import JointPlacements
from tominpmp.kinematics import last_joint
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot
from tominpmp.viz.surfaces import transform

# Deviation from a plane that counts as rounding, as a share of the extent of a motion.
FLAT = 1e-6

# Largest depth of a flat arm, as a share of its extent; directions to the viewer for
# other arms, the preferred one first: from the right, in front and above.
FLAT_ARM = 0.2
SIDES = [
    side / np.linalg.norm(side)
    for side in np.array([*product((0.62, -0.62), (-1.0, 1.0), (0.5, 1.2))])
]
# Margin of the picture around the robot, as a share of its extent; obstacles farther
# off, such as the rest of a table, may be cut.
BEYOND = 0.12


@dataclass(frozen=True, eq=False)
class View:
    """A direction of view: right, up and towards the viewer are right-handed.

    Attributes:
        right: Unit vector to the right, shape (3,).
        up: Unit vector upwards, shape (3,).
        planar: Whether the motion is perpendicular to the direction of view.
    """

    right: Array
    up: Array
    planar: bool

    @property
    def normal(self) -> Array:
        """Unit vector towards the viewer, shape (3,)."""
        return np.cross(self.right, self.up)

    def distance(self, points: Array, slope: float, aspect: float) -> float:
        """Least distance from the origin at which a camera sees all points [m].

        Args:
            points: The points, relative to the origin, shape (m, 3) [m].
            slope: Tangent of half the vertical field of view.
            aspect: Width of the picture over its height.
        """
        across = np.abs(points @ np.stack([self.right, self.up], axis=1))
        across /= slope * np.array([aspect, 1.0])
        return float((points @ self.normal + across.max(axis=1)).max())


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Positions of the joints of a robot at several instants.

    Attributes:
        placements: Placements joint_to_world, homogeneous, by instant and joint of the
            model (0 is the world), shape (m, joints, 4, 4).
        points: Positions of the base, except of a workcell, of all joints, and of the
            ends of the robot, shape (m, k, 3) [m].
    """

    placements: Array
    points: Array


def check_motions(problem: Problem, trajectories: Iterable[Trajectory]) -> None:
    """Check that all trajectories are of the problem's robot.

    Raises:
        ProblemError: If the joints of a trajectory differ.
    """
    instance(problem, Problem, "problem")
    for trajectory in trajectories:
        instance(trajectory, Trajectory, "trajectory")
        trajectory._check_joints(problem.robot.joint_names)


def end_frame(problem: Problem) -> str:
    """Name of the frame whose path is shown: of the goal, or the last of the robot."""
    name = problem.goal.frame_name
    # A goal of the last segment may be on a load of that segment only.
    if name is not None and (not problem.segments or name in problem.robot.frame_names):
        return name
    return last_frame(problem.robot)


def last_frame(robot: Robot) -> str:
    """Name of the last frame at the end of a robot."""
    return str(robot.model.frames[_tip(robot, last_joint(robot))].name)


def _tip(robot: Robot, joint: int) -> int:
    """Index of the last body that a joint carries."""
    frames = robot.model.frames
    own = [i for i, frame in enumerate(frames) if frame.parentJoint == joint]
    return max(i for i in own if frames[i].type == pin.FrameType.BODY)


def skeleton(robot: Robot, q: Array, frame: str) -> Skeleton:
    """Place the joints of a robot.

    Args:
        robot: The robot.
        q: Joint positions, shape (m, n) [rad or m].
        frame: Name of the end frame.

    Raises:
        FrameNotFound: If the frame is unknown.
    """
    model, index = robot.model, robot.frame_id(frame)
    rotation, origin = JointPlacements(model).joints(robot.expand(q))
    placements = transform(origin, rotation)
    # The world's origin is the base of a robot alone, but not of those of a workcell.
    points = [origin[:, 1:] if robot.parts else origin]
    for joint in range(1, model.njoints):
        if len(model.children[joint]):
            continue
        at_end = model.frames[index].parentJoint == joint
        last = model.frames[index if at_end else _tip(robot, joint)]
        tip = placements[:, joint, :3] @ np.append(last.placement.translation, 1.0)
        points.append(tip[:, None])
    return Skeleton(placements, np.concatenate(points, axis=1))


def _plane_normal(points: Array) -> Array | None:
    """Unit normal of the plane of a planar motion, shape (3,); None for others.

    Args:
        points: Positions by instant, shape (m, k, 3) [m].
    """
    displacement = (points - points[:1]).reshape(-1, 3)
    extent = float(np.ptp(points.reshape(-1, 3), axis=0).max()) or 1.0
    moments, axes = np.linalg.eigh(displacement.T @ displacement / len(displacement))
    spread = np.sqrt(np.maximum(moments, 0.0))  # least first
    return axes[:, 0] if spread[1] > FLAT * extent >= spread[0] else None


def _facing(normal: Array) -> View:
    """View onto a plane: z upwards in it, or x to the right if it is horizontal."""
    x, y, z = np.eye(3)
    if abs(normal @ z) > 1.0 - FLAT:
        return View(x, y, True)
    up = z - normal * (normal @ z)
    up /= np.linalg.norm(up)
    right = np.cross(up, normal)
    if right @ x < -FLAT or (abs(right @ x) <= FLAT and right @ y < 0.0):
        right = -right
    return View(right, up, True)


def camera_view(
    points: Array, thickness: float = 0.0, obstacles: Sequence[Array] = ()
) -> View:
    """The direction of view that shows a robot in motion in space.

    A flat arm is viewed along the normal of its plane, any other from the side on which
    obstacles hide least of it.

    Args:
        points: Positions of its joints and ends by instant, shape (m, k, 3) [m].
        thickness: Thickness of its bodies [m].
        obstacles: Points of each obstacle, shape (j, 3) [m].
    """
    normal, flat = _plane_normal(points), points.reshape(-1, 3)
    extent = float(np.ptp(flat, axis=0).max()) + thickness
    if normal is not None and np.ptp(flat @ normal) + thickness < FLAT_ARM * extent:
        return _facing(normal)
    boxes = [(rows.min(axis=0), rows.max(axis=0)) for rows in obstacles]
    normal = min(SIDES, key=lambda side: _hidden(flat, side, boxes))
    right = np.cross([0.0, 0.0, 1.0], normal)
    right /= np.linalg.norm(right)
    return View(right, np.cross(normal, right), False)


def _hidden(points: Array, side: Array, boxes: Sequence[tuple[Array, Array]]) -> float:
    """Share of points that axis-aligned boxes hide from a direction of view."""
    hidden = np.zeros(len(points), dtype=bool)
    for corners in boxes:
        first, second = ((corner - points) / side for corner in corners)
        enter = np.max(np.minimum(first, second), axis=1)
        leave = np.min(np.maximum(first, second), axis=1)
        # A point inside a box counts as visible: the obstacle may be hollow.
        hidden |= (enter < leave) & (enter > 0.0)
    return float(np.mean(hidden))


def points_in_view(robot: Array, obstacles: list[Array]) -> Array:
    """Points that a picture has to contain: the robot, and parts of obstacles near it.

    A table or a floor that extends beyond the robot on every side is left out: it is
    visible anyway, and would make the robot small.

    Args:
        robot: Points that enclose the robot along its whole motion, shape (m, 3) [m].
        obstacles: Points of each obstacle, shape (k, 3) [m].
    """
    low, high = robot.min(axis=0), robot.max(axis=0)
    spare = BEYOND * float(np.linalg.norm(high - low))
    clipped = []
    for points in obstacles:
        first, last = points.min(axis=0), points.max(axis=0)
        # Clipping an obstacle that is wholly outside would flatten it onto a side.
        outside = np.any(first > high + spare) or np.any(last < low - spare)
        around = np.all((first <= low - spare)[:2] & (last >= high + spare)[:2])
        if not (outside or around):
            clipped.append(np.clip(points, low - spare, high + spare))
    return np.concatenate([robot, *clipped])
