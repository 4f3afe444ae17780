"""What MoveIt's messages may hold: keys that are read, that change nothing, or neither.

Of a key that says something and is not read a warning tells, by its name; so of a key
that is not known at all.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tominpmp.description.fields import Field
from tominpmp.exceptions import brief, warn_caller

# What is below a key: nothing to look at (read, or without effect on the motion),
# something that is not read where it is given, a table, or a list of tables.
KNOWN = "known"
UNREAD = "unread"
# Beyond as many keys a warning names no more.
MOST = 20

HEADER = KNOWN
SHAPE = KNOWN  # its keys are checked where it is read
JOINT_STATE = {
    "header": HEADER,
    "name": KNOWN,
    "position": KNOWN,
    "velocity": KNOWN,
    "effort": KNOWN,
}
ROBOT_STATE = {
    "joint_state": JOINT_STATE,
    "multi_dof_joint_state": {
        "header": HEADER,
        "joint_names": KNOWN,
        "transforms": KNOWN,
        "twist": UNREAD,
        "wrench": KNOWN,
    },
    "attached_collision_objects": KNOWN,  # refused
    "is_diff": KNOWN,
}
REGION = {
    "primitives": SHAPE,
    "primitive_poses": KNOWN,
    "meshes": SHAPE,
    "mesh_poses": KNOWN,
}
CONSTRAINTS = {
    "name": KNOWN,
    "joint_constraints": [
        {
            "joint_name": KNOWN,
            "position": KNOWN,
            "tolerance_above": KNOWN,
            "tolerance_below": KNOWN,
            "weight": KNOWN,
        }
    ],
    "position_constraints": [
        {
            "header": HEADER,
            "link_name": KNOWN,
            "target_point_offset": KNOWN,
            "constraint_region": REGION,
            "weight": KNOWN,
        }
    ],
    "orientation_constraints": [
        {
            "header": HEADER,
            "orientation": KNOWN,
            "link_name": KNOWN,
            "absolute_x_axis_tolerance": KNOWN,
            "absolute_y_axis_tolerance": KNOWN,
            "absolute_z_axis_tolerance": KNOWN,
            "parameterization": UNREAD,
            "weight": KNOWN,
        }
    ],
    "visibility_constraints": KNOWN,  # refused
}
REQUEST: dict[str, Any] = {
    # Bounds for bases that move; ours stand still.
    "workspace_parameters": KNOWN,
    "start_state": ROBOT_STATE,
    "goal_constraints": [CONSTRAINTS],
    "path_constraints": KNOWN,  # refused
    "trajectory_constraints": KNOWN,  # refused
    "reference_trajectories": UNREAD,
    # How MoveIt is to look for a motion.
    "pipeline_id": KNOWN,
    "planner_id": KNOWN,
    "group_name": KNOWN,
    "num_planning_attempts": KNOWN,
    "allowed_planning_time": KNOWN,
    "max_velocity_scaling_factor": KNOWN,
    "max_acceleration_scaling_factor": KNOWN,
    "cartesian_speed_limited_link": KNOWN,  # of a speed that is refused
    "cartesian_speed_end_effector_link": KNOWN,
    "max_cartesian_speed": KNOWN,  # refused
}
SCENE: dict[str, Any] = {
    "name": KNOWN,
    "robot_state": ROBOT_STATE,
    "robot_model_name": KNOWN,
    "fixed_frame_transforms": KNOWN,
    # Its entries about objects cause a warning; links are watched as the SRDF says.
    "allowed_collision_matrix": KNOWN,
    "link_padding": KNOWN,  # a warning where it is not zero
    "link_scale": KNOWN,
    "object_colors": KNOWN,
    "world": {
        "collision_objects": [
            {
                "header": HEADER,
                "pose": KNOWN,
                "id": KNOWN,
                "type": KNOWN,
                "primitives": SHAPE,
                "primitive_poses": KNOWN,
                "meshes": SHAPE,
                "mesh_poses": KNOWN,
                "planes": KNOWN,  # refused
                "plane_poses": KNOWN,
                "subframe_names": KNOWN,
                "subframe_poses": KNOWN,
                "operation": KNOWN,
            }
        ],
        "octomap": KNOWN,  # refused
    },
    "is_diff": KNOWN,
}


def warn_of_unread(message: Field, known: Mapping[str, Any]) -> None:
    """Warn of what a message says beyond :data:`REQUEST` or :data:`SCENE`."""
    unread = list(dict.fromkeys(_unread(message, known)))
    if unread:
        shown = ", ".join(brief(key).strip("'\"") for key in unread[:MOST])
        warn_caller(f"{message.path}: not read: {shown}")


def _unread(table: Field, known: Mapping[str, Any]) -> list[str]:
    found: list[str] = []
    if table.value is None:
        return found
    for name, item in table.table().items():
        below = known.get(name, UNREAD) if isinstance(name, str) else UNREAD
        if below == UNREAD and _says_something(item.value):
            found.append(item.key)
        elif isinstance(below, Mapping):
            found += _unread(item, below)
        elif isinstance(below, list):
            for entry in item.items():
                found += _unread(entry, below[0])
    return found


def _says_something(value: Any) -> bool:
    """Whether a value is other than what the message has by default."""
    if isinstance(value, Mapping):
        return any(_says_something(item) for item in value.values())
    if isinstance(value, list):
        return any(_says_something(item) for item in value)
    return value not in (None, "", 0, False)
