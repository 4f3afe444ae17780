"""Search for the files of a robot: its description by name or path, and its meshes."""

from __future__ import annotations

import importlib
import os
import pkgutil
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from tominpmp.arrays import is_single
from tominpmp.description.paths import checked_path
from tominpmp.description.xml_reader import given_text
from tominpmp.exceptions import RobotLoadError, brief, closest, shortened

# Folder of the files of example-robot-data, below an installation prefix.
_EXAMPLE_SHARE = Path("share", "example-robot-data", "robots")

# Characters of a path in a message, and the most paths in a message.
LONGEST_SHOWN, MOST_PLACES = 400, 20
# References into a package, and absolute paths that belong to another machine.
_ELSEWHERE = re.compile(r"(package|model|file):|\$\(find|/|[A-Za-z]:[\\/]")
# Package name in a manifest.
_PACKAGE_NAME = re.compile(r"<name>\s*(\S+?)\s*</name>")
# Package reference of ROS in a path, left over where a file was not fully expanded.
_FIND = re.compile(r"^(?:\w+://)?\$\(find(?:-pkg-share)?\s+([\w.-]+)\s*\)/*")

# Names that the example-robot-data loaders know and that differ from the name of the
# URDF file: the file, and the name of the SRDF file if that differs as well.
_EXAMPLE_ALIASES: dict[str, tuple[str, ...]] = {
    "alexander": ("alexander_description/urdf/alexander_v1.lowerBodyOnly", "alexander"),
    "anymal": ("anymal_b_simple_description/robots/anymal",),
    "anymal_c": ("anymal_c_simple_description/urdf/anymal",),
    "anymal_kinova": ("anymal_b_simple_description/robots/anymal-kinova",),
    "asr_twodof": ("asr_twodof_description/urdf/TwoDofs",),
    "b1_z1": ("b1_description/urdf/b1-z1",),
    "baxter": ("baxter_description/urdf/baxter", "baxter_manipulation"),
    "borinot": ("borinot_description/urdf/borinot_flying_arm_2",),
    "g1": ("g1_description/urdf/g1_29dof_rev_1_0",),
    "g1_with_hands": ("g1_description/urdf/g1_29dof_with_hand_rev_1_0",),
    "hector": ("hector_description/robots/quadrotor_base",),
    "hextilt": ("hextilt_description/urdf/hextilt_flying_arm_5",),
    "hyq": ("hyq_description/robots/hyq_no_sensors", "hyq"),
    "icub_reduced": ("icub_description/robots/icub_reduced", "icub"),
    "iris": ("iris_description/robots/iris_simple",),
    "panda_collision": ("panda_description/urdf/panda_collision", "panda"),
    "solo8": ("solo_description/robots/solo",),
    "solo12": ("solo_description/robots/solo12", "solo"),
    "talos": ("talos_data/robots/talos_reduced", "talos"),
    "talos_arm": ("talos_data/robots/talos_left_arm", "talos"),
    "talos_box": ("talos_data/robots/talos_reduced_box", "talos"),
    "talos_full": ("talos_data/robots/talos_full_v2", "talos"),
    "talos_full_box": ("talos_data/robots/talos_full_v2_box", "talos"),
    "ur3": ("ur_description/urdf/ur3_robot",),
    "ur3_limited": ("ur_description/urdf/ur3_joint_limited_robot",),
    "ur5": ("ur_description/urdf/ur5_robot", "ur5"),
    "ur5_limited": ("ur_description/urdf/ur5_joint_limited_robot",),
    "ur10": ("ur_description/urdf/ur10_robot",),
    "ur10_limited": ("ur_description/urdf/ur10_joint_limited_robot",),
}


# Suffix of the module names of the package robot_descriptions, and attributes of its
# modules with their files; the first one is read.
MODULE_ENDING = "_description"
_PATHS = ("URDF_PATH", "XACRO_PATH", "MJCF_PATH")
# Sources of a robot, in messages.
EXPECTED = (
    "the name of a robot, the path or the text of a URDF file, a pinocchio.Model, a "
    "yourdfpy.URDF or a module of robot_descriptions with a URDF_PATH, XACRO_PATH or "
    "MJCF_PATH"
)

# Names of arms among the robots: whole names, and prefixes.
ARMS = ("baxter", "talos_arm", "talos_left_arm", "z1")
ARM_FAMILIES = (
    *("asr_twodof", "double_pendulum", "kinova", "panda", "planar", "so10", "twodofs"),
    *("ur3", "ur5", "ur10", "xarm"),
)


@dataclass(frozen=True)
class RobotFiles:
    """The files that describe a robot.

    Attributes:
        urdf: The description; a path in angle brackets stands for a text.
        srdf: The semantic description, if there is one.
        name: The name that was asked for; ``None`` for a path.
        packages: Folders of its packages, as far as they are known.
        text: Text given in place of the description; ``None`` for a file.
    """

    urdf: Path
    srdf: Path | None
    name: str | None = None
    packages: tuple[Path, ...] = ()
    text: bytes | None = None


