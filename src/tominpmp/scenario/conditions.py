"""What holds on the whole way, in scenario files of problems and of tours alike."""

from __future__ import annotations

from typing import Any

from tominpmp.description.fields import Field
from tominpmp.robot import Robot
from tominpmp.scenario.limits_table import read_motion_limits
from tominpmp.scenario.scene_table import read_constraints, read_scene
from tominpmp.scenario.segments_table import read_pairs


def read_conditions(document: Field, robot: Robot) -> dict[str, Any]:
    """Read what holds on the whole way, as arguments by name.

    Raises:
        ScenarioError: If a table is wrong.
    """
    margin, own = document.get("margin"), document.get("self_collision")
    return {
        "scene": read_scene(document.get("scene")),
        "margin": margin.number() if margin.value is not None else 0.0,
        "motion_limits": read_motion_limits(document.get("motion_limits"), robot),
        "self_collision": None if own.value is None else own.flag(),
        "constraints": read_constraints(document.get("constraints")),
        "may_touch": read_pairs(document.get("may_touch")),
    }
