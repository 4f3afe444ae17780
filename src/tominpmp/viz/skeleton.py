"""The skeleton of a robot in motion, and the plane it is best seen in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.checks import instance
from tominpmp.exceptions import ProblemError
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem import Problem
from tominpmp.robot import Robot

# Share of the extent of a motion below which a deviation from a plane is rounding.
FLAT = 1e-6


@dataclass(frozen=True, eq=False)
class View:
    """A direction to look from: right, up and towards the viewer are right-handed.

    Attributes:
        right: Unit vector to the right, shape (3,).
        up: Unit vector upwards, shape (3,).
        labels: Names of the two axes.
        planar: Whether nothing moves towards the viewer.
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


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Where the joints of a robot are at several instants.

    Attributes:
        placements: Placements joint_to_world, homogeneous, by instant and joint of the
            model (0 is the world), shape (m, joints, 4, 4).
        end: Positions of the end frame [m], shape (m, 3).
        end_frame: Its name.
        chains: Positions of the joints from the base to each end of the robot, the end
            frame last, each of shape (m, k, 3) [m].
        arms: Number of the robot of a workcell that each chain belongs to, from 0.
    """

    placements: Array
    end: Array
    end_frame: str
    chains: tuple[Array, ...]
    arms: tuple[int, ...] = ()

    @property
    def points(self) -> Array:
        """All positions of joints and ends, shape (m, k, 3) [m]."""
        return np.concatenate(self.chains, axis=1)


def check_motion(problem: Problem, trajectory: Trajectory) -> None:
    """Check that a trajectory is one of the problem's robot.

    Raises:
        ProblemError: If the joints differ.
    """
    instance(problem, Problem, "problem")
    instance(trajectory, Trajectory, "trajectory")
    if trajectory.joint_names != problem.robot.joint_names:
        raise ProblemError(
            f"the trajectory moves {', '.join(trajectory.joint_names)}, but the robot "
            f"{problem.robot.name!r} has {', '.join(problem.robot.joint_names)}",
            "trajectory",
        )


def check_motions(problem: Problem, trajectories: Mapping[str, Trajectory]) -> None:
    """Check that there are trajectories, and all are of the problem's robot.

    Raises:
        ProblemError: If there is no trajectory, or the joints of one differ.
    """
    if not trajectories:
        raise ProblemError("there is no trajectory to plot", "trajectories")
    for trajectory in trajectories.values():
        check_motion(problem, trajectory)


def end_frame(problem: Problem) -> str:
    """Name of the frame to watch: that of the goal, else the last at the end."""
    name = problem.goal.frame_name
    # A goal of the last segment may be on what is carried there only.
    if name is not None and (not problem.segments or name in problem.robot.frame_names):
        return name
    return end_of(problem.robot)


def end_of(robot: Robot) -> str:
    """Name of the last frame at the end of a robot."""
    model = robot.model
    depth = [len(model.supports[joint]) for joint in range(model.njoints)]
    last = max(range(model.njoints), key=lambda joint: (depth[joint], joint))
    return _last_body(robot, last) or str(model.frames[-1].name)


def _last_body(robot: Robot, joint: int) -> str | None:
    names = [
        str(frame.name)
        for frame in robot.model.frames
        if frame.parentJoint == joint and frame.type == pin.FrameType.BODY
    ]
    return names[-1] if names else None


def skeleton(robot: Robot, q: Array, frame: str) -> Skeleton:
    """Place the joints of a robot.

    Args:
        robot: The robot.
        q: Joint positions, shape (m, n) [rad or m].
        frame: Name of the end frame.

    Raises:
        FrameNotFound: If there is no such frame.
    """
    model, data = robot.model, robot.model.createData()
    index = robot.frame_id(frame)
    joints = list(range(1, model.njoints))
    leaves = [joint for joint in joints if not len(model.children[joint])]
    tips = {joint: _tip(robot, joint) for joint in leaves}
    if model.frames[index].parentJoint in tips:
        tips[model.frames[index].parentJoint] = index
    placements = np.tile(np.eye(4), (len(q), model.njoints, 1, 1))
    tip_points = {joint: np.empty((len(q), 3)) for joint in leaves}
    end = np.empty((len(q), 3))
    for i, row in enumerate(robot.expand(q)):
        pin.forwardKinematics(model, data, row)
        pin.updateFramePlacements(model, data)
        for joint in joints:
            placements[i, joint] = data.oMi[joint].homogeneous
        for joint in leaves:
            tip_points[joint][i] = data.oMf[tips[joint]].translation
        end[i] = data.oMf[index].translation
    chains, arms = [], []
    for joint in leaves:
        support = list(model.supports[joint])
        origins = placements[:, support][..., :3, 3]
        arm = arm_of(robot, joint)
        if arm is not None:
            # From its own base, not from the origin of the room.
            origins[:, 0] = _base(robot, arm)
        arms.append(0 if arm is None else robot.parts.index(arm))
        chains.append(np.concatenate([origins, tip_points[joint][:, None]], axis=1))
    return Skeleton(placements, end, frame, tuple(chains), tuple(arms))


def arm_of(robot: Robot, joint: int) -> str | None:
    """Name of the robot of a workcell that a joint belongs to; None if there is one."""
    name = str(robot.model.names[joint])
    own = [part for part in robot.parts if name.startswith(f"{part}/")]
    return max(own, key=len, default=None)


def _base(robot: Robot, arm: str) -> Array:
    """Where a robot of a workcell stands [m]; on another one: the origin."""
    for frame in robot.model.frames:
        if frame.parentJoint == 0 and str(frame.name).startswith(f"{arm}/"):
            return np.array(frame.placement.translation)
    return np.zeros(3)


def _tip(robot: Robot, joint: int) -> int:
    """Index of the frame at the end of a joint without followers."""
    name = _last_body(robot, joint)
    if name is None:
        return next(
            i for i, f in enumerate(robot.model.frames) if f.parentJoint == joint
        )
    return robot.frame_id(name)


def best_view(points: Array) -> View:
    """Find the direction from which a motion is seen best.

    A planar motion is seen along the normal of its plane. Any other is projected onto
    the coordinate plane in which it takes the largest area, so that the axes keep their
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
    x, y, z = np.eye(3)
    width = np.ptp(flat, axis=0)
    candidates = [
        (width[0] * width[2], View(x, z, ("x", "z"), False)),
        (width[1] * width[2], View(y, z, ("y", "z"), False)),
        (width[0] * width[1], View(x, y, ("x", "y"), False)),
    ]
    # Rounding must not choose between planes that serve alike.
    best = max(area for area, _ in candidates)
    return next(view for area, view in candidates if area >= best * (1.0 - 1e-6))


def _facing(normal: Array) -> View:
    """View onto a plane: z upwards in it, or x to the right if it is level."""
    x, y, z = np.eye(3)
    if abs(normal @ z) > 1.0 - FLAT:
        return View(x, y, ("x", "y"), True)
    up = z - normal * (normal @ z)
    up /= np.linalg.norm(up)
    right = np.cross(up, normal)
    right /= np.linalg.norm(right)
    if right @ x < -FLAT or (abs(right @ x) <= FLAT and right @ y < 0.0):
        right = -right
    label = "z" if up @ z > 1.0 - FLAT else "up in the plane"
    across = (
        "x" if right @ x > 1.0 - FLAT else "y" if right @ y > 1.0 - FLAT else "along"
    )
    return View(right, up, (across, label), True)