def find_robot(name_or_path: str | os.PathLike[str]) -> RobotFiles:
    """Find a robot's description.

    A plain word is a name: of a bundled robot, else of one in example-robot-data.
    Anything with a folder or a suffix is a path.

    Raises:
        RobotLoadError: If the robot is unknown; names similar ones.
    """
    known = _known_robots(_example_folder(), _bundled_folder())
    if isinstance(name_or_path, str) and name_or_path in known:
        return known[name_or_path]
    expected = "the name of a robot or the path of a file"
    path = checked_path(name_or_path, "the robot", RobotLoadError, expected)
    if isinstance(name_or_path, str) and path.name == name_or_path and not path.suffix:
        meant = closest(path.name, sorted(known))
        valid = f"expected {expected}; 'tominpmp robots' lists the names"
        valid += "" if _example_folder() else ", example-robot-data has more robots"
        raise RobotLoadError(f"there is no robot {brief(path.name)}{meant}; {valid}")
    return RobotFiles(path.absolute(), find_srdf(path.absolute()))


def find_files(source: object) -> RobotFiles:
    """Find the files of a robot.

    Args:
        source: A name, a path or a text, or a module of the package robot_descriptions
            or its name.

    Raises:
        RobotLoadError: If the robot is unknown, or the source of another kind.
    """
    text = given_text(source)
    if text is not None:
        return RobotFiles(Path(f"<text of {len(text)} bytes>"), None, text=text)
    name = str(getattr(source, "__name__", ""))
    if isinstance(source, str | os.PathLike):
        name = str(source)
        module = name.isidentifier() and name.endswith(MODULE_ENDING)
        if not module or name in robot_names():
            return find_robot(source)
        source = _imported_module(name)
    paths = _paths(source, _PATHS)
    if not paths:
        raise RobotLoadError(f"the robot is {brief(source)}, expected {EXPECTED}")
    folders = _paths(source, ("PACKAGE_PATH", "REPOSITORY_PATH"))
    packages = {p for folder in folders for p in (folder, folder.parent) if p.is_dir()}
    named = name.rpartition(".")[2] or None
    return RobotFiles(paths[0], find_srdf(paths[0]), named, tuple(sorted(packages)))


def _imported_module(name: str) -> Any:
    """Import a module of robot_descriptions, which may download its files."""
    known: list[str] = []
    with suppress(ImportError):
        package = importlib.import_module("robot_descriptions")
        known = [module.name for module in pkgutil.iter_modules(package.__path__)]
    if name not in known:
        raise RobotLoadError(
            f"there is no robot {brief(name)}{closest(name, known)}; names that end "
            f"with {MODULE_ENDING!r} are those of the package robot_descriptions: "
            "python -m pip install robot_descriptions"
        )
    try:
        return importlib.import_module(f"robot_descriptions.{name}")
    except Exception as error:  # the download may raise anything
        raise RobotLoadError(
            f"robot_descriptions.{name} cannot be loaded: {brief(str(error), 200)}"
        ) from error


def _paths(module: object, names: Sequence[str]) -> list[Path]:
    """Paths among the values of some attributes of a module."""
    values = [getattr(module, name, None) for name in names]
    return [Path(p).absolute() for p in values if isinstance(p, str | os.PathLike)]


def find_srdf(urdf: Path) -> Path | None:
    """Find the semantic description that belongs to a URDF file by its name.

    Args:
        urdf: The file, ``NAME.urdf``, ``NAME.xacro`` or ``NAME.urdf.xacro``;
            ``NAME.srdf`` is searched next to it and in ``../srdf``.
    """
    # The parent of "urdf/.." is not "urdf".
    folder = Path(os.path.normpath(urdf.parent))
    name = f"{urdf.stem.removesuffix('.urdf')}.srdf"
    candidates = folder / name, folder.parent / "srdf" / name
    return next((path for path in candidates if path.is_file()), None)


def robot_names() -> tuple[str, ...]:
    """Names that :func:`~tominpmp.load_robot` knows on this machine."""
    return tuple(sorted(_known_robots(_example_folder(), _bundled_folder())))


def manipulators_first(names: Iterable[str]) -> tuple[str, ...]:
    """Sort the names of robots: arms first, otherwise in the given order."""

    def is_other(name: str) -> bool:
        words = name.lower().replace("-", "_")
        return words not in ARMS and not words.startswith(ARM_FAMILIES)

    return tuple(sorted(names, key=is_other))


