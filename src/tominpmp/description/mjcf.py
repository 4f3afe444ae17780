"""MJCF, the format of MuJoCo: compiled by MuJoCo, then described as a URDF file is.

MuJoCo resolves includes, classes, generated bodies and rotations in all notations, and
computes the masses that shapes give; its model holds the bodies and joints.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, frozen_array
from tominpmp.description.files import missing_resource, resolve_resource
from tominpmp.description.from_pinocchio import ellipsoid
from tominpmp.description.model import one_line
from tominpmp.description.srdf import SemanticDescription, ordered_pair
from tominpmp.description.tree import (
    UNREAD,
    UNSEEN,
    JointDescription,
    LinkDescription,
    Shape,
    UrdfDescription,
    fixed_joint,
    fresh_name,
    solid,
    warn_of,
)
from tominpmp.description.xml_reader import XmlContext
from tominpmp.exceptions import brief, optional, shortened

# Ratios of the sizes of shapes to MuJoCo's sizes, which are radii and halves.
HALVES = {"box": (2, 2, 2), "sphere": (1,), "capsule": (1, 2), "cylinder": (1, 2)}
# Groups of shapes that MuJoCo shows unless asked otherwise; the others only collide.
SHOWN_GROUPS = 3
# Colour that stands for "not given" in MuJoCo.
UNCOLOURED = (0.5, 0.5, 0.5, 1.0)

Range = tuple[float, float]

logger = logging.getLogger(__name__)


def imported_mujoco(purpose: str) -> Any:
    """Import MuJoCo; its warnings are logged, instead of in the working folder.

    Args:
        purpose: What it is needed for, in the message if it is missing.

    Raises:
        MissingDependency: If it is not installed.
    """
    with optional("mujoco", "mujoco", purpose):
        import mujoco
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(logger.warning)
    return mujoco


def describe_mjcf(
    path: Path, text: bytes | None, package_dirs: Sequence[Path]
) -> tuple[UrdfDescription, SemanticDescription]:
    """Describe the robot of an MJCF file, whose joints have no speed limits.

    Args:
        path: The file; names of other files are relative to it.
        text: Text given in place of the file; None to read the file.
        package_dirs: Further folders in which meshes are searched.

    Returns:
        The same as :func:`~tominpmp.description.from_pinocchio.describe_model`.

    Raises:
        RobotLoadError: If MuJoCo cannot read the file, a joint has several degrees of
            freedom, or a mesh is missing.
        MissingDependency: If MuJoCo is not installed.
    """
    mujoco = imported_mujoco("robots of MJCF files")
    context, said = XmlContext(path, tuple(package_dirs)), list[str]()
    former = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(said.append)
    try:
        if text is None:
            spec = mujoco.MjSpec.from_file(str(path))
        else:
            spec = mujoco.MjSpec.from_string(text.decode())
        _check_joints(spec, context)
        files = _find_meshes(spec, context)
        reader = _MjcfReader(mujoco, spec.compile(), files)
    except (ValueError, mujoco.FatalError) as error:
        context.fail(f"cannot be read: {shortened(one_line(error), 300)}")
    finally:
        mujoco.set_mju_user_warning(former)
    warn_of({UNREAD: reader.unread, "{}": said}, path)
    description = UrdfDescription(
        name=spec.modelname or path.stem,
        bodies=tuple(reader.links),
        tree=(*reader.joints, *reader.fixed),
        gravity=reader.gravity,
        path=path,
        package_dirs=tuple(package_dirs),
        order=tuple(joint.name for joint in reader.joints),
    )
    return description, reader.semantics(path)


def _check_joints(spec: Any, context: XmlContext) -> None:
    """Refuse joints with several degrees of freedom.

    Raises:
        RobotLoadError: If there is one.
    """
    for body in spec.bodies:
        for joint in body.joints:
            kind = joint.type.name.removeprefix("mjJNT_").lower()
            if kind in ("free", "ball"):
                context.fail(
                    f"body {brief(body.name)} has a {kind} joint; only revolute and "
                    "prismatic joints can be planned for: take the joint, or the body, "
                    "out of the file"
                )


def _find_meshes(spec: Any, context: XmlContext) -> dict[str, str]:
    """Find the files of meshes; drop textures, and shapes whose meshes are missing.

    Returns:
        The files by names of meshes; empty for a mesh within the MJCF file, and for one
        with another reference, whose vertices differ from those of its file.

    Raises:
        RobotLoadError: If the missing mesh has weight, or may collide.
    """
    for texture in list(spec.textures):  # no description has them, so none need exist
        spec.delete(texture)
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    files, missing = dict[str, str](), dict[str, str]()
    for mesh in list(spec.meshes):
        files[mesh.name] = ""
        if not mesh.file:
            continue
        name = Path(mesh.file).name if spec.strippath else mesh.file
        name = str(Path(spec.meshdir, name))
        file, tried = resolve_resource(name, context.path, context.folders)
        if file is None:
            missing[mesh.name] = missing_resource(name, tried)
            spec.delete(mesh)
            continue
        mesh.file = str(file.absolute())
        if not (np.any(mesh.refpos) or np.any(mesh.refquat[1:])):
            files[mesh.name] = mesh.file
    dropped = []
    for body in spec.bodies if missing else ():
        of_shapes = spec.compiler.inertiafromgeom
        light = of_shapes == 0 or (of_shapes == 2 and body.explicitinertial)
        for geom in list(body.geoms):
            if geom.meshname not in missing:
                continue
            if geom.contype or geom.conaffinity or not (light or geom.mass == 0.0):
                context.fail(f"body {body.name}: the mesh {missing[geom.meshname]}")
            dropped.append(f"body {body.name} ({brief(geom.meshname)})")
            spec.delete(geom)
    warn_of({UNSEEN: dropped}, context.path)
    return files


class _MjcfReader:
    """Reads links, joints and limits from a model of MuJoCo.

    Args:
        mujoco: The module.
        model: The model.
        files: Files of meshes by their names, see :func:`_find_meshes`.
    """

    def __init__(self, mujoco: Any, model: Any, files: Mapping[str, str]) -> None:
        self.mujoco, self.model, self.files = mujoco, model, files
        self.bodies = [model.body(i).name for i in range(model.nbody)]
        self.names = [model.joint(i).name for i in range(model.njnt)]
        self._taken = {*self.bodies}, {*self.names}
        for i, name in enumerate(self.bodies):
            self.bodies[i] = name or fresh_name("body", self._taken[0])
        for i, name in enumerate(self.names):
            of_body = f"{self.bodies[model.jnt_bodyid[i]]}_joint"
            self.names[i] = name or fresh_name(of_body, self._taken[1])
        self.efforts = self._efforts()
        self.links = [self._link(0)]
        self.joints: list[JointDescription] = []
        self.fixed: list[JointDescription] = []
        for body in range(1, model.nbody):
            self._add_body(body)
        for site in map(model.site, range(model.nsite)):
            link = LinkDescription(fresh_name(site.name or "site", self._taken[0]))
            above, place = site.bodyid[0], _placement(site.pos, site.quat)
            self._fix(link, self.bodies[above], place)

    def _add_body(self, body: int) -> None:
        """Add the link of a body, and the joints between this link and its parent.

        A joint beside the origin of the body moves a link of its own, and so does each
        joint but the last.
        """
        own, link = self.model.body(body), self._link(body)
        above, place = self.bodies[own.parentid[0]], _placement(own.pos, own.quat)
        joints = range(own.jntadr[0], own.jntadr[0] + own.jntnum[0])
        for i in joints:
            beside = pin.SE3(np.eye(3), np.array(self.model.jnt_pos[i]))
            below = link.name
            if i != joints[-1] or np.any(beside.translation):
                below = fresh_name(f"{self.names[i]}_link", self._taken[0])
                self.links.append(LinkDescription(below))
            self.joints.append(self._joint(i, above, below, place * beside))
            above, place = below, beside.inverse()
        if above == link.name:
            self.links.append(link)
        else:
            self._fix(link, above, place)

    def _fix(self, link: LinkDescription, above: str, place: pin.SE3) -> None:
        """Add a link that is fixed to another."""
        name = fresh_name(f"{link.name}_fixed", self._taken[1])
        self.links.append(link)
        self.fixed.append(fixed_joint(name, above, link.name, place))

    def _joint(
        self, i: int, above: str, below: str, place: pin.SE3
    ) -> JointDescription:
        """Describe a joint between two links, with the zero position of MuJoCo."""
        own, name = self.model.joint(i), self.names[i]
        lower, upper = _range(own.limited, own.range)
        turns = "continuous" if upper == math.inf else "revolute"
        joint = JointDescription(
            name,
            turns if _kind(self.mujoco.mjtJoint, own) == "hinge" else "prismatic",
            above,
            below,
            place,
            own.axis,
            lower,
            upper,
            velocity=math.inf,
            effort=np.array(self.efforts.get(name, (math.nan, math.nan))),
            damping=float(own.damping.flat[0]),
            friction=float(own.frictionloss[0]),
            armature=float(own.armature[0]),
        )
        return replace(joint, placement=place * joint.motion(-float(own.qpos0[0])))

    def _link(self, body: int) -> LinkDescription:
        """Describe a body: its weight, and shapes that collide, are seen, or both."""
        own = self.model.body(body)
        geoms = range(own.geomadr[0], own.geomadr[0] + own.geomnum[0])
        solids, seen = list[Shape](), list[Shape]()
        for geom in map(self.model.geom, geoms):
            shape = self._shape(geom)
            if shape is not None and (geom.contype[0] or geom.conaffinity[0]):
                solids.append(shape)
            if shape is not None and geom.group[0] < SHOWN_GROUPS:
                seen.append(shape)
        axes = _placement(own.ipos, own.iquat).rotation
        return LinkDescription(
            self.bodies[body],
            float(own.mass[0]) or None,
            own.ipos,
            axes * own.inertia @ axes.T,
            tuple(solids),
            tuple(seen),
        )

    def _shape(self, geom: Any) -> Shape | None:
        """Describe a shape; None for a plane or a height field, which have no end."""
        place, kind = _placement(geom.pos, geom.quat), _kind(self.mujoco.mjtGeom, geom)
        if kind in HALVES:
            shape = solid(kind, geom.size[: len(HALVES[kind])] * HALVES[kind], place)
        elif kind == "ellipsoid":
            corners, faces = ellipsoid(geom.size)
            shape = Shape("mesh", (1.0,) * 3, place, "", frozen_array(corners), faces)
        elif kind == "mesh":
            shape = self._mesh(self.model.mesh(geom.dataid[0]), place)
        else:
            return None
        colour, material = geom.rgba, geom.matid[0]
        if material >= 0 and np.allclose(colour, UNCOLOURED):
            colour = self.model.mat_rgba[material]
        return shape and replace(shape, colour=tuple(colour.tolist()))

    def _mesh(self, mesh: Any, place: pin.SE3) -> Shape:
        """Describe a mesh, which MuJoCo has centred and turned to its main axes."""
        model, file, k = self.model, self.files[mesh.name], mesh.id
        if file:
            centre = _placement(model.mesh_pos[k], model.mesh_quat[k])
            place = place * centre.inverse()
            return Shape("mesh", tuple(model.mesh_scale[k].tolist()), place, file)
        first = mesh.vertadr[0]
        corners = frozen_array(model.mesh_vert[first : first + mesh.vertnum[0]])
        first = mesh.faceadr[0]
        faces = model.mesh_face[first : first + mesh.facenum[0]].astype(np.int64)
        return Shape("mesh", (1.0,) * 3, place, "", corners, faces)

    @property
    def gravity(self) -> tuple[float, ...]:
        """Gravity [m/s^2]."""
        option, off = self.model.opt, self.mujoco.mjtDisableBit.mjDSBL_GRAVITY
        return tuple((option.gravity * (not option.disableflags & off)).tolist())

    def semantics(self, path: Path) -> SemanticDescription:
        """Link pairs that are not checked, and configurations by name.

        Pairs that are excluded, or that no mask lets collide, replace neighbours, which
        MuJoCo does not check either, but for the world.
        """
        model, parents = self.model, self.model.body_parentid
        masks, others = model.body_contype, model.body_conaffinity
        solid, met = masks | others > 0, masks[:, None] & others > 0
        apart = np.triu(solid[:, None] & solid & ~(met | met.T), 1)
        apart[np.divmod(model.exclude_signature, 2**16)] = True
        if np.any(apart):
            fixed = model.body_weldid  # bodies fixed to each other: the first of them
            apart |= (fixed[parents[fixed]][:, None] == fixed) & (fixed > 0)
            apart[np.arange(model.nbody), parents] |= parents > 0
        pairs = np.argwhere(apart).tolist()
        named = {ordered_pair(self.bodies[i], self.bodies[k]) for i, k in pairs}
        states = {
            ("", model.key(k).name or f"key {k}"): dict(
                zip(self.names, row, strict=True)
            )
            for k, row in enumerate(model.key_qpos.tolist())
        }
        return SemanticDescription(tuple(sorted(named)), states, path)

    @np.errstate(over="ignore")  # infinite products are no limits
    def _efforts(self) -> dict[str, Range]:
        """Total force limits of the actuators, for each joint with finite limits."""
        model, sums = self.model, dict[int, Array]()
        for own in map(model.actuator, range(model.nu)):
            ends = np.array(_range(own.forcelimited, own.forcerange))
            if own.gaintype[0] == own.biastype[0] == 0:  # forces follow from controls
                integrates = own.dyntype[0] == self.mujoco.mjtDyn.mjDYN_INTEGRATOR
                limited = own.ctrllimited and not integrates
                control = np.array(_range(limited, own.ctrlrange))
                control = np.clip(control, *_range(own.actlimited, own.actrange))
                ends = np.clip(ends, *np.sort(own.gainprm[0] * control))
            if own.trntype[0] <= 1:  # of a joint
                joint = int(own.trnid[0])
                sums[joint] = sums.get(joint, 0.0) + np.sort(own.gear[0] * ends)
        limits = {}
        for i, name in enumerate(self.names):
            most = _range(model.jnt_actfrclimited[i], model.jnt_actfrcrange[i])
            low, high = np.clip(sums.get(i, most), *most).tolist()
            if math.isfinite(high - low):
                limits[name] = low, high
        return limits

    @property
    def unread(self) -> list[str]:
        """Features of the model that a description lacks."""
        model, field = self.model, self.mujoco.mjtGeom.mjGEOM_HFIELD
        found = {
            "equality": model.neq,
            "gravcomp": np.any(model.body_gravcomp),
            "hfield": int(field) in model.geom_type,
            "pair": model.npair,
            "stiffness": np.any(model.jnt_stiffness),
            "tendon": model.ntendon,
        }
        return [name for name in found if found[name]]


def _kind(kinds: Any, own: Any) -> str:
    """Name of the type of a joint or shape, without the prefix of its enumeration."""
    return str(kinds(int(own.type[0])).name).rpartition("_")[2].lower()


def _placement(position: Array, quaternion: Array) -> pin.SE3:
    """Placement of a position [m] and a quaternion (w, x, y, z)."""
    return pin.XYZQUATToSE3(np.append(position, np.roll(quaternion, -1)))


def _range(limited: Any, ends: Array) -> Range:
    """Range of a limit, two numbers; infinite if it is not in force."""
    low, high = ends.tolist() if np.all(limited) else (-math.inf, math.inf)
    return low, high
