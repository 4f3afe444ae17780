"""The links of a URDF file: inertia, shapes, meshes and colours, checked and copied."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

from tominpmp.description.fields import shown
from tominpmp.description.files import resolve_resource
from tominpmp.description.xml_reader import XmlContext
from tominpmp.exceptions import brief

# A mesh beyond this would take minutes and gigabytes.
MAX_MESH_BYTES = 512 * 2**20
# Characters of a path that a message shows.
LONGEST_PATH = 400

# Attributes of the shapes, with the count of their numbers.
_SIZES: dict[str, dict[str, int]] = {
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
}
_ZEROS = (0.0, 0.0, 0.0)


def write_numbers(element: Element, attribute: str, values: Iterable[float]) -> None:
    """Write numbers so that every parser reads exactly them."""
    element.set(attribute, " ".join(repr(float(value)) for value in values))


def copy_origin(where: str, old: Element, new: Element, context: XmlContext) -> None:
    """Copy the <origin> of an element, if it has one."""
    origin = old.find("origin")
    if origin is None:
        return
    copy = SubElement(new, "origin")
    write_numbers(copy, "xyz", context.numbers(origin, "xyz", where, _ZEROS))
    write_numbers(copy, "rpy", context.numbers(origin, "rpy", where, _ZEROS))


def copy_link(
    name: str,
    link: Element,
    clean: Element,
    context: XmlContext,
    materials: Mapping[str, Element],
    package_dirs: Sequence[Path],
) -> None:
    """Copy a link.

    Args:
        name: Its name.
        link: The link as found.
        clean: Element to copy it into.
        context: The file.
        materials: Colours of the file by name.
        package_dirs: Folders in which to look for ``package://``.

    Raises:
        RobotLoadError: If the link is wrong, or a mesh is not there.
    """
    new = SubElement(clean, "link", name=name)
    _copy_inertial(f"link {name}", link, new, context)
    capsules = {c.get("name") for c in link.findall("collision_checking/capsule")}
    checking = Element("collision_checking")
    for i, old in enumerate(link.findall("collision")):
        where = f"link {name}, collision {i + 1}"
        copy, kind = _copy_shape(where, old, new, context, package_dirs)
        copy.set("name", str(i))
        named = kind == "cylinder" and old.get("name") in capsules
        if kind == "capsule" or named:
            SubElement(checking, "capsule", name=str(i))
    for i, old in enumerate(link.findall("visual")):
        where = f"link {name}, visual {i + 1}"
        copy, _ = _copy_shape(where, old, new, context, package_dirs)
        # Parsers take materials of one name for the same, whatever their colours.
        _copy_material(f"{name} {i}", old, copy, context, materials, package_dirs)
    if len(checking):
        new.append(checking)


def _copy_inertial(
    where: str, link: Element, new: Element, context: XmlContext
) -> None:
    inertial = link.find("inertial")
    if inertial is None:
        return
    copy = SubElement(new, "inertial")
    copy_origin(where, inertial, copy, context)
    mass = inertial.find("mass")
    if mass is None:
        context.fail(f"{where}: <inertial> lacks <mass>")
    value = context.number(mass, "value", where, low=0.0)
    write_numbers(SubElement(copy, "mass"), "value", [value])
    inertia = inertial.find("inertia")
    new_inertia = SubElement(copy, "inertia")
    for entry in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
        # No check of the sign: rounding leaves moments of -1e-20, and whether the
        # robot as a whole has inertia is checked on its mass matrix.
        write_numbers(new_inertia, entry, [context.number(inertia, entry, where)])


def _copy_shape(
    where: str,
    old: Element,
    new_link: Element,
    context: XmlContext,
    package_dirs: Sequence[Path],
) -> tuple[Element, str]:
    """Copy a <collision> or <visual>; return the copy and the kind of its shape."""
    new = SubElement(new_link, old.tag)
    copy_origin(where, old, new, context)
    geometry = old.find("geometry")
    shapes = [] if geometry is None else list(geometry)
    if len(shapes) != 1 or shapes[0].tag not in (*_SIZES, "mesh"):
        found = ", ".join(f"<{shape.tag}>" for shape in shapes) or "nothing"
        context.fail(
            f"{where}: <geometry> has {found}, expected one of {', '.join(_SIZES)} "
            "and mesh"
        )
    shape = shapes[0]
    # URDF knows no capsule; the caller marks the cylinder as one.
    tag = "cylinder" if shape.tag == "capsule" else shape.tag
    copy = SubElement(SubElement(new, "geometry"), tag)
    if tag == "mesh":
        mesh = _find_mesh(where, shape, context, package_dirs)
        copy.set("filename", str(mesh))
        scale = context.numbers(shape, "scale", where, (1.0, 1.0, 1.0))
        if 0.0 in scale:
            context.fail(f"{where}: mesh scale={scale}, expected none to be zero")
        write_numbers(copy, "scale", scale)
    else:
        for attribute, count in _SIZES[shape.tag].items():
            context.text(shape, attribute, where)
            sizes = context.numbers(shape, attribute, where, (0.0,) * count)
            if min(sizes) <= 0:
                context.fail(
                    f"{where}: {shape.tag} {attribute}={brief(shape.get(attribute))}, "
                    "expected numbers greater than zero"
                )
            write_numbers(copy, attribute, sizes)
    return new, shape.tag


def _find_mesh(
    where: str, shape: Element, context: XmlContext, package_dirs: Sequence[Path]
) -> Path:
    filename = context.text(shape, "filename", where)
    path, tried = resolve_resource(filename, context.path, package_dirs)
    if path is None:
        remedy = "; give the folder that holds the package in package_dirs"
        context.fail(
            f"{where}: the mesh {shown(repr(filename))} is not there; tried "
            + ", ".join(shown(str(place), LONGEST_PATH) for place in tried)
            + (remedy if filename.startswith(("package://", "model://")) else "")
        )
    if path.stat().st_size > MAX_MESH_BYTES:
        context.fail(f"{where}: the mesh {path} has more than {MAX_MESH_BYTES} bytes")
    return path


def read_materials(root: Element) -> dict[str, Element]:
    """Collect the colours that a file defines by name, at the top or in a link."""
    materials: dict[str, Element] = {}
    for element in root.iter("material"):
        name = element.get("name")
        if name and len(element):
            materials.setdefault(name, element)
    return materials


def _copy_material(
    name: str,
    visual: Element,
    new: Element,
    context: XmlContext,
    materials: Mapping[str, Element],
    package_dirs: Sequence[Path],
) -> None:
    """Copy a colour and texture; these are looks, so what is wrong is left out."""
    material = visual.find("material")
    if material is None:
        return
    if not len(material):
        material = materials.get(material.get("name", ""), material)
    copy = Element("material", name=name)
    color = material.find("color")
    if color is not None:
        try:
            rgba = [float(x) for x in color.get("rgba", "").split()]
        except ValueError:
            rgba = []
        if len(rgba) == 4 and all(0 <= x <= 1 for x in rgba):
            write_numbers(SubElement(copy, "color"), "rgba", rgba)
    texture = material.find("texture")
    if texture is not None and texture.get("filename"):
        path, _ = resolve_resource(
            texture.get("filename", ""), context.path, package_dirs
        )
        if path is not None:
            SubElement(copy, "texture", filename=str(path))
    if len(copy):
        new.append(copy)