@cache
def _known_robots(examples: Path | None, bundled: Path) -> dict[str, RobotFiles]:
    """Map every known name to its files; bundled robots come first.

    Args:
        examples: Folder of example-robot-data; None if it is not installed.
        bundled: Folder of the bundled robots.
    """
    robots: dict[str, RobotFiles] = {}
    if examples is not None:
        # Two different files with one name (anymal) are distinguished by the aliases.
        for urdf in sorted(examples.glob("*/*/*.urdf")):
            robots[urdf.stem] = RobotFiles(urdf, find_srdf(urdf), urdf.stem)
        for name, (stem, *srdf_stem) in _EXAMPLE_ALIASES.items():
            urdf = examples / f"{stem}.urdf"
            if urdf.is_file():
                named = urdf.with_stem(srdf_stem[0]) if srdf_stem else urdf
                robots[name] = RobotFiles(urdf, find_srdf(named), name)
    for urdf in sorted(bundled.glob("*.urdf")):
        robots[urdf.stem] = RobotFiles(urdf, find_srdf(urdf), urdf.stem)
    return robots


def _bundled_folder() -> Path:
    """Folder of the bundled robots: in the wheel, or at the top of the checkout."""
    package = Path(__file__).parents[1]
    installed = package / "robots"
    return installed if installed.is_dir() else package.parent.parent / "robots"


@cache
def _example_folder() -> Path | None:
    """Folder of example-robot-data below a prefix; it has no Python module.

    Its wheel installs it next to the packages, conda into the prefix of Python, and ROS
    into prefixes of its own.
    """
    roots = [Path(entry) / "cmeel.prefix" for entry in sys.path if entry]
    roots += [Path(sys.prefix), *_environment_folders("AMENT_PREFIX_PATH")]
    folders = (root / _EXAMPLE_SHARE for root in roots)
    return next((folder.resolve() for folder in folders if folder.is_dir()), None)


def _environment_folders(variable: str) -> list[Path]:
    return [Path(p) for p in os.environ.get(variable, "").split(os.pathsep) if p]


def check_folders(package_dirs: Sequence[str | os.PathLike[str]]) -> tuple[Path, ...]:
    """Check the package folders; a single path counts as a list of one.

    Raises:
        RobotLoadError: If a folder does not exist.
    """
    named, folders = ("package_dirs", RobotLoadError, "paths of folders"), list[Path]()
    for given in [package_dirs] if is_single(package_dirs) else package_dirs:
        folder = checked_path(given, *named).absolute()
        if not folder.is_dir():
            raise RobotLoadError(f"package_dirs: there is no folder {folder}", folder)
        folders.append(folder)
    return tuple(folders)


def resolve_resource(
    filename: str, urdf: Path, package_dirs: Sequence[Path]
) -> tuple[Path | None, tuple[Path, ...]]:
    """Find a file that a description refers to.

    ``package://NAME/REST`` and ``$(find NAME)/REST`` are searched in the given folders
    (which may be the package, or contain it, also one level deeper), in the folders
    above the description, next to its own package, and in those of ``ROS_PACKAGE_PATH``
    and ``AMENT_PREFIX_PATH``; so are absolute paths of another machine,
    ``/.../share/NAME/REST``, also after ``file://``, if they do not exist. Other names
    are relative to the description, then to the given folders. If all of that fails,
    backslashes count as separators of Windows, ``%20`` as a space, and case is ignored
    if a single file matches.

    Returns:
        The file, ``None`` if it does not exist, and the paths tried.

    Raises:
        RobotLoadError: If the reference leaves its package, or leads to a network.
    """
    slashed = filename.replace("\\", "/")
    names = dict.fromkeys((filename, slashed, unquote(slashed)))
    tried: dict[Path, None] = {}
    for name in names:
        for path in _candidates(name, urdf, package_dirs):
            tried[path] = None
            if _is_file(path):
                return path, tuple(tried)
    for other in filter(None, map(_in_any_case, tried)):
        if _is_file(other):
            return other, tuple(tried)
    _packages_in.cache_clear()
    return None, tuple(tried)


