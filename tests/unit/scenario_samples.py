"""Messages of MoveIt for the paper's arm: a planning scene and a request."""

from __future__ import annotations

import json
from copy import deepcopy
from pathlib import Path
from typing import Any

START = [0.5, 1.7, -1.7]
GOAL = [2.0, -1.0, 0.5]
JOINTS = ["joint1", "joint2", "joint3"]

SCENE: dict[str, Any] = {
    "robot_state": {
        "joint_state": {"name": JOINTS, "position": [0.0, 0.0, 0.0]},
        "multi_dof_joint_state": {
            "joint_names": ["virtual_joint"],
            "transforms": [
                {"translation": [0.0, 0.0, 0.0], "rotation": [0.0, 0.0, 0.0, 1.0]}
            ],
        },
    },
    "fixed_frame_transforms": [
        {
            "child_frame_id": "desk",
            "transform": {"translation": [0.0, 0.0, 2.0], "rotation": [0, 0, 1, 0]},
        }
    ],
    "world": {
        "collision_objects": [
            {
                "id": "box",
                "primitives": [{"type": "box", "dimensions": [0.1, 0.2, 0.3]}],
                "primitive_poses": [
                    {"position": [5, 4, 0], "orientation": [0, 0, 0.6, 0.8]}
                ],
            },
            {
                "id": "pair",
                "header": {"frame_id": "desk"},
                "pose": {
                    "position": {"x": -4.0, "y": 0.0, "z": 1.0},
                    "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0},
                },
                "primitives": [
                    {"type": 2, "dimensions": [0.25]},
                    {"type": "CYLINDER", "dimensions": [0.4, 0.1]},
                ],
                "primitive_poses": [
                    {"position": [0, 0, 0], "orientation": [0, 0, 0, 1]},
                    {"position": [0, 1, 0], "orientation": [0, 0, 0, 1]},
                ],
            },
        ]
    },
}

REQUEST: dict[str, Any] = {
    "group_name": "arm",
    "max_velocity_scaling_factor": 0,
    "start_state": {"joint_state": {"name": JOINTS[::-1], "position": START[::-1]}},
    "goal_constraints": [
        {
            "joint_constraints": [
                {"joint_name": name, "position": value, "tolerance_above": 0.001}
                for name, value in zip(JOINTS, GOAL, strict=True)
            ]
        }
    ],
}

MISSING = object()


def changed(message: dict[str, Any], *steps: Any) -> dict[str, Any]:
    """Copy a message and set (MISSING: delete) the value at the end of the steps."""
    *path, value = steps
    copy = deepcopy(message)
    inner: Any = copy
    for step in path[:-1]:
        inner = inner[step]
    if value is MISSING:
        del inner[path[-1]]
    else:
        inner[path[-1]] = value
    return copy


def write(
    folder: Path, scene: dict[str, Any] | None = None, request: Any = None
) -> tuple[Path, Path]:
    """Write a scene and a request."""
    paths = folder / "scene.yaml", folder / "request.yaml"
    # JSON is YAML.
    paths[0].write_text(json.dumps(SCENE if scene is None else scene))
    paths[1].write_text(json.dumps(REQUEST if request is None else request))
    return paths
