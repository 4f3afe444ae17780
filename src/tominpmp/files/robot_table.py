"""The robot of a scenario: where it comes from and what differs from its files."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.description.fields import Field
from tominpmp.description.files import find_robot, find_srdf
from tominpmp.description.joint_table import JointTable
from tominpmp.description.linkage import Linkage
from tominpmp.description.paths import checked_path
from tominpmp.description.srdf import SemanticDescription
from tominpmp.description.written import srdf_file, urdf_file
from tominpmp.exceptions import (
    RobotLoadError,
    ScenarioError,
    TominpmpError,
)
from tominpmp.files.limits import load_joint_limits, load_limited_robot
from tominpmp.files.records import blaming, file_name, to_table
from tominpmp.files.scenario_tables import read_motion_limits, read_payload
from tominpmp.files.writing import write_bytes
from tominpmp.robot import DEFAULT_GRAVITY, Robot

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
        self.files[f"{self.stem}.urdf"] = text
        return f"{self.stem}.urdf"

    def srdf(self, robot: Robot, semantics: SemanticDescription) -> str:
        """Add the SRDF file of a robot, and return its name."""
        name = f"{self.stem}.srdf"
        self.files[name] = srdf_file(semantics, robot.name, _loads(robot))
        return name

    def write(self, folder: Path) -> None:
        """Write them into a folder.

        Raises:
            ScenarioError: If one cannot be written.
        """
        for name, content in self.files.items():
            write_bytes(folder / name, content)


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
    models = (one.model, other.model)
    placements = [
        [*(frame.placement for frame in model.frames), *model.jointPlacements]
        for model in models
    ]
    first, second = (
        np.array([item.toDynamicParameters() for item in model.inertias])
        for model in models
    )
    return all(
        a.isApprox(b, ROUNDING) for a, b in zip(*placements, strict=True)
    ) and np.allclose(first, second, rtol=ROUNDING, atol=ROUNDING)


# Overrides per joint, as load_robot has them.
OVERRIDES = (
    "position_lower",
    "position_upper",
    "velocity",
    "effort",
    "damping",
    "armature",
    "friction",
)
KEYS = (
    "name",
    "path",
    "srdf",
    "package_dirs",
    "group",
    "limits",
    "joint_limits",
    "motion_limits",
    "gravity",
    "locked_joints",
    "payloads",
    *OVERRIDES,
)


def read_robot(table: Field) -> Robot:
    """Load the robot of a scenario.

    Args:
        table: Its table: ``name`` or ``path``; ``srdf``, ``package_dirs``, ``group``,
            ``limits``, ``locked_joints``, ``gravity`` and the overrides as for
            :func:`load_robot`;
            ``joint_limits``, a file of MoveIt; ``motion_limits``, which go before it
            (see :func:`read_motion_limits`); ``payloads``, a list of tables with the
            fields of :class:`~tominpmp.robot.payload.Payload`. Paths are relative to
            the scenario.

    Raises:
        ScenarioError: If the table is wrong or the robot cannot be loaded.
    """
    table.only(*KEYS)
    if table.get("name").given == table.get("path").given:
        table.fail("expected either the name or the path of a robot")
    folder = table.path.parent

    def file(key: str) -> Path | None:
        item = table.get(key)
        return folder / _path(item) if item.given else None

    moveit = file("joint_limits")
    values = {key: table.get(key).value for key in ("gravity", *OVERRIDES)}
    try:
        robot = load_limited_robot(
            None if moveit is None else load_joint_limits(moveit),
            file("path") or table.get("name").text(),
            {key: value for key, value in values.items() if value is not None},
            package_dirs=[folder / _path(k) for k in table.get("package_dirs").items()],
            srdf=file("srdf"),
            group=table.get("group").value,
            limits=table.get("limits").value,
            locked_joints=table.get("locked_joints").value or {},
        )
        limits = read_motion_limits(table.get("motion_limits"), robot)
        if limits is not None:
            limits = limits.over(robot.motion_limits, robot.joint_names)
            robot = replace(robot, motion_limits=limits)
    except ScenarioError:
        raise
    except TominpmpError as error:
        option = getattr(error, "option", None)
        where = table.get(option) if option in KEYS else table
        where.fail(str(error))
    for item in table.get("payloads").items():
        payload = read_payload(item)
        with blaming(item):
            robot = robot.with_payload(payload)
    return robot


def _path(item: Field) -> Path:
    """Path in a table, relative to the folder of its file or not."""
    with blaming(item):
        return checked_path(item.text())


def robot_table(
    robot: Robot, folder: Path, beside: Beside | None = None
) -> dict[str, Any]:
    """Write down how to load a robot.

    Args:
        robot: The robot.
        folder: Folder of the scenario; paths inside it are written relative to it.
        beside: Takes the files of a robot that was loaded from none; None refuses it.

    Returns:
        The table for :func:`read_robot`.

    Raises:
        TypeError: If the robot holds what cannot be written.
    """
    if robot.parts:
        raise TypeError(
            f"it was combined from several: {', '.join(robot.parts)}; expected one "
            "that was loaded"
        )
    table = _source(robot, folder, beside)
    default = find_srdf(robot.urdf_path)
    if "name" in table:
        default = find_robot(robot.name).srdf
    if robot.srdf is not None and robot.srdf.path != default:
        table["srdf"] = _srdf(robot, robot.srdf, folder, beside)
    if robot.package_dirs:
        table["package_dirs"] = [file_name(d, folder) for d in robot.package_dirs]
    gravity = robot.description.gravity or DEFAULT_GRAVITY
    if not np.array_equal(robot.gravity, gravity):
        table["gravity"] = robot.gravity.tolist()
    followers = {joint.name for joint in robot.description.joints if joint.mimic}
    locked = {k: v for k, v in robot.locked_joints.items() if k not in followers}
    if locked:
        table["locked_joints"] = locked
    if robot.payloads:
        table["payloads"] = to_table(robot.payloads, folder)
    if robot.motion_limits is not None:
        table["motion_limits"] = to_table(robot.motion_limits, folder)
    return table | _overrides(robot, locked)


def _source(robot: Robot, folder: Path, beside: Beside | None) -> dict[str, Any]:
    """Name or path of the description, which may be one of the files beside."""
    if not robot.urdf_path.is_file():
        if beside is None:
            raise TypeError(
                f"it was loaded from {robot.urdf_path}, expected one that was loaded "
                "from a file: tominpmp.save_scenario() writes one beside the scenario"
            )
        return {"path": beside.urdf(robot)}
    try:
        if find_robot(robot.name).urdf == robot.urdf_path:
            return {"name": robot.name}
    except RobotLoadError:
        pass
    return {"path": file_name(robot.urdf_path, folder)}


def _srdf(
    robot: Robot, semantics: SemanticDescription, folder: Path, beside: Beside | None
) -> str:
    """Path of the semantic description, which may be one of the files beside."""
    path = semantics.path
    if path.is_file():
        return file_name(path, folder)
    if beside is None:
        raise TypeError(
            f"its SRDF file is {path}, expected one that was loaded from a file: "
            "tominpmp.save_scenario() writes one beside the scenario"
        )
    return beside.srdf(robot, semantics)


def check_given_back(
    robot: Robot, table: Mapping[str, Any], path: Path, beside: Beside | None
) -> None:
    """Check that a robot that is written down and loaded again is the same.

    One whose files would lie beside the scenario may differ by rounding, and by where
    it comes from.

    Args:
        robot: The robot.
        table: What was written down of it, by :func:`robot_table`.
        path: File of the scenario.
        beside: What took the files that are to lie beside it.

    Raises:
        ScenarioError: If it cannot be loaded again.
        TypeError: If it would be another, or cannot be written.
    """
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what is to be told was told at first loading
        if beside is None or not beside.files:
            if read_robot(Field(table, path, "robot")) != robot:
                raise TypeError(
                    "it differs from its files by more than the arguments of load_robot"
                )
            return
        # Paths of the table are relative to its folder, which is another one there.
        elsewhere = Path(name)
        table = robot_table(robot, elsewhere, Beside(beside.stem))
        beside.write(elsewhere)
        again = read_robot(Field(table, elsewhere / path.name, "robot"))
        different = unlike(again, robot)
    if different:
        raise TypeError(
            f"it was loaded from {robot.urdf_path}, and a URDF file of it would have "
            f"other {different}; expected one that was loaded from a file"
        )


def _overrides(robot: Robot, locked: Mapping[str, float]) -> dict[str, Any]:
    """Values per joint that are not those of the description."""
    # No URDF file says these, which models of Pinocchio have.
    joints = tuple(replace(one, armature=0.0) for one in robot.description.joints)
    plain = JointTable.from_description(
        robot.joint_names, joints, Linkage.resolve(joints, locked)
    )
    table: dict[str, Any] = {}
    for key in OVERRIDES:
        present, described = robot._table()[key], plain[key]
        changed = {
            name: present[i].tolist()
            for i, name in enumerate(robot.joint_names)
            if not np.array_equal(present[i], described[i])
        }
        if changed:
            table[key] = changed
    return table