def _is_file(path: Path) -> bool:
    """Whether it is a regular file; reading a device might never end."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def missing_resource(name: str, tried: Sequence[Path]) -> str:
    """Message for a missing file, with the places searched and a remedy."""
    hints = (closest(path.name, _names_in(path.parent)) for path in tried)
    hint = next(filter(None, hints), "")
    places = [shortened(str(path), LONGEST_SHOWN) for path in tried[:MOST_PLACES]]
    remedy = "; give the folder that holds the package in package_dirs"
    message = f"{shortened(repr(name))} does not exist{hint}; tried {', '.join(places)}"
    return message + remedy if _ELSEWHERE.match(name) else message


def _in_packages(path: Path) -> list[str]:
    """Package references that an absolute path of another machine may stand for."""
    parts = Path(os.path.normpath(path)).parts
    # Installed files reveal their package, files in a workspace do not.
    starts: Iterable[int] = range(1, len(parts) - 1)
    if "share" in parts[:-1]:
        starts = [len(parts) - parts[::-1].index("share", 1)]
    return [f"package://{'/'.join(parts[i:])}" for i in starts if parts[i] != ".."]


def _in_any_case(path: Path) -> Path | None:
    """The only existing path that matches if case is ignored."""
    path = path.absolute()
    existing = Path(path.anchor)
    for part in path.parts[1:]:
        names = [n for n in _names_in(existing) if n.casefold() == part.casefold()]
        if part not in names and len(names) != 1:
            return None
        existing /= part if part in names else names[0]
    return existing


def _names_in(folder: Path) -> tuple[str, ...]:
    """Names in a folder; empty if it cannot be read."""
    try:
        return _listed(folder, folder.stat().st_mtime_ns)
    except (OSError, ValueError):
        return ()


@lru_cache(maxsize=256)
def _listed(folder: Path, changed: int) -> tuple[str, ...]:
    """Names in a folder at its last change; that time makes the cache key."""
    return tuple(os.listdir(folder))


def find_package(name: str, path: Path, package_dirs: Sequence[Path]) -> Path:
    """Find the folder of a package where :func:`resolve_resource` searches, too.

    Args:
        name: Name of the package.
        path: The description that refers to it.
        package_dirs: Folders that contain packages, or are the package.

    Raises:
        RobotLoadError: If the package is not found.
    """
    for folder in _candidates(f"package://{name}/.", path, package_dirs):
        if name in (folder.name, _package_name(folder)) and folder.is_dir():
            return folder
    _packages_in.cache_clear()
    raise RobotLoadError(
        f"{path}: there is no folder of the package {brief(name)}; give the folder "
        "that holds it in package_dirs",
        path,
    )


def _candidates(
    filename: str, urdf: Path, package_dirs: Sequence[Path]
) -> Iterator[Path]:
    filename = _FIND.sub(r"package://\1/", filename)
    scheme, separator, rest = filename.partition("://")
    if not separator or scheme == "file":
        path = Path(rest if separator else filename)
        # An absolute path replaces the folder to which it is joined.
        for folder in (urdf.parent, *package_dirs):
            yield Path(os.path.normpath(folder / path))
        if _ELSEWHERE.match(filename):
            for name in _in_packages(path):
                yield from _candidates(name, urdf, package_dirs)
        return
    if scheme not in ("package", "model"):
        raise RobotLoadError(
            f"{urdf}: {brief(filename)}: expected a path, package://, model:// or "
            "file://, nothing is fetched from elsewhere",
            urdf,
        )
    # Some descriptions write package:///NAME/REST.
    package, _, inside = rest.lstrip("/").partition("/")
    # A path with a leading "/" would replace the folder to which it is joined.
    inside = os.path.normpath(inside.lstrip("/") or ".")
    if package in ("", ".", "..") or inside == ".." or inside.startswith(".." + os.sep):
        raise RobotLoadError(
            f"{urdf}: {brief(filename)} leads out of its package; refused", urdf
        )
    for folder in package_dirs:
        yield folder / package / inside
    yield from (d / inside for d in package_dirs if d.name == package)
    # A description may be a symbolic link into the folder of its package.
    above = dict.fromkeys((*urdf.parents, *urdf.resolve().parents))
    ros = _environment_folders("ROS_PACKAGE_PATH")
    ros += [p / "share" for p in _environment_folders("AMENT_PREFIX_PATH")]
    yield from (d / package / inside for d in (*above, *ros))
    # Folder and package names may differ: manifests are read in the given folders, up
    # to two levels below them, in the description's own package, and in its siblings.
    own = [folder for folder in above if (folder / "package.xml").is_file()]
    depths = [(folder, 2) for folder in package_dirs]
    for folder, depth in (*depths, *((folder.parent, 1) for folder in own)):
        if package in (named := _packages_in(folder, depth)):
            yield named[package] / inside
    packages = [folder for folder in package_dirs if (folder / "package.xml").is_file()]
    yield from (folder / inside for folder in (*packages, *own))


@cache
def _packages_in(folder: Path, depth: int) -> dict[str, Path]:
    """Packages in a folder, down to a depth, by name; cached until a search fails."""
    packages: dict[str, Path] = {}
    for level in range(1, depth + 1):
        for manifest in sorted(folder.glob("*/" * level + "package.xml")):
            packages.setdefault(_package_name(manifest.parent), manifest.parent)
    return packages


def _package_name(folder: Path) -> str:
    """Package name in the manifest of a folder; empty without a manifest."""
    manifest = folder / "package.xml"
    try:
        text = manifest.read_text("utf-8", "replace") if manifest.is_file() else ""
    except (OSError, ValueError):
        return ""
    match = _PACKAGE_NAME.search(text)
    return match[1] if match else ""
