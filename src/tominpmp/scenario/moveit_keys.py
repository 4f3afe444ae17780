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


def _table(known: str = "", *, unread: str = "", **below: Any) -> dict[str, Any]:
    """The keys of a message.

    Args:
        known: Keys below which there is nothing to look at.
        unread: Keys that are not read where they are given.
        **below: What else is there: a table, or a list of tables.
    """
    return {
        **dict.fromkeys(known.split(), KNOWN),
        **dict.fromkeys(unread.split(), UNREAD),
        **below,
    }


# Keys of shapes are checked where they are read.
SHAPES = "primitives primitive_poses meshes mesh_poses"
ROBOT_STATE = _table(
    "attached_collision_objects is_diff",  # the first is refused
    joint_state=_table("header name position velocity effort"),
    multi_dof_joint_state=_table(
        "header joint_names transforms wrench", unread="twist"
    ),
)
CONSTRAINTS = _table(
    "name visibility_constraints",  # the second is refused
    joint_constraints=[
        _table("joint_name position tolerance_above tolerance_below weight")
    ],
    position_constraints=[
        _table(
            "header link_name target_point_offset weight",
            constraint_region=_table(SHAPES),
        )
    ],
    orientation_constraints=[
        _table(
            "header orientation link_name absolute_x_axis_tolerance "
            "absolute_y_axis_tolerance absolute_z_axis_tolerance weight",
            unread="parameterization",
        )
    ],
)
REQUEST = _table(
    # Bounds for bases that move; ours stand still.
    "workspace_parameters "
    # How MoveIt is to look for a motion.
    "pipeline_id planner_id group_name num_planning_attempts allowed_planning_time "
    "max_velocity_scaling_factor max_acceleration_scaling_factor "
    # Links of a speed that is refused, as are constraints on the way.
    "cartesian_speed_limited_link cartesian_speed_end_effector_link "
    "max_cartesian_speed path_constraints trajectory_constraints",
    unread="reference_trajectories",
    start_state=ROBOT_STATE,
    goal_constraints=[CONSTRAINTS],
)
SCENE = _table(
    # Entries of the matrix about objects cause a warning, and so does padding other
    # than zero; links are watched as the SRDF says.
    "name robot_model_name fixed_frame_transforms allowed_collision_matrix "
    "link_padding link_scale object_colors is_diff",
    robot_state=ROBOT_STATE,
    world=_table(
        "octomap",  # refused, as are planes
        collision_objects=[
            _table(
                f"header pose id type {SHAPES} planes plane_poses subframe_names "
                "subframe_poses operation"
            )
        ],
    ),
)


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
