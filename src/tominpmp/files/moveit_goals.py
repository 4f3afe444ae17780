"""Goals of MoveIt motion plan requests.

A tolerance that stands for accuracy gives a goal at the middle of what is tolerated; a
wider one is a freedom, and gives a goal region. No region is larger than what the
request tolerates.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.description.fields import Field
from tominpmp.exceptions import ScenarioError, TominpmpError, brief
from tominpmp.files.moveit_scene import (
    Frames,
    read_mesh_corners,
    read_pose,
    read_primitive,
    read_rotation,
)
from tominpmp.goals import (
    AllGoals,
    AnyGoal,
    AxisGoal,
    Goal,
    JointGoal,
    JointRegionGoal,
    PoseGoal,
    PositionGoal,
    RegionGoal,
)
from tominpmp.robot import Robot

# A joint that does not move may be this far from where the request has it
# [rad or m].
APART = 1e-3
# Tolerances up to this are the accuracy that MoveIt's tools ask for, not a freedom
# [m or rad].
ACCURACY = 0.0101
# Alternatives beyond this are a mistake: each is planned for.
MOST = 64


@dataclass(frozen=True)
class _Turn:
    """An orientation that is asked for.

    Attributes:
        rotation: Rotation of the link in the frame of the base, shape (3, 3).
        tolerance: Tolerances about its axes, 0 to pi [rad], shape (3,).
    """

    rotation: Array
    tolerance: Array

    @property
    def exact(self) -> bool:
        return not np.any(self.tolerance)


@dataclass(frozen=True)
class _Region:
    """Where a point is to be.

    Attributes:
        kind: "point", "sphere" or "box".
        size: Radius, or half edges, shape (3,) [m]; zero for a point.
        pose: Placement in the frame of the base.
    """

    kind: str
    size: Array
    pose: pin.SE3


def read_goal(
    request: Field, robot: Robot, frames: Frames, start: Mapping[str, float]
) -> Goal:
    """Read the goal of a request; several sets of constraints are alternatives.

    Args:
        request: A message ``MotionPlanRequest``.
        robot: The robot.
        frames: Frames in which its poses may be given.
        start: Start, by joint; joints stay there of which a goal of joint positions
            says nothing.

    Raises:
        ScenarioError: If there is no goal or a constraint is wrong, or of a kind that
            is not read: visibility.
    """
    constraints = request.need("goal_constraints")
    goals: list[Goal] = []
    for item in constraints.items():
        if any(value.given for value in item.table().values()):
            goals += _alternatives(item, robot, frames, start)
    if not goals:
        constraints.fail("is empty, expected a goal")
    if len(goals) > MOST:
        constraints.fail(f"holds {len(goals)} alternatives, expected {MOST} at most")
    return goals[0] if len(goals) == 1 else AnyGoal(goals)


def _alternatives(
    item: Field, robot: Robot, frames: Frames, start: Mapping[str, float]
) -> list[Goal]:
    """Goals of which each meets one set of constraints."""
    joints = list(item.get("joint_constraints").items())
    places = list(item.get("position_constraints").items())
    turns = _turns(item, robot, frames)
    if item.get("visibility_constraints").given:
        item.get("visibility_constraints").fail("visibility goals are not read")
    try:
        if joints and not places and not turns:
            return [_joint_goal(joints, robot, start)]
        fixed = [_joint_region(joints, robot)] if joints else []
        choices = [_regions(place, turns, robot, frames) for place in places]
        if np.prod([len(regions) for regions in choices]) > MOST:
            item.fail(f"holds more than {MOST} combinations of regions")
        found = []
        for regions in itertools.product(*choices):
            parts: list[Goal] = [*fixed, *_frame_goals(places, regions, turns)]
            if not parts:
                item.fail("asks for nothing: every orientation will do")
            found.append(parts[0] if len(parts) == 1 else AllGoals(parts))
    except ScenarioError:
        raise
    except TominpmpError as error:
        item.fail(str(error))
    return found


def _joints(
    constraints: Sequence[Field], robot: Robot
) -> dict[str, tuple[float, float]]:
    """Middle and half width of what is tolerated, by joints that move."""
    asked: dict[str, tuple[float, float]] = {}
    seen = set()
    for item in constraints:
        name = item.need("joint_name").text()
        position = item.need("position").number()
        above, below = (
            _tolerance(item.get(f"tolerance_{side}")) for side in ("above", "below")
        )
        if name in seen:
            item.get("joint_name").fail(f"the joint {brief(name)} is there twice")
        seen.add(name)
        if name in robot.joint_names:
            loose = max(above, below) > ACCURACY
            middle, half = 0.5 * (above - below), 0.5 * (above + below)
            asked[name] = (position + middle, half) if loose else (position, 0.0)
            continue
        if name not in robot.locked_joints:
            item.get("joint_name").fail(
                f"there is no joint {brief(name)} that moves; the robot has: "
                f"{', '.join(robot.joint_names)}"
            )
        at = robot.locked_joints[name]
        if not -max(below, APART) <= at - position <= max(above, APART):
            item.get("position").fail(
                f"is {position:g}, but joint {brief(name)} is locked at {at:g}"
            )
    return asked


def _tolerance(item: Field) -> float:
    value = 0.0 if item.value is None else item.number()
    if value < 0.0:
        item.fail(f"is {value:g}, expected a number >= 0")
    return value


def _joint_goal(
    constraints: Sequence[Field], robot: Robot, start: Mapping[str, float]
) -> Goal:
    asked = _joints(constraints, robot)
    rows = [asked.get(name, (start[name], 0.0)) for name in robot.joint_names]
    q, tolerance = np.array(rows).reshape(-1, 2).T
    return JointRegionGoal(q, tolerance) if np.any(tolerance) else JointGoal(q)


def _joint_region(constraints: Sequence[Field], robot: Robot) -> Goal:
    """Goal for some joints beside goals for frames."""
    asked = _joints(constraints, robot)
    if not asked:
        constraints[0].get("joint_name").fail("is of a joint that does not move")
    q, tolerance = np.array(list(asked.values())).T
    return JointRegionGoal(q, tolerance, tuple(asked))


def _turns(item: Field, robot: Robot, frames: Frames) -> dict[str, _Turn]:
    """Orientations that are asked for, by link."""
    found: dict[str, _Turn] = {}
    for turn in item.get("orientation_constraints").items():
        link = _link(turn, robot)
        if link in found:
            turn.get("link_name").fail(f"the link {brief(link)} is there twice")
        rotation = read_rotation(turn.need("orientation"))
        widths = [
            _tolerance(turn.get(f"absolute_{axis}_axis_tolerance")) for axis in "xyz"
        ]
        tolerance = np.minimum(widths, np.pi)
        tolerance[tolerance <= ACCURACY] = 0.0
        base = frames.to_base(turn.get("header")).rotation
        found[link] = _Turn(base @ rotation, tolerance)
    return found


def _regions(
    place: Field, turns: Mapping[str, _Turn], robot: Robot, frames: Frames
) -> list[_Region]:
    """Regions for the origin of a link, any of which will do."""
    turn = turns.get(_link(place, robot))
    region = place.need("constraint_region")
    base = frames.to_base(place.get("header"))
    offset = place.get("target_point_offset")
    shift = offset.vector("xyz") if offset.given else np.zeros(3)
    if np.any(shift):
        if turn is None or not turn.exact:
            offset.fail("an offset without an exact orientation is not read")
        base = pin.SE3(np.eye(3), -turn.rotation @ shift) * base
    shapes = list(region.get("primitives").items())
    poses = list(region.get("primitive_poses").items())
    # A pose without a shape is a point.
    if shapes and len(shapes) != len(poses):
        region.get("primitive_poses").fail(
            f"holds {len(poses)} poses for {len(shapes)} primitives"
        )
    found = [
        _region(shapes[index] if shapes else None, base * read_pose(pose))
        for index, pose in enumerate(poses)
    ]
    found += _mesh_centres(region, base, frames)
    if not found:
        region.fail("holds 0 regions, expected one or more")
    if len(found) > MOST:
        region.fail(f"holds {len(found)} regions, expected {MOST} at most")
    return found


def _mesh_centres(region: Field, base: pin.SE3, frames: Frames) -> list[_Region]:
    """Middles of meshes: within what is tolerated, which is their convex hull."""
    meshes = list(region.get("meshes").items())
    poses = list(region.get("mesh_poses").items())
    if len(meshes) not in (len(poses), 0):
        region.get("mesh_poses").fail(
            f"holds {len(poses)} poses for {len(meshes)} meshes"
        )
    found = []
    for index, pose in enumerate(poses):
        centre = np.zeros(3)
        if meshes:
            centre = read_mesh_corners(meshes[index], frames).mean(axis=0)
        place = base * read_pose(pose) * pin.SE3(np.eye(3), centre)
        found.append(_Region("point", np.zeros(3), place))
    return found


def _region(shape: Field | None, pose: pin.SE3) -> _Region:
    kind, size = ("point", [0.0]) if shape is None else read_primitive(shape)
    half = np.array(size)
    if shape is not None and not np.all(half > 0.0):
        shape.get("dimensions").fail(f"is {size}, expected positive lengths [m]")
    if kind == "box":
        half = 0.5 * half
    elif kind == "cylinder":
        # The largest box in it that is as long.
        kind, radius = "box", size[1] * 0.5**0.5
        half = np.array([radius, radius, 0.5 * size[0]])
    else:
        half = np.full(3, size[0])
    if np.all(half <= ACCURACY):
        return _Region("point", np.zeros(3), pose)
    return _Region(kind, half, pose)


def _frame_goals(
    places: Sequence[Field], regions: Sequence[_Region], turns: Mapping[str, _Turn]
) -> list[Goal]:
    """Goals for the links, one region each."""
    left = dict(turns)
    parts: list[Goal] = []
    for place, region in zip(places, regions, strict=True):
        link = place.need("link_name").text()
        turn = left.get(link)
        pose, half = region.pose, region.size
        if region.kind == "point":
            if turn is not None and turn.exact:
                parts.append(PoseGoal(link, pin.SE3(turn.rotation, pose.translation)))
                del left[link]
            else:
                parts.append(PositionGoal(link, pose.translation))
        elif region.kind == "sphere":
            parts.append(PositionGoal(link, pose.translation, tolerance=half[0]))
        else:
            parts.append(RegionGoal(link, -half, half, pose))
    for link, turn in left.items():
        if np.any(turn.tolerance < np.pi):
            parts.append(_turn_goal(link, turn))
    return parts


def _turn_goal(link: str, turn: _Turn) -> Goal:
    free = np.flatnonzero(turn.tolerance >= np.pi)
    if free.size == 1:
        # The direction of the free axis is within the other two tolerances if it is
        # within the smaller one, however the angles are counted.
        axis = np.eye(3)[free[0]]
        return AxisGoal(
            link,
            axis,
            turn.rotation @ axis,
            angle_tolerance=float(np.delete(turn.tolerance, free).min()),
        )
    most = np.full(3, np.inf)
    pose = pin.SE3(turn.rotation, np.zeros(3))
    return RegionGoal(link, -most, most, pose, turn.tolerance)


def _link(item: Field, robot: Robot) -> str:
    link = item.need("link_name")
    try:
        robot.frame_id(link.text())
    except ScenarioError:
        raise
    except TominpmpError as error:
        link.fail(str(error))
    return link.text()
