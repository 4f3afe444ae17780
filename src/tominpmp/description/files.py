"""Finding the files of a robot: its description by name or path, and its meshes."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from urllib.parse import unquote

from tominpmp.description.paths import checked_path
from tominpmp.exceptions import RobotLoadError, brief, closest, shortened

# Where example-robot-data has its files, below a prefix.
_EXAMPLE_SHARE = Path("share", "example-robot-data", "robots")

# Characters of a path that a message shows, and the most paths that it shows.
LONGEST_PATH, MOST_PLACES = 400, 20
# Names with a package, or with a path that is meant for one machine.
_ELSEWHERE = re.compile(r"(package|model|file):|\$\(find|/|[A-Za-z]:[\\/]")
# The name of a package in its manifest.
_NAMED = re.compile(r"<name>\s*(\S+?)\s*</name>")
# How ROS names a package in a path: the file was not expanded to the end.
_FIND = re.compile(r"^(?:\w+://)?\$\(find(?:-pkg-share)?\s+([\w.-]+)\s*\)/*")

# Names that the example-robot-data loaders know and that are not simply the name of a
# URDF file: the file, and the name of the SRDF file where that is called otherwise.
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


# Which of the names are those of arms: in full, and by how they begin.
ARMS = ("baxter", "talos_arm", "talos_left_arm", "z1")
ARM_FAMILIES = (
    *("asr_twodof", "double_pendulum", "kinova", "panda", "planar", "so10", "twodofs"),
    *("ur3", "ur5", "ur10", "xarm"),
)


@dataclass(frozen=True)
class RobotFiles:
    """The files that describe a robot.

    Attributes:
        urdf: The description.
        srdf: The semantic description, if there is one.
        name: The name asked for, ``None`` if it was a path.
    """

    urdf: Path
    srdf: Path | None
    name: str | None = None


def find_robot(name_or_path: str | os.PathLike[str]) -> RobotFiles:
    """Find a robot's description.

    A word is a name: of a bundled robot, else of one in example-robot-data. Whatever
    has a folder or a suffix is a path.

    Raises:
        RobotLoadError: If there is no such robot, with the names there are.
    """
    if not isinstance(name_or_path, (str, os.PathLike)) or not str(name_or_path):
        raise RobotLoadError(
            f"expected the name of a robot or the path of a URDF file, "
            f"got {brief(name_or_path)}"
        )
    known = _known_robots(_example_folder(), _bundled_folder())
    if isinstance(name_or_path, str) and name_or_path in known:
        return known[name_or_path]
    path = Path(name_or_path)
    if isinstance(name_or_path, str) and path.name == name_or_path and not path.suffix:
        raise RobotLoadError(_unknown_name(name_or_path, known))
    path = checked_path(name_or_path, "name_or_path", RobotLoadError).absolute()
    return RobotFiles(path, find_srdf(path))


def find_srdf(urdf: Path) -> Path | None:
    """Find the semantic description that belongs to a URDF file by its name.

    Args:
        urdf: The file; ``NAME.srdf`` is looked for beside it and in ``../srdf``.
    """
    name = f"{urdf.stem}.srdf"
    for candidate in (urdf.parent / name, urdf.parent.parent / "srdf" / name):
        if candidate.is_file():
            return candidate
    return None


def robot_names() -> tuple[str, ...]:
    """Names that :func:`~tominpmp.load_robot` knows on this machine."""
    return tuple(sorted(_known_robots(_example_folder(), _bundled_folder())))


def manipulators_first(names: Iterable[str]) -> tuple[str, ...]:
    """Names of robots, those of arms before those of others, as they stand else."""

    def is_other(name: str) -> bool:
        words = name.lower().replace("-", "_")
        return words not in ARMS and not words.startswith(ARM_FAMILIES)

    return tuple(sorted(names, key=is_other))


def _unknown_name(name: str, known: Iterable[str]) -> str:
    names, hint = sorted(known), ""
    if _example_folder() is None:
        hint = " The package example-robot-data, which brings more, is not installed."
    return (
        f"there is no robot {brief(name)}{closest(name, names)}.{hint} "
        f"Known names: {', '.join(names)}; or give the path of a .urdf file"
    )


@cache
def _known_robots(examples: Path | None, bundled: Path) -> dict[str, RobotFiles]:
    """Map every known name to its files; bundled robots come first.

    Args:
        examples: Folder of example-robot-data; None if it is not installed.
        bundled: Folder of the bundled robots.
    """
    robots: dict[str, RobotFiles] = {}
    if examples is not None:
        # Two different files of one name (anymal) are told apart by the aliases.
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
    """Folder of the bundled robots: in the wheel, else at the top of the checkout."""
    package = Path(__file__).parents[1]
    installed = package / "robots"
    return installed if installed.is_dir() else package.parent.parent / "robots"


@cache
def _example_folder() -> Path | None:
    """Folder of example-robot-data, which has no Python module: below a prefix.

    That of its wheel lies beside the packages; conda, robotpkg and ROS have their own.
    """
    roots = [Path(entry) / "cmeel.prefix" for entry in sys.path if entry]
    roots += [Path(sys.prefix), *_environment_folders("AMENT_PREFIX_PATH")]
    folders = (root / _EXAMPLE_SHARE for root in roots)
    return next((folder.resolve() for folder in folders if folder.is_dir()), None)


def _environment_folders(variable: str) -> list[Path]:
    return [Path(p) for p in os.environ.get(variable, "").split(os.pathsep) if p]


def check_folders(package_dirs: Sequence[str | os.PathLike[str]]) -> tuple[Path, ...]:
    """Check the folders given for packages; a single one is taken as such.

    Raises:
        RobotLoadError: If a folder is not there.
    """
    if isinstance(package_dirs, (str, os.PathLike)):
        package_dirs = [package_dirs]
    if not isinstance(package_dirs, Sequence) or isinstance(package_dirs, bytes):
        raise RobotLoadError(
            f"package_dirs is {brief(package_dirs)}, expected paths of folders"
        )
    folders = tuple(
        checked_path(folder, "package_dirs", RobotLoadError).absolute()
        for folder in package_dirs
    )
    for folder in folders:
        if not folder.is_dir():
            raise RobotLoadError(f"package_dirs: there is no folder {folder}", folder)
    return folders


def resolve_resource(
    filename: str, urdf: Path, package_dirs: Sequence[Path]
) -> tuple[Path | None, tuple[Path, ...]]:
    """Find a file that a description refers to.

    ``package://NAME/REST`` and ``$(find NAME)/REST`` are looked for in the given
    folders (which are the package, or hold it, also in a folder of theirs), in those
    above the description, beside its own package, and in those of
    ``ROS_PACKAGE_PATH`` and ``AMENT_PREFIX_PATH``; so is the path of another machine,
    ``/.../share/NAME/REST`` or ``file://`` before it, if it is not there. Other names
    are relative to the description, then to the given folders. Failing that,
    backslashes are those of Windows, ``%20`` is a space, and letters may be large or
    small, as long as that fits one file.

    Returns:
        The file, ``None`` if there is none, and the paths tried.

    Raises:
        RobotLoadError: If the reference leads out of its package.
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
    """Whether it can be read; not a device, reading which might never end."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def missing_resource(name: str, tried: Sequence[Path]) -> str:
    """Say that a file is not there, where it was looked for, and what may help."""
    hints = (closest(path.name, _names_in(path.parent)) for path in tried)
    hint = next(filter(None, hints), "")
    places = [shortened(str(path), LONGEST_PATH) for path in tried[:MOST_PLACES]]
    remedy = "; give the folder that holds the package in package_dirs"
    what = f"{shortened(repr(name))} is not there{hint}; tried {', '.join(places)}"
    return what + remedy if _ELSEWHERE.match(name) else what


def _in_packages(path: Path) -> list[str]:
    """Names that a path of another machine may have below a package."""
    parts = Path(os.path.normpath(path)).parts
    # Of what is installed the package is known, of what lies in a workspace it is not.
    starts: Iterable[int] = range(1, len(parts) - 1)
    if "share" in parts[:-1]:
        starts = [len(parts) - parts[::-1].index("share", 1)]
    return [f"package://{'/'.join(parts[i:])}" for i in starts if parts[i] != ".."]


def _in_any_case(path: Path) -> Path | None:
    """The one path that is the same but for large and small letters."""
    path = path.absolute()
    found = Path(path.anchor)
    for part in path.parts[1:]:
        names = _names_in(found)
        if part not in names:
            names = tuple(n for n in names if n.casefold() == part.casefold())
            if len(names) != 1:
                return None
            part = names[0]
        found /= part
    return found


def _names_in(folder: Path) -> tuple[str, ...]:
    """Names of what is in a folder; none if it cannot be looked into."""
    try:
        return _listed(folder, folder.stat().st_mtime_ns)
    except (OSError, ValueError):
        return ()


@lru_cache(maxsize=256)
def _listed(folder: Path, changed: int) -> tuple[str, ...]:
    """Names of what was in a folder when it was changed last."""
    return tuple(os.listdir(folder))


def find_package(name: str, path: Path, package_dirs: Sequence[Path]) -> Path:
    """Find the folder of a package where :func:`resolve_resource` looks for its files.

    Args:
        name: Name of the package.
        path: The description that names it.
        package_dirs: Folders that hold packages, or are the package.

    Raises:
        RobotLoadError: If there is none.
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
        # Joining an absolute path to a folder gives that path.
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
    # Some descriptions have package:///NAME/REST.
    package, _, inside = rest.lstrip("/").partition("/")
    # Joined to a folder, a path that began with "/" would replace it.
    inside = os.path.normpath(inside.lstrip("/") or ".")
    if package in ("", ".", "..") or inside == ".." or inside.startswith(".." + os.sep):
        raise RobotLoadError(
            f"{urdf}: {brief(filename)} leads out of its package; refused", urdf
        )
    for folder in package_dirs:
        yield folder / package / inside
    yield from (d / inside for d in package_dirs if d.name == package)
    # A description may be a link into the folder where its package really is.
    above = dict.fromkeys((*urdf.parents, *urdf.resolve().parents))
    ros = _environment_folders("ROS_PACKAGE_PATH")
    ros += [p / "share" for p in _environment_folders("AMENT_PREFIX_PATH")]
    yield from (d / package / inside for d in (*above, *ros))
    # Folders may have other names than the packages in them: those given, those in
    # them and two below, the one that the description is in, and those beside it.
    own = [folder for folder in above if (folder / "package.xml").is_file()]
    depths = [(folder, 2) for folder in package_dirs]
    for folder, depth in (*depths, *((folder.parent, 1) for folder in own)):
        if package in (named := _packages_in(folder, depth)):
            yield named[package] / inside
    given = [folder for folder in package_dirs if (folder / "package.xml").is_file()]
    yield from (folder / inside for folder in (*given, *own))


@cache
def _packages_in(folder: Path, depth: int) -> dict[str, Path]:
    """Packages in a folder and so far below it, by their names; as it was once."""
    found: dict[str, Path] = {}
    for level in range(1, depth + 1):
        for manifest in sorted(folder.glob("*/" * level + "package.xml")):
            found.setdefault(_package_name(manifest.parent), manifest.parent)
    return found


def _package_name(folder: Path) -> str:
    """Name that the manifest in a folder gives; empty if there is none."""
    manifest = folder / "package.xml"
    try:
        text = manifest.read_text("utf-8", "replace") if manifest.is_file() else ""
    except (OSError, ValueError):
        return ""
    found = _NAMED.search(text)
    return found[1] if found else ""
