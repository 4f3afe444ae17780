"""MoveIt's ``joint_limits.yaml``: limits that a URDF does not have, or has too wide."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from tominpmp.arrays import record_line
from tominpmp.description.fields import Field
from tominpmp.description.yaml_reader import read_yaml

# What may lie around the table: nodes of ROS 2, namespaces of parameters.
_WRAPPERS = ("/**", "ros__parameters", "robot_description_planning")
_SCALINGS = ("default_velocity_scaling_factor", "default_acceleration_scaling_factor")
# Quantity: key that says whether there is a limit, keys of the limit.
_KEYS = {
    "velocity": ("has_velocity_limits", "max_velocity"),
    "acceleration": ("has_acceleration_limits", "max_acceleration"),
    "jerk": ("has_jerk_limits", "max_jerk"),
    "effort": ("has_effort_limits", "max_effort"),
    "position_lower": ("has_position_limits", "min_position"),
    "position_upper": ("has_position_limits", "max_position"),
}


@dataclass(frozen=True)
class MoveItLimits:
    """Limits by joint name, as far as the file has them.

    Attributes:
        path: The file.
        velocity: Largest speeds [rad/s or m/s].
        acceleration: Largest accelerations [rad/s^2 or m/s^2].
        jerk: Largest jerks [rad/s^3 or m/s^3].
        effort: Largest torques [N m or N].
        position_lower: Lower position limits [rad or m].
        position_upper: Upper position limits [rad or m].
        velocity_scaling: The factor by which MoveIt scales speeds when a request gives
            none; 0.1 in many files.
        acceleration_scaling: Likewise for accelerations.
    """

    path: Path
    velocity: Mapping[str, float] = field(default_factory=dict)
    acceleration: Mapping[str, float] = field(default_factory=dict)
    jerk: Mapping[str, float] = field(default_factory=dict)
    effort: Mapping[str, float] = field(default_factory=dict)
    position_lower: Mapping[str, float] = field(default_factory=dict)
    position_upper: Mapping[str, float] = field(default_factory=dict)
    velocity_scaling: float = 1.0
    acceleration_scaling: float = 1.0

    def __repr__(self) -> str:
        """What it holds, on one line."""
        return record_line(self)

    def __post_init__(self) -> None:
        """Make the mappings read-only."""
        for name in _KEYS:
            frozen = MappingProxyType(dict(getattr(self, name)))
            object.__setattr__(self, name, frozen)

    def overrides(self, *, scaled: bool = False) -> dict[str, dict[str, float]]:
        """Arguments for :func:`~tominpmp.robot.load_robot` and ``with_changes``.

        Args:
            scaled: Whether the speeds are scaled by ``velocity_scaling``.

        Returns:
            Values by joint name: velocity, effort, position_lower, position_upper, as
            far as there are any.
        """
        factor = self.velocity_scaling if scaled else 1.0
        found = {"velocity": {k: factor * v for k, v in self.velocity.items()}}
        for name in ("effort", "position_lower", "position_upper"):
            found[name] = dict(getattr(self, name))
        return {name: values for name, values in found.items() if values}


def load_joint_limits(path: str | Path) -> MoveItLimits:
    """Read a ``joint_limits.yaml``.

    A limit counts unless the file says that there is none (``has_velocity_limits:
    false``); then that of the URDF remains.

    Args:
        path: The file.

    Returns:
        The limits.

    Raises:
        ScenarioError: If the file cannot be read or is wrong, with the key.
    """
    path = Path(path).expanduser()
    table = Field(read_yaml(path), path)
    for wrapper in _WRAPPERS:
        if "joint_limits" not in table.table() and table.get(wrapper).given:
            table = table.get(wrapper)
    joints = table.need("joint_limits").table()
    found: dict[str, dict[str, float]] = {name: {} for name in _KEYS}
    for joint, limits in joints.items():
        for name, (flag, key) in _KEYS.items():
            said = limits.get(flag)
            if said.given and not said.flag():
                continue
            if said.given:
                limits.need(key)
            value = limits.get(key)
            if value.given:
                found[name][joint] = _limit(value, name)
    scaling = []
    for key in _SCALINGS:
        factor = table.get(key)
        scaling.append(factor.number() if factor.given else 1.0)
        if not 0.0 < scaling[-1] <= 1.0:
            factor.fail(f"is {scaling[-1]:g}, expected a factor from 0 to 1")
    return MoveItLimits(
        path=path,
        **found,
        velocity_scaling=scaling[0],
        acceleration_scaling=scaling[1],
    )


def _limit(value: Field, name: str) -> float:
    number = value.number()
    if not name.startswith("position") and number <= 0.0:
        value.fail(f"is {number:g}, expected a number greater than zero")
    return number
