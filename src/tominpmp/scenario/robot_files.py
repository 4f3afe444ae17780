"""Files beside a scenario: of robots that were given as a text or as a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tominpmp.description.srdf import SemanticDescription
from tominpmp.description.written import srdf_file, urdf_file
from tominpmp.io.files import write_file
from tominpmp.robot import Robot

# Placements and inertias of a robot that was written and read again differ by less.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Beside:
    """Files that are to lie beside a scenario.

    Attributes:
        stem: How their names begin.
        files: Their contents by their names.
    """

    stem: str
    files: dict[str, bytes] = field(default_factory=dict)

    def urdf(self, robot: Robot) -> str:
        """Add the URDF file of a robot, and return its name."""
        text, meshes = urdf_file(robot.description, _loads(robot), self.stem)
        self.files.update(meshes)
        return self._add(".urdf", text)

    def srdf(self, robot: Robot, semantics: SemanticDescription) -> str:
        """Add the SRDF file of a robot, and return its name."""
        return self._add(".srdf", srdf_file(semantics, robot.name, _loads(robot)))

    def _add(self, ending: str, content: bytes) -> str:
        name = f"{self.stem}{ending}"
        self.files[name] = content
        return name

    def write(self, folder: Path) -> None:
        """Write them into a folder.

        Raises:
            ScenarioError: If one cannot be written.
        """
        for name, content in self.files.items():
            _write(folder / name, content)


def _write(path: Path, content: bytes) -> None:
    write_file(path, lambda file: file.write(content))


def _loads(robot: Robot) -> list[str]:
    """Payloads are told of by the scenario itself."""
    return [payload.name for payload in robot.payloads]


def unlike(one: Robot, other: Robot) -> str:
    """What two robots differ in by more than rounding and where they come from."""
    mine, theirs = _values(one), _values(other)
    different = next((name for name in mine if mine[name] != theirs[name]), "")
    if different or _same_bodies(one, other):
        return different
    return "placements or inertias"


def _values(robot: Robot) -> Mapping[str, object]:
    """What robots have by joint, and what collides."""
    numbers = ("damping", "armature", "friction", "gravity")
    items = robot.collision_model.geometryObjects
    movers = [str(robot.model.names[item.parentJoint]) for item in items]
    kinds = [type(item.geometry).__name__ for item in items]
    said = robot.srdf
    return {
        "joints, or another order of them": robot.joint_names,
        "locked joints": dict(robot.locked_joints),
        "limits": robot.limits,
        "motion limits": robot.motion_limits,
        "frames": [frame.name for frame in robot.model.frames],
        "shapes": sorted(zip(movers, kinds, strict=True)),
        "pairs of links": () if said is None else sorted(said.disabled_pairs),
        "group states": {} if said is None else dict(said.group_states),
        **{name: getattr(robot, name).tolist() for name in numbers},
    }


def _same_bodies(one: Robot, other: Robot) -> bool:
    """Whether placements and inertias agree, of robots with the same joints."""
    parts = (
        ([item.placement for item in robot.model.frames], robot.model.jointPlacements)
        for robot in (one, other)
    )
    mine, theirs = ([*frames, *joints] for frames, joints in parts)
    first, second = (
        np.array([item.toDynamicParameters() for item in robot.model.inertias])
        for robot in (one, other)
    )
    return all(
        a.isApprox(b, ROUNDING) for a, b in zip(mine, theirs, strict=True)
    ) and np.allclose(first, second, rtol=ROUNDING, atol=ROUNDING)
