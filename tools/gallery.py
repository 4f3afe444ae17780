"""The motions of the gallery: planned, and written as playback pages.

    python -m tools.gallery FOLDER [NAME ...]

Plans are stored with the pages, and are made again if a source of the library or an
example has changed since.
"""

from __future__ import annotations

import argparse
import pickle
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import tominpmp as tm

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"

Plan = tm.Solution | tm.Tour


@dataclass(frozen=True)
class Item:
    """A motion of the gallery.

    Attributes:
        name: Name of its example, and of its page.
        title: Heading.
        text: Description of the motion.
        options: Options of the plan.
        twin: Whether the page also shows the same task on a sampled path by TOPP-RA.
        tour: Whether the motion is a tour, which its example plans.
    """

    name: str
    title: str
    text: str
    options: dict[str, Any] = field(default_factory=dict)
    twin: bool = False
    tour: bool = False

    def problem(self) -> tm.Problem:
        """The problem of its scenario, or of its example."""
        scenario = EXAMPLES / "scenarios" / f"{self.name}.toml"
        if scenario.is_file():
            return tm.load_scenario(scenario).problem
        return SPECIAL[self.name](self.example)  # type: ignore[no-any-return]

    @property
    def example(self) -> Any:
        """Its example, as a module."""
        if str(EXAMPLES) not in sys.path:
            sys.path.append(str(EXAMPLES))
        return import_module(self.name)

    def planned(self) -> Plan:
        """Its motion, or its tour.

        Raises:
            PlanningFailed: If no motion is found.
        """
        if self.tour:
            tour: tm.Tour = self.example.tour()
            return tour.raise_if_failed()
        return tm.plan(self.problem(), **self.options).raise_if_failed()


SPECIAL: dict[str, Any] = {
    "two_ur5": lambda example: example.problem(example.workcell()),
    "payload": lambda example: example.problem(
        tm.load_robot(
            "panda", limits="urdf", locked_joints={"panda_finger_joint1": 0.04}
        ).with_payload(example.box())
    ),
    "conveyor": lambda example: example.problem(),
    "handing_over": lambda example: example.problem(example.workcell()),
}

ITEMS = (
    Item(
        "panda_shelf",
        "Into a shelf",
        "A Panda takes a can from the lower board. The goal is a pose of the hand; "
        "the planner chooses the configuration, and the path past the boards. "
        "`examples/panda_shelf.py`",
        twin=True,
    ),
    Item(
        "ur5_post",
        "Around a post",
        "The straight line passes 7 cm deep through the post. The plan nevertheless "
        "begins with this line, and the linear programs push it out. "
        "`examples/ur5_post.py`",
        twin=True,
    ),
    Item(
        "two_ur5",
        "Two arms exchange crates",
        "One problem with 12 joints and one duration. `examples/two_ur5.py`",
        {"intervals": 24},
    ),
    Item(
        "pick_and_place",
        "Pick and place",
        "Seven segments, one motion: it stops only where the hand grips. "
        "`examples/pick_and_place.py`",
        {"intervals": 12, "control": "constant"},
    ),
    Item(
        "handing_over",
        "Two arms hand a bar over",
        "One motion of both arms with two segments: they meet, one gripper takes over, "
        "and the other arm carries the bar. `examples/handing_over.py`",
        {"starts": 1},
    ),
    Item(
        "payload",
        "A box of 2.5 kg over a board",
        "Mass, inertia and shape of the box are part of the plan. "
        "`examples/payload.py`",
        {"intervals": 20},
        twin=True,
    ),
    Item(
        "spot_weld",
        "Twelve spot welds",
        "Order, configurations and spins of the gun are optimised together; beads mark "
        "the stations. `examples/spot_weld.py`",
        tour=True,
    ),
    Item(
        "conveyor",
        "Across a conveyor",
        "A crate passes at 1 m/s; the arm crosses in time. `examples/conveyor.py`",
        {"intervals": 20},
    ),
    Item(
        "swinging_gate",
        "Through a gate that swings open",
        "The arm arrives as soon as the gate is open wide enough. "
        "`examples/swinging_gate.py`",
    ),
    Item(
        "planar3r_obstacle",
        "The paper's arm",
        "Three links, gravity in the plane, a ball as obstacle. `make demo`",
        {"intervals": 75},
    ),
)


def planned(item: Item, folder: Path) -> Plan:
    """Plan a motion, or take it from the folder if no source has changed since."""
    path = folder / f"{item.name}.pickle"
    sources = [
        *(ROOT / "src").rglob("*.py"),
        *EXAMPLES.rglob("*.py"),
        *EXAMPLES.rglob("*.toml"),
        Path(__file__),
    ]
    newest = max(source.stat().st_mtime for source in sources)
    if path.is_file() and path.stat().st_mtime > newest:
        return pickle.loads(path.read_bytes())  # type: ignore[no-any-return]
    solution = item.planned()
    path.write_bytes(pickle.dumps(solution))
    return solution


def twin(item: Item, solution: Plan, folder: Path) -> dict[str, tm.Trajectory]:
    """The same task on a simplified sampled path, timed by TOPP-RA; None if it fails.

    The path ends at the final configuration of the plan if the goal leaves a choice.
    """
    if not item.twin or find_spec("toppra") is None or find_spec("ompl") is None:
        return {}
    path = folder / f"{item.name}_twin.pickle"
    if not path.is_file():
        from benchmarks.rivals.arm import Arm
        from benchmarks.rivals.rrt_toppra import solve

        problem, motion = solution.problem, solution.trajectory
        if motion is None:
            return {}
        checker, room = problem.checker, problem.margins

        def clear(q: np.ndarray) -> bool:
            return bool(np.all(checker.distances(np.atleast_2d(q)) > room))

        found = solve(
            Arm.of(problem.robot), motion.q[0], motion.q[-1], clear, clear, seed=1
        )
        t = np.linspace(0.0, found.T, 400)
        q, v, _ = found.motion(t) if found.motion is not None else (None, None, None)
        path.write_bytes(pickle.dumps((t, q, v)))
    t, q, v = pickle.loads(path.read_bytes())
    if q is None:
        return {}
    names = solution.problem.robot.joint_names
    return {"RRT-Connect and TOPP-RA": tm.Trajectory(names, t, q, v, 0.0 * q)}


def make_pages(folder: Path, names: Sequence[str] = ()) -> None:
    """Write the pages into a folder.

    Args:
        folder: The folder; plans are kept in it, too.
        names: Names of the motions; empty for all.
    """
    pages = folder / "extra" / "playback"
    pages.mkdir(parents=True, exist_ok=True)
    for item in ITEMS:
        if names and item.name not in names:
            continue
        solution = planned(item, folder)
        page = pages / f"{item.name}.html"
        tour = isinstance(solution, tm.Tour)
        T = f"cycle {solution.cycle_time:.2f} s" if tour else f"T = {solution.T:.3f} s"
        title = f"{item.title}: {T}"
        solution.play(page, title=title, twins=twin(item, solution, folder))
        sys.stdout.write(f"{page}\n")


def main() -> int:
    """Write pages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", metavar="NAME")
    arguments = parser.parse_args()
    known = [item.name for item in ITEMS]
    for name in {*arguments.names} - {*known}:
        parser.error(f"there is no {name!r}; there are: {', '.join(known)}")
    make_pages(arguments.folder, arguments.names)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
