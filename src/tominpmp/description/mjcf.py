"""MJCF, the format of MuJoCo: simplified first, then read by Pinocchio.

Includes and defaults are resolved, all bodies are attached to one world body, and
meshes become paths of existing files. Features that Pinocchio's parser omits are read
here: limits of actuators and of sliding joints, excluded pairs and gravity.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from tominpmp.arrays import frozen_array
from tominpmp.description.files import missing_resource, resolve_resource
from tominpmp.description.from_pinocchio import describe_model
from tominpmp.description.model import one_line
from tominpmp.description.srdf import SemanticDescription
from tominpmp.description.tree import (
    WORLD,
    JointDescription,
    UrdfDescription,
    fresh_name,
    warn_of_missing_visuals,
)
from tominpmp.description.xml_reader import XmlContext, read_xml, to_number, xml_text
from tominpmp.exceptions import brief, shortened, warn_caller

# Elements that generate bodies in ways that Pinocchio does not support; elements, and
# then attributes, that affect the dynamics or shapes and are not read.
GENERATORS = {"attach", "composite", "flexcomp", "frame", "replicate"}
UNREAD = {"tendon", "equality", "stiffness", "gravcomp", "settotalmass", "hfield"}
UNREAD |= {"inertiagrouprange", "boundmass", "boundinertia", "refpos", "refquat"}
# Actuators, which share their defaults, with the attributes that their tags stand for.
# Forces follow from controls if they have no bias.
BIASED = "position velocity intvelocity damper cylinder muscle".split()
ACTUATORS = {kind: {"biastype": "affine"} for kind in BIASED}
ACTUATORS |= {"motor": {"biastype": "none", "gainprm": "1"}, "general": {}}
# Joints with several degrees of freedom.
MULTI_DOF = ("free", "ball")
# Supported shapes, with the number of their sizes; lengths of further attributes, which
# Pinocchio does not check.
SHAPES = dict(mesh=0, sphere=1, capsule=2, cylinder=2, box=3, ellipsoid=3)
PLACEMENT = {"pos": 3, "quat": 4, "axisangle": 4, "xyaxes": 6, "zaxis": 3, "euler": 3}
ORIENTATIONS = PLACEMENT.keys() - {"pos"}
COUNTS = {"axis": 3, "diaginertia": 3, "fullinertia": 6, "fromto": 6, "rgba": 4}
COUNTS |= {"mass": 1, "armature": 1, "damping": 1, "frictionloss": 1}
NONNEGATIVE = ("size", "mass", "armature", "damping", "frictionloss")

Range = tuple[float, float]
# Default attributes by tag.
Defaults = Mapping[str, Mapping[str, str]]


def describe_mjcf(
    root: Element, path: Path, package_dirs: Sequence[Path]
) -> tuple[UrdfDescription, SemanticDescription, Mapping[str, Range]]:
    """Describe the robot of an MJCF file, whose joints have no speed limits.

    Args:
        root: Root of the file, ``<mujoco>``; it is modified.
        path: The file; names of other files are relative to it.
        package_dirs: Further folders in which these files are searched.

    Returns:
        The same as :func:`~tominpmp.description.from_pinocchio.describe_model`.

    Raises:
        RobotLoadError: If Pinocchio cannot read the file, it generates bodies, an
            attribute is wrong, a joint has several degrees of freedom, or a mesh or an
            included file is missing.
    """
    reader = _MjcfReader(root, XmlContext(path, tuple(package_dirs)))
    nested = [(one, two) for one in root.iter("body") for two in one.findall("body")]
    described, semantics, _ = describe_model(*reader.built(), package_dirs, path)
    efforts = reader.efforts()
    gravity = described.gravity or ()
    for option in root.findall("option"):
        gravity = reader.context.numbers(option, "gravity", "option", gravity)
    if any(flag.get("gravity") == "disable" for flag in root.findall("option/flag")):
        gravity = (0.0, 0.0, 0.0)
    tree = tuple(reader.finished(joint, efforts) for joint in described.tree)
    excluded = [(e.get("body1", ""), e.get("body2", "")) for e in root.iter("exclude")]
    if excluded:  # the pairs replace neighbours, which MuJoCo does not check either
        excluded += [(one.get("name", ""), two.get("name", "")) for one, two in nested]
    pairs = sorted({(min(pair), max(pair)) for pair in excluded})
    states = {} if semantics is None else dict(semantics.group_states)
    states.pop("qpos0", None)  # added by Pinocchio
    return (
        replace(described, tree=tree, gravity=gravity),
        SemanticDescription(tuple(pairs), states, path),
        {name: ends for name, ends in efforts.items() if ends[0] != -ends[1]},
    )


class _MjcfReader:
    """Simplifies a file, and keeps the data that Pinocchio does not read."""

    def __init__(self, root: Element, context: XmlContext) -> None:
        self.root, self.context = root, context
        self._include(root, {context.path})
        self.compiler = {"angle": "degree"}
        for element in root.findall("compiler"):
            self.compiler |= element.attrib
        #: Unit of angles [rad].
        self.unit = math.pi / 180.0 if self.compiler["angle"] == "degree" else 1.0
        #: Defaults by name of their class.
        self.classes: dict[str, Defaults] = {"main": {}}
        for element in root.findall("default"):
            self._add_class(element, self.classes["main"], "main")
        self._fill_in(root, "main")
        if self.compiler.get("inertiafromgeom") == "true":
            # Bodies without shapes keep their inertia, which Pinocchio would drop.
            for body in root.findall(".//body[geom]"):
                for inertial in body.findall("inertial"):
                    body.remove(inertial)
        self.bodies = {body.get("name", "") for body in root.iter("body")}
        self.joints: dict[str, Element] = {}
        #: Missing mesh files, with a message; shapes that were left out.
        self.missing: dict[str, str] = {}
        self.dropped: list[str] = []

    def _include(self, element: Element, seen: set[Path]) -> None:
        """Replace include elements by the content of their files."""
        for place, child in reversed([*enumerate(element)]):
            if child.tag == "include":
                name = self.context.text(child, "file", "include")
                file = self.context.path.parent / name
                if file in seen:
                    self.context.fail(f"the file {brief(name)} is included twice")
                seen.add(file)
                child = read_xml(file)
                element[place : place + 1] = child
            self._include(child, seen)

    def _add_class(self, element: Element, above: Defaults, name: str) -> None:
        """Store the defaults of a class, which inherits those of its parent class."""
        own = dict(above)
        self.classes[element.get("class", name)] = own
        for child in element:
            own[_kind(child)] = _over(own, child)
        for child in element.findall("default"):
            self._add_class(child, own, "")

    def _fill_in(self, element: Element, childclass: str) -> None:
        """Set the defaults of all elements inside an element."""
        childclass = element.attrib.pop("childclass", childclass)
        for child in element:
            if child.tag == "default":
                continue
            name = child.attrib.pop("class", childclass)
            if name not in self.classes:
                self.context.fail(f"<{child.tag}>: there is no class {brief(name)}")
            child.attrib = _over(self.classes[name], child)
            self._fill_in(child, childclass)

    def built(self) -> tuple[pin.Model, pin.GeometryModel, pin.GeometryModel]:
        """Model, collision geometry and visual geometry.

        Raises:
            RobotLoadError: If Pinocchio cannot read the file.
        """
        plain, kinds = self._simplified(), pin.GeometryType
        weightless = self.compiler.get("inertiafromgeom") == "false"
        shown = xml_text(plain)
        weighing = xml_text(_with_known_weights(plain, weightless))
        with tempfile.TemporaryDirectory() as name:
            file, other = str(Path(name, "robot.xml")), str(Path(name, "weights.xml"))
            Path(file).write_bytes(shown)
            Path(other).write_bytes(weighing)
            try:
                model = pin.buildModelFromMJCF(other)
                solid = pin.buildGeomFromMJCF(model, file, kinds.COLLISION)
                return model, solid, pin.buildGeomFromMJCF(model, file, kinds.VISUAL)
            except Exception as error:
                self.context.fail(f"cannot be read: {shortened(one_line(error), 300)}")

    def _simplified(self) -> Element:
        """Equivalent file that Pinocchio can read."""
        root, path = self.root, self.context.path
        simple = Element("mujoco", model=root.get("model", path.stem))
        SubElement(simple, "compiler", angle=self.compiler["angle"])
        asset = SubElement(simple, "asset")
        folder = self.compiler.get("meshdir", self.compiler.get("assetdir", ""))
        for item in root.findall("asset/mesh[@file]"):
            strip = self.compiler.get("strippath") == "true"
            name = Path(item.get("file", ""))
            item.set("name", item.get("name", name.stem))
            name = Path(folder, name.name if strip else name)
            file, tried = resolve_resource(str(name), path, self.context.folders)
            if file is None:
                self.missing[item.get("name", "")] = missing_resource(str(name), tried)
            else:
                item.set("file", str(file.absolute()))
        for item in (*root.findall("asset/mesh"), *root.findall("asset/material")):
            item.attrib.pop("texture", None)
            self.context.numbers(item, "rgba", "asset", (0.0,) * COUNTS["rgba"])
            if item.tag != "mesh" or item.get("name") not in self.missing:
                asset.append(item)
        # Pinocchio reads the first body only, and ignores its placement.
        world = SubElement(SubElement(simple, "worldbody"), "body", name=WORLD)
        for body in root.findall("worldbody"):
            world.extend(body)
        self._simplify(world, {element.get("name", "") for element in root.iter()})
        words = (w for e in root.iter() for w in (e.tag, *e.attrib) if e.get(w) != "0")
        unread = UNREAD.intersection(words)
        keys = SubElement(simple, "keyframe")
        for key in root.findall("keyframe/key[@qpos]"):
            if len(key.get("qpos", "").split()) == len(self.joints):
                keys.append(key)
        warn_of_missing_visuals(self.dropped, path)
        if unread:
            warn_caller(f"{path}: not read: {', '.join(sorted(unread))}")
        return simple

    def _simplify(self, body: Element, names: set[str]) -> None:
        """Name the elements of a body, drop unsupported shapes, and store joints."""
        where = f"body {body.get('name')}"
        for child in list(body):
            counts = PLACEMENT | COUNTS
            tag, kind = child.tag, child.get("type", "sphere")
            if tag == "geom" and "mesh" in child.attrib:
                # MuJoCo fits a primitive to the mesh; here the mesh itself is taken.
                kind = child.attrib["type"] = "mesh"
            if tag == "geom" and kind in SHAPES:
                count = 1 if "fromto" in child.attrib else SHAPES[kind]
                # Defaults for several kinds of shapes may have surplus sizes.
                child.set("size", " ".join(child.get("size", "").split()[:count]))
                counts = counts | {"size": count}
            for key in (k for k in counts if k in child.attrib):
                low = 0.0 if key in NONNEGATIVE else None
                self.context.numbers(child, key, where, (0.0,) * counts[key], low)
            self._turn(child, where)
            if tag in GENERATORS:
                self.context.fail(
                    f"{where} has <{tag}>, which is not read; write "
                    "out the bodies that it makes (mujoco.mj_saveLastXML does)"
                )
            if tag == "freejoint" or (tag == "joint" and kind in MULTI_DOF):
                self.context.fail(
                    f"{where} has a {'ball' if kind == 'ball' else 'free'} joint; only "
                    "revolute and prismatic joints can be planned for: take the joint, "
                    "or the body, out of the file"
                )
            if tag in ("body", "joint", "site") and "name" not in child.attrib:
                child.set("name", fresh_name(f"{body.get('name')}_{tag}", names))
            if tag == "body":
                child = self._with_one_joint(body, child, names)
                self._simplify(child, names)
            elif tag == "joint":
                self.joints[child.get("name", "")] = Element(tag, child.attrib)
                for key in ("range", "ref", "actuatorfrcrange"):
                    child.attrib.pop(key, None)
            elif tag == "geom" and (kind not in SHAPES or self._is_absent(body, child)):
                body.remove(child)
            elif tag == "site":
                # Pinocchio misplaces sites in bodies without joints, but not bodies.
                child.tag = "body"
                child.set("name", fresh_name(child.get("name", ""), self.bodies))
            elif tag == "geom" and "fromto" in child.attrib:
                # Pinocchio has the z axis towards the second end, MuJoCo to the first.
                ends = child.attrib["fromto"].split()
                child.set("fromto", " ".join(ends[3:] + ends[:3]))
            elif tag == "geom":
                # Pinocchio ignores the rotation of a shape without a position.
                child.set("pos", child.get("pos", "0 0 0"))

    def _turn(self, element: Element, where: str) -> None:
        """Write a rotation about an axis, or Euler angles, as a quaternion.

        Pinocchio does not normalise axes, and has no Euler angles about fixed axes.
        """
        read, unit = self.context.numbers, self.unit
        rotation = np.eye(3)
        if "axisangle" in element.attrib:
            *axis, angle = read(element, "axisangle", where, (0.0,) * 4)
            if not any(axis):
                self.context.fail(f"{where}: {element.tag} axisangle has no axis")
            rotation = pin.exp3(unit * angle * np.array(axis) / np.linalg.norm(axis))
        elif "euler" in element.attrib:
            order = self.compiler.get("eulerseq", "xyz")
            if len(order) != 3 or not {*order.lower()} <= {*"xyz"}:
                self.context.fail(f"compiler eulerseq={brief(order)}, expected as xyz")
            angles = read(element, "euler", where, (0.0,) * 3)
            for letter, angle in zip(order, angles, strict=True):
                step = pin.exp3(unit * angle * np.eye(3)["xyz".index(letter.lower())])
                # Small letters are axes that turn with the element, capital ones fixed.
                rotation = rotation @ step if letter.islower() else step @ rotation
        else:
            return
        for key in ("axisangle", "euler"):
            element.attrib.pop(key, None)
        x, y, z, w = pin.Quaternion(rotation).coeffs().tolist()
        element.set("quat", f"{w} {x} {y} {z}")

    def _with_one_joint(
        self, parent: Element, body: Element, names: set[str]
    ) -> Element:
        """A body with one joint: the first of several moves to a body in between."""
        joints = body.findall("joint")
        if len(joints) < 2:
            return body
        outer = Element("body", name=fresh_name(f"{body.get('name')}_carrier", names))
        for key in PLACEMENT.keys() & body.attrib.keys():
            outer.set(key, body.attrib.pop(key))
        parent[[*parent].index(body)] = outer
        body.remove(joints[0])
        outer.extend((joints[0], body))
        return outer

    def _is_absent(self, body: Element, geom: Element) -> bool:
        """Whether the mesh of a shape is missing, which only a picture may lack.

        Raises:
            RobotLoadError: If the missing mesh has weight, or may collide.
        """
        missing = self.missing.get(geom.get("mesh", ""))
        if missing is None:
            return False
        weighs = body.find("inertial") is None and geom.get("mass") != "0"
        weighs &= self.compiler.get("inertiafromgeom") != "false"
        if weighs or not geom.get("contype") == geom.get("conaffinity") == "0":
            self.context.fail(f"body {body.get('name')}: the mesh {missing}")
        self.dropped.append(f"body {body.get('name')} ({brief(geom.get('mesh'))})")
        return True

    def finished(
        self, joint: JointDescription, efforts: Mapping[str, Range]
    ) -> JointDescription:
        """Complete a joint with its range, effort, and MuJoCo's zero position."""
        own = self.joints.get(joint.name)
        if own is None:
            return joint
        turns = joint.kind != "prismatic"
        scale = self.unit if turns else 1.0
        lower, upper = (scale * end for end in self._range(own, "range", "limited"))
        ref = scale * self.context.number(own, "ref", f"joint {joint.name}")
        return replace(
            joint,
            kind="continuous" if turns and upper == math.inf else joint.kind,
            placement=frozen_array(joint.placement @ joint.motion(-ref).homogeneous),
            lower=lower,
            upper=upper,
            effort=min(map(abs, efforts.get(joint.name, (math.nan,)))),
        )

    def _range(self, element: Element, name: str, limited: str) -> Range:
        """Range of an attribute; infinite if it is not in force."""
        setting = element.get(limited, "auto")
        limits = name in element.attrib and self.compiler.get("autolimits") != "false"
        if setting == "false" or (setting == "auto" and not limits):
            return -math.inf, math.inf
        where = f"{element.tag} {element.get('name', '')}"
        low, high = self.context.numbers(element, name, where, (0.0, 0.0))
        return low, high

    def efforts(self) -> dict[str, Range]:
        """Total force limits of the actuators, for each joint with finite limits."""
        sums: dict[str, Any] = {}
        for actuator in self.root.findall("actuator/*"):
            ends = np.array(self._range(actuator, "forcerange", "forcelimited"))
            words = (actuator.get(name, "").split() for name in ("gainprm", "gear"))
            gain, gear = (to_number(word[0]) if word else 1.0 for word in words)
            if actuator.get("biastype", "none") == "none":
                control = np.array(self._range(actuator, "ctrlrange", "ctrllimited"))
                ends = np.clip(ends, *np.sort(gain * control))
            name = actuator.get("joint", actuator.get("jointinparent", ""))
            sums[name] = sums.get(name, 0.0) + np.sort(gear * ends)
        limits = {}
        for name, own in self.joints.items():
            most = self._range(own, "actuatorfrcrange", "actuatorfrclimited")
            low, high = np.clip(sums.get(name, most), *most).tolist()
            if math.isfinite(high - low):
                limits[name] = low, high
        return limits


