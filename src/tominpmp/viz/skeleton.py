"""The skeleton of a robot in motion, and the direction of view that shows it best.

Plots project onto a plane. A picture in space looks along the normal of the plane of a
flat arm; at any other arm it looks from the side on which the bounding boxes of the
obstacles hide least.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.checks import instance
from tominpmp.collision.placements import JointPlacements
from tominpmp.exceptions import ProblemError
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
        labels: Names of the two axes.
        planar: Whether the motion is perpendicular to the direction of view.
    """

    right: Array
    up: Array
    labels: tuple[str, str]
    planar: bool

    @property
    def normal(self) -> Array:
        """Unit vector towards the viewer, shape (3,)."""
        return np.cross(self.right, self.up)

    def project(self, points: Array) -> Array:
        """Coordinates to the right and upwards, shape (..., 3) to (..., 2)."""
        return points @ np.stack([self.right, self.up], axis=1)

    def distance(self, points: Array, slope: float, aspect: float) -> float:
        """Least distance from the origin at which a camera sees all points [m].

        Args:
            points: The points, relative to the origin, shape (m, 3) [m].
            slope: Tangent of half the vertical field of view.
            aspect: Width of the picture over its height.
        """
        across = np.abs(self.project(points)) / (slope * np.array([aspect, 1.0]))
        return float((points @ self.normal + across.max(axis=1)).max())


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Positions of the joints of a robot at several instants.

    Attributes:
        placements: Placements joint_to_world, homogeneous, by instant and joint of the
            model (0 is the world), shape (m, joints, 4, 4).
        chains: Positions of the joints from the base to each end of the robot, the end
            frame last, each of shape (m, k, 3) [m].
        arms: Number of the robot of a workcell that each chain belongs to, from 0.
    """

    placements: Array
    chains: tuple[Array, ...]
    arms: tuple[int, ...] = ()

    @property
    def points(self) -> Array:
        """All positions of joints and ends, shape (m, k, 3) [m]."""
        return np.concatenate(self.chains, axis=1)


def check_motions(problem: Problem, trajectories: Collection[Trajectory]) -> None:
    """Check that there are trajectories, and all are of the problem's robot.

    Raises:
        ProblemError: If there is no trajectory, or the joints of a trajectory differ.
    """
    instance(problem, Problem, "problem")
    for trajectory in trajectories:
        instance(trajectory, Trajectory, "trajectory")
        trajectory._check_joints(problem.robot.joint_names)
    if not trajectories:
        raise ProblemError("there is no trajectory to plot", "trajectories")


def end_frame(problem: Problem) -> str:
    """Name of the frame whose path is shown: of the goal, or the last of the robot."""
    name = problem.goal.frame_name
    # A goal of the last segment may be on a load of that segment only.
    if name is not None and (not problem.segments or name in problem.robot.frame_names):
        return name
    return last_frame(problem.robot)


def last_frame(robot: Robot) -> str:
    """Name of the last frame at the end of a robot."""
    model = robot.model
    depth = [len(model.supports[joint]) for joint in range(model.njoints)]
    last = max(range(model.njoints), key=lambda joint: (depth[joint], joint))
    return str(model.frames[_tip(robot, last)].name)


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
    chains, arms = [], []
    for joint in range(1, model.njoints):
        if len(model.children[joint]):
            continue
        origins = placements[:, list(model.supports[joint])][..., :3, 3]
        part = str(model.names[joint]).partition("/")[0]
        if part in robot.parts:
            # The chain begins at the base of the arm, not at the origin of the world.
            origins[:, 0] = _base(robot, part)
        arms.append(robot.parts.index(part) if part in robot.parts else 0)
        at_end = model.frames[index].parentJoint == joint
        last = model.frames[index if at_end else _tip(robot, joint)]
        tip = placements[:, joint, :3] @ np.append(last.placement.translation, 1.0)
        chains.append(np.concatenate([origins, tip[:, None]], axis=1))
    return Skeleton(placements, tuple(chains), tuple(arms))


def _base(robot: Robot, arm: str) -> Array:
    """Base of a robot of a workcell, (3,) [m]; the origin if on another robot."""
    for frame in robot.model.frames:
        if frame.parentJoint == 0 and str(frame.name).startswith(f"{arm}/"):
            return np.array(frame.placement.translation)
    return np.zeros(3)


def best_view(points: Array) -> View:
    """Find the direction of view that shows a motion best.

    A planar motion is viewed along the normal of its plane. Any other is projected onto
    the coordinate plane in which its area is largest, so that the axes keep their
    names.

    Args:
        points: Positions by instant, shape (m, k, 3) [m].
    """
    displacement = (points - points[:1]).reshape(-1, 3)
    flat = points.reshape(-1, 3)
    extent = float(np.ptp(flat, axis=0).max()) or 1.0
    moments, axes = np.linalg.eigh(displacement.T @ displacement / len(displacement))
    spread = np.sqrt(np.maximum(moments, 0.0))  # least first
    if spread[1] > FLAT * extent >= spread[0]:
        return _facing(axes[:, 0])
    width = np.ptp(flat, axis=0)
    pairs = [(0, 2), (1, 2), (0, 1)]
    areas = [width[i] * width[j] for i, j in pairs]
    # Rounding must not choose between planes of equal area.
    best = next(k for k, area in enumerate(areas) if area >= max(areas) * (1.0 - 1e-6))
    i, j = pairs[best]
    return View(np.eye(3)[i], np.eye(3)[j], ("xyz"[i], "xyz"[j]), False)


def _facing(normal: Array) -> View:
    """View onto a plane: z upwards in it, or x to the right if it is horizontal."""
    x, y, z = np.eye(3)
    if abs(normal @ z) > 1.0 - FLAT:
        return View(x, y, ("x", "y"), True)
    up = z - normal * (normal @ z)
    up /= np.linalg.norm(up)
    right = np.cross(up, normal)
    if right @ x < -FLAT or (abs(right @ x) <= FLAT and right @ y < 0.0):
        right = -right
    label = "z" if up @ z > 1.0 - FLAT else "up in the plane"
    across = (
        "x" if right @ x > 1.0 - FLAT else "y" if right @ y > 1.0 - FLAT else "along"
    )
    return View(right, up, (across, label), True)


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
    plane, flat = best_view(points), points.reshape(-1, 3)
    extent = np.ptp(flat, axis=0) + thickness
    if plane.planar and np.abs(plane.normal) @ extent < FLAT_ARM * extent.max():
        return plane
    boxes = [(rows.min(axis=0), rows.max(axis=0)) for rows in obstacles]
    normal = min(SIDES, key=lambda side: _hidden(flat, side, boxes))
    right = np.cross([0.0, 0.0, 1.0], normal)
    right /= np.linalg.norm(right)
    return View(right, np.cross(normal, right), ("", ""), False)


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
