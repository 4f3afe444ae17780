"""Every description in a folder: loaded, moved a little, verified, in a table.

All URDF, xacro and MJCF files below the folder are loaded; included parts (xacro files
that define no robot, MJCF files without bodies) are left out. Each loaded robot is
moved by a tenth of a radian, as by ``benchmarks.every_robot``.
Data missing from a file must be given for all files at once, or else are the reason why
it does not load: MJCF files have no limits of speed, so ``--velocity`` sets them; with
``--acceleration`` files without dynamics are planned without torques. Run it on your
own collection:

    python -m benchmarks.every_description FOLDER
    python -m benchmarks.every_description FOLDER --package-dir FOLDER --limit 60
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.every_robot import count_processor_time, plan_little
from tominpmp.description.xacro_files import is_xacro
from tominpmp.description.xml_reader import read_xml
from tominpmp.exceptions import TominpmpError, TominpmpWarning

COLUMNS = (
    *("file", "kind", "loads", "joints", "plans", "verified", "T", "seconds"),
    *("load_seconds", "status", "why"),
)
ENDINGS = (".urdf", ".xacro", ".xml")


def kind_of(path: Path) -> str:
    """Format of a file: urdf, xacro, mjcf; empty for a part, or without a robot."""
    try:
        root = read_xml(path)
    except TominpmpError:
        # A broken URDF file counts; other XML files are ignored.
        return "urdf" if path.suffix.lower() == ".urdf" else ""
    if root.tag == "mujoco":
        moves = root.find(".//joint") is not None or root.find(".//include") is not None
        return "mjcf" if moves and root.find("worldbody") is not None else ""
    if root.tag != "robot" or path.suffix.lower() == ".xml":
        return ""
    if not is_xacro(root):
        is_part = path.suffix.lower() == ".xacro" and root.find("link") is None
        return "" if is_part else "urdf"
    # Files of macros, or robots without a name, are included by other files.
    return "xacro" if root.get("name") else ""


def measure(
    path: Path,
    folder: Path,
    limit: float,
    given: Mapping[str, Any],
    speed: float,
    acceleration: float | None = None,
) -> dict[str, object] | None:
    """A row of the sheet; None if the file describes no robot.

    Args:
        path: The file.
        folder: The folder to which its name is relative.
        limit: Longest time of planning [s].
        given: Arguments of ``load_robot`` for all files.
        speed: Speed limit for file formats without speed limits [rad/s or m/s].
        acceleration: Limit for files without dynamics [rad/s^2 or m/s^2]; None to
            refuse these files.
    """
    kind = kind_of(path)
    if not kind:
        return None
    row: dict[str, object] = dict.fromkeys(COLUMNS, "")
    row |= {"file": str(path.relative_to(folder)), "kind": kind, "loads": False}
    more = dict(given)
    if kind == "mjcf":
        more.setdefault("velocity", speed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TominpmpWarning)
        try:
            try:
                found = plan_little(path, limit, **more)
            except TominpmpError as error:
                if acceleration is None or "kinematic=True" not in str(error):
                    raise
                row["kind"] = f"{kind}, kinematic"
                found = plan_little(path, limit, acceleration, kinematic=True, **more)
        except TominpmpError as error:
            if kind == "xacro" and "has no <link>" in str(error):
                return None  # macros only: a part of other files
            return row | {"why": " ".join(str(error).split())[:300]}
        except Exception as error:  # a defect, which the table must show
            return row | {"why": f"DEFECT {type(error).__name__}: {error}"[:300]}
    kept = "joints", "verified", "T", "seconds", "load_seconds", "status"
    return row | {
        "loads": True,
        "plans": found["success"],
        "why": "" if found["verified"] is True else found["message"],
        **{key: found[key] for key in kept},
    }


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--package-dir", type=Path, action="append", default=[])
    parser.add_argument(
        "--velocity", type=float, default=2.0, help="speed of joints of MJCF files"
    )
    parser.add_argument(
        "--acceleration", type=float, help="of joints of files without dynamics"
    )
    parser.add_argument(
        "--limit", type=float, default=20.0, help="seconds of the processor a robot"
    )
    parser.add_argument("--csv", type=Path, default=Path("out/every_description.csv"))
    arguments = parser.parse_args()
    folder = arguments.folder
    if not folder.is_dir():
        parser.error(f"there is no folder {folder}")
    count_processor_time()
    sheet = Sheet(arguments.csv, COLUMNS)
    given = {"package_dirs": [folder, *arguments.package_dir]}
    for path in sorted(p for p in folder.rglob("*") if p.suffix.lower() in ENDINGS):
        speed, acceleration = arguments.velocity, arguments.acceleration
        row = measure(path, folder, arguments.limit, given, speed, acceleration)
        if row is not None:
            sheet.add(row)
    shown = (*COLUMNS[:8], "why")
    print(markdown(shown, [[row[key] for key in shown] for row in sheet.rows]))
    loaded = [row for row in sheet.rows if row["loads"] is True]
    good = sum(row["verified"] is True for row in loaded)
    print(f"\n{len(sheet.rows)} files, {len(loaded)} load, {good} planned and verified")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