def _with_known_weights(root: Element, weightless: bool) -> Element:
    """Remove the shapes of bodies whose weight Pinocchio does not compute correctly.

    Pinocchio takes visual shapes for weightless, and each mesh for one kilogram. A body
    whose meshes have weight gets no mass, and is refused where the mass is needed.

    Args:
        root: The file; it is modified.
        weightless: Whether no shape has weight.
    """
    for body in root.iter("body"):
        geoms = body.findall("geom")
        meshes = [geom for geom in geoms if geom.get("type") == "mesh"]
        unknown = weightless or any(geom.get("mass") != "0" for geom in meshes)
        for geom in geoms:
            if unknown or geom in meshes:
                body.remove(geom)
            for name in ("contype", "conaffinity"):
                geom.attrib.pop(name, None)
    return root


def _over(defaults: Defaults, element: Element) -> dict[str, str]:
    """Attributes of an element over its defaults, of whose placement it replaces parts.

    An orientation replaces one in any other notation, and two ends the whole placement.
    """
    own = ACTUATORS.get(element.tag, {}) | element.attrib
    replaced: Collection[str] = ORIENTATIONS if ORIENTATIONS & own.keys() else ()
    if "fromto" in own:
        replaced = PLACEMENT
    below = defaults.get(_kind(element), {})
    return {k: v for k, v in below.items() if k not in replaced} | own


def _kind(element: Element) -> str:
    """Tag under which the defaults of an element are stored."""
    return "general" if element.tag in ACTUATORS else element.tag
