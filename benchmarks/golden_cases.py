"""The golden set: a fixed set of problems of every kind that a user can pose.

Each group is a function that yields names and the functions that make their tasks.
Random starts and goals are those of ``random_goals.py``, by their numbers, without
self-collisions; obstacles, limits and rules are placed along a straight motion, so that
no problem depends on the planner. Numbers and options are fixed: whoever changes one
changes the fingerprint of its problem, and comparisons say so.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import tominpmp as tm
from benchmarks.cell_arms import Member
from benchmarks.cell_cases import TOOLS
from benchmarks.cell_judge import GOAL, SPEED
from benchmarks.exact_geometry import Array
from benchmarks.golden_judge import LIMIT, Asked, Verdict, shape
from benchmarks.golden_problems import (
    LOCKED,
    Task,
    arm,
    asked,
    build,
    joint,
    member_of,
    placement,
    task,
)
from benchmarks.motionbenchmaker import SCENES, Case, Court
from benchmarks.random_goals import sample_problems

# The problems of known minimum time belong to the tests, which import each other by
# their folder.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from test_analytic_optima import BELOW, replay
from two_link_cases import CASES

Maker = Callable[[], Task]
Made = Iterator[tuple[str, Maker]]
SEED, DRAWN = 2026, 12
# Numbers of random goals without self-collision, see :func:`ends`.
GOALS = {
    "ur3": (0, 1, 4, 5),
    "ur5": (0, 1, 2, 3),
    "ur10": (1, 2, 4, 6),
    "panda": (0, 2, 3, 4),
    "kinova": (0, 1, 2, 3),
    "xarm7": (0, 1, 3, 4),
    "z1": (0, 1, 2),
    "planar3r": (0, 1, 2),
}
TOOL = {**TOOLS, "ur3": "tool0", "ur10": "tool0"}


@dataclass(frozen=True)
class Source:
    """Sources of problems.

    Attributes:
        data: Folder of MotionBenchMaker, with ``panda`` and ``fetch`` in it or the
            scenes themselves; None without.
        seed: Seed of a fresh part.
    """

    data: Path | None = None
    seed: int = 0

    def folder(self, robot: str) -> Path | None:
        """The folder of the scenes of a robot, if it exists."""
        if self.data is None:
            return None
        own = self.data / robot
        # Some copies have the scenes of the Panda at the top.
        folder = self.data if robot == "panda" and not own.is_dir() else own
        names = SCENES[0], f"{SCENES[0]}_{robot}"
        return folder if any((folder / name).is_dir() for name in names) else None


@functools.cache
def ends(name: str, count: int = DRAWN, seed: int = SEED) -> list[tuple[Array, Array]]:
    """Random starts and goals of an arm, some of them in self-collision."""
    robot = tm.load_robot(name, limits="urdf", locked_joints=LOCKED.get(name, {}))
    return sample_problems(robot, count, seed)


def goal_task(
    name: str, number: int, options: dict[str, Any] | None = None, **how: Any
) -> Task:
    """A random goal of an arm."""
    start, end = ends(name)[number]
    return task(asked(arm(name, **how), start, joint(end)), **(options or {}))


# -- known optima, random goals, clutter -----------------------------------------------


def optima(source: Source) -> Made:
    """The problems whose minimum time is known."""
    for family, cases in CASES.items():
        for name in cases:
            yield name, functools.partial(optimum, family, name)


def optimum(family: str, name: str, **options: Any) -> Task:
    """A problem whose minimum time is known, judged by hand-written equations."""
    case = CASES[family][name]
    known = case.task

    def judged(solution: tm.Solution) -> Verdict:
        motion = solution.trajectory
        assert motion is not None
        low, high = known.bounds.T
        times = np.linspace(0.0, motion.duration, 2001)
        u = motion(times).u
        excess = float(np.max(np.maximum(u - high, low - u) / (high - low)))
        speed = np.abs(motion(times).v) / solution.problem.robot.limits.velocity
        excess = max(excess, float(speed.max()) - 1.0)
        faults = [f"limits off by {excess:.2e}"] if not excess <= LIMIT else []
        off, fast = np.split(np.abs(replay(known, motion) - known.ends[1]), 2)
        if not (off.max() <= GOAL and fast.max() <= SPEED):
            faults.append(f"goal missed by {off.max():.1e}, {fast.max():.1e}")
        if solution.T < case.minimum * (1.0 - BELOW):
            faults.append(f"faster than the minimum of {case.minimum:.6f} s")
        return Verdict(excess, np.inf, tuple(faults))

    numbers = [name, known.bounds, known.ends, case.minimum]
    return Task(case.problem(), judged, numbers, options)


def goals(source: Source, factor: float = 1.0) -> Made:
    """Random joint goals."""
    for name, numbers in GOALS.items():
        for number in numbers:
            make = functools.partial(goal_task, name, number, speed_factor=factor)
            yield f"{name} {number}", make


def fast_goals(source: Source) -> Made:
    """The same with four times the speeds: torques are the active limits."""
    return goals(source, 4.0)


def clutter(source: Source) -> Made:
    """MotionBenchMaker: the first problems of every scene."""
    folder = source.folder("panda")
    if folder is None:
        return
    for scene in SCENES:
        for number in range(1, 6 if scene in ("bookshelf_thin", "cage") else 5):
            case = Case(scene, number, folder)
            yield f"{scene} {number}", functools.partial(clutter_task, case)


def clutter_task(case: Case) -> Task:
    """A problem of MotionBenchMaker, judged by the meshes of the files."""
    court = Court.of(case)
    problem = tm.load_moveit(court.robot, case.scene_path, case.request_path)

    def judged(solution: tm.Solution) -> Verdict:
        motion = solution.trajectory
        assert motion is not None
        columns, faults = court.judge(motion, motion.t, True)
        found = columns["limit_excess"], columns["clearance"], tuple(faults.split())
        return Verdict(*found)

    text = case.scene_path.read_text(), case.request_path.read_text()
    return Task(problem, judged, list(text))


# -- goals on frames, obstacles ----------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """An arm with a random start and goal.

    Attributes:
        name: Name of the task.
        own: The arm as plain data.
        member: The same for the judge.
        start: Start, shape (n,).
        end: Goal, shape (n,).
    """

    name: str
    own: Asked
    member: Member
    start: Array
    end: Array

    @classmethod
    def of(cls, name: str, number: int, **how: Any) -> Setting:
        """A random goal of an arm by its number."""
        own = arm(name, **how)
        return cls(name, own, member_of(own), *ends(name)[number])

    @property
    def tool(self) -> str:
        """Name of the frame of the tool."""
        return TOOL[self.name]

    @property
    def seconds(self) -> float:
        """Approximate duration of a motion limited by its speeds [s]."""
        way = np.abs(self.end - self.start)
        return float(1.3 * np.max(way / np.array(self.own["velocity"])))

    def at(self, share: float) -> Array:
        """A configuration on the straight line."""
        return self.start + share * (self.end - self.start)

    def tool_at(self, share: float) -> pin.SE3:
        """Position of the tool at this configuration."""
        return placement(self.member, self.at(share), self.tool)

    def asked(self, **more: Any) -> Asked:
        """A joint goal, with further keys."""
        return asked(self.own, self.start, joint(self.end), **more)


def frame_goals(source: Source) -> Made:
    """Goals on frames, and sets of goals."""
    for kind, name, number in (
        ("position", "ur5", 0),
        ("position", "xarm7", 1),
        ("pose", "ur5", 1),
        ("pose", "panda", 2),
        ("axis", "ur10", 1),
        ("region", "kinova", 2),
        ("any", "panda", 3),
        ("joint region", "z1", 1),
    ):
        make = functools.partial(frame_goal, kind, name, number)
        yield f"{kind} {name} {number}", make


def frame_goal(kind: str, name: str, number: int) -> Task:
    """A goal that a random configuration meets."""
    own = Setting.of(name, number)
    place = own.tool_at(1.0)
    at, turn = place.translation.tolist(), place.rotation.tolist()
    goal: Asked = {"kind": kind, "frame": own.tool, "position": at}
    if kind == "pose":
        goal["rotation"] = turn
    elif kind == "axis":
        goal |= {"axis": [0.0, 0.0, 1.0], "direction": place.rotation[:, 2].tolist()}
    elif kind == "region":
        low, high = place.translation - 0.05, place.translation + 0.05
        goal = {"kind": kind, "frame": own.tool, "lower": low.tolist()}
        goal["upper"] = high.tolist()
    elif kind == "any":
        pose = {**goal, "kind": "pose", "rotation": turn}
        goal = {"kind": "any", "goals": [pose, joint(own.at(0.8))]}
    elif kind == "joint region":
        goal = {**joint(own.end), "tolerance": [0.1] * len(own.end)}
    return task(asked(own.own, own.start, goal))


def obstacles(source: Source) -> Made:
    """Shapes on the path of the tool."""
    for name, number in (("ur5", 2), ("kinova", 0), ("xarm7", 4), ("z1", 2)):
        yield f"{name} {number}", functools.partial(obstructed, name, number)
    yield "ur5 between table and post", ur5_post


def moving(source: Source) -> Made:
    """Shapes that are on the path of the tool when it passes."""
    for name, number, factor in (
        ("ur5", 1, 1.0),
        ("panda", 0, 1.0),
        ("planar3r", 0, 1.0),
        ("xarm7", 1, 4.0),
    ):
        make = functools.partial(obstructed, name, number, 0.25, factor)
        yield f"{name} {number}", make
    yield "conveyor", conveyor


def obstructed(name: str, number: int, speed: float = 0.0, factor: float = 1.0) -> Task:
    """A box and a ball on the path of the tool, fixed or crossing it."""
    own = Setting.of(name, number, speed_factor=factor)
    rng = np.random.default_rng([number, len(name)])
    reach = 2.5 if name == "planar3r" else 0.8
    found = []
    for kind, share in (("box", 0.4), ("sphere", 0.65)):
        size = reach * rng.uniform(0.04, 0.07)
        way = rng.normal(size=3) * (1.0, 1.0, name != "planar3r")
        velocity = speed * reach * way / np.linalg.norm(way)
        at = own.tool_at(share).translation - share * own.seconds * velocity
        sizes = 2.0 * size * rng.uniform(0.5, 1.5, 3) if kind == "box" else [size]
        found.append(shape(kind, sizes, position=at, velocity=velocity))
    return task(own.asked(obstacles=found))


def ur5_post() -> Task:
    """The example of that name."""
    start = np.array([-0.9, -1.2, 1.4, -1.77, -1.57, 0.0])
    end = start * (-1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    things = [
        shape("cylinder", (0.05, 1.0), name="post", position=(0.65, 0.15, 0.5)),
        shape("box", (2.0, 2.0, 0.1), name="table", position=(0.0, 0.0, -0.06)),
    ]
    return task(asked(arm("ur5"), start, joint(end), obstacles=things, margin=0.01))


NEAR = np.array([-0.028, -1.584, 2.503, -2.49, -1.571, 0.0])
FAR = np.array([-0.012, -0.697, 1.116, -1.99, -1.571, 0.0])


def conveyor() -> Task:
    """The example of this name: a crate crosses the path."""
    crate = shape(
        "box", (0.2, 0.3, 0.25), name="crate",
        position=(0.55, -0.25, 0.125), velocity=(0.0, 1.0, 0.0),
    )  # fmt: skip
    belt = shape("box", (0.25, 2.4, 0.08), name="belt", position=(0.55, 0.0, -0.05))
    more = {"obstacles": [belt, crate], "margin": 0.01}
    return task(asked(arm("ur5"), NEAR, joint(FAR), **more), intervals=20)


# -- segments --------------------------------------------------------------------------


def segments(source: Source) -> Made:
    """Via points, with loads, stops, dwells and times of arrival."""
    for kind, name, number, factor in (
        ("passing", "ur5", 0, 1.0),
        ("passing a place", "panda", 0, 1.0),
        ("stops", "xarm7", 3, 1.0),
        ("load", "ur5", 1, 4.0),
        ("load and dwell", "kinova", 1, 4.0),
        ("arrival", "ur10", 2, 1.0),
        ("limits", "z1", 0, 1.0),
    ):
        make = functools.partial(segmented, kind, name, number, factor)
        yield f"{kind} {name} {number}", make
    yield "pick and place", pick_and_place


def segmented(kind: str, name: str, number: int, factor: float) -> Task:
    """With two via points next to the straight line."""
    own = Setting.of(name, number, speed_factor=factor)
    aside = 0.15 * np.abs(own.end - own.start)
    signs = np.where(np.arange(len(aside)) % 2, -1.0, 1.0)
    low, high = np.array(own.own["position"])
    first = np.clip(own.at(0.35) + signs * aside, low, high)
    second = np.clip(own.at(0.7) - signs * aside, low, high)
    legs: list[Asked] = [{"goal": joint(first)}, {"goal": joint(second)}]
    if kind == "passing a place":
        at = placement(own.member, second, own.tool).translation
        goal = {"kind": "position", "frame": own.tool, "position": at.tolist()}
        legs[1] = {"goal": goal}
    if kind in ("stops", "load"):
        legs = [leg | {"stop": True} for leg in legs]
    if kind == "load and dwell":
        legs = [leg | {"stop": True, "dwell": 0.1} for leg in legs]
    if kind.startswith("load"):
        ball = shape("sphere", (0.03,), position=(0.0, 0.0, 0.06))
        mass = 0.5 if name == "kinova" else 2.0
        legs[1]["load"] = {
            "mass": mass,
            "frame": own.tool,
            "com": [0.0, 0.0, 0.06],
            "shapes": [ball] if name != "kinova" else [],
        }
    if kind == "arrival":
        legs[1]["arrival"] = [1.3 * own.seconds, np.inf]
    if kind == "limits":
        slow = np.max(np.abs(own.end - own.start)) / own.seconds**2
        legs[1]["acceleration"] = [float(4.0 * slow)] * len(aside)
    legs.append({"goal": joint(own.end)})
    return task(asked(own.own, own.start, None, legs=legs))


def pick_and_place() -> Task:
    """The example of that name, as plain data."""
    home, tool = np.array([0.0, -0.6, 0.0, -2.2, 0.0, 1.6, 0.785]), "panda_hand_tcp"
    down = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]
    x, y, z = size = (0.04, 0.04, 0.1)
    load = {
        "mass": 1.0,
        "frame": tool,
        "inertia": (np.diag([y**2 + z**2, x**2 + z**2, x**2 + y**2]) / 12).tolist(),
        "shapes": [shape("box", size)],
    }
    lifted = {"load": load, "may_touch": [("payload", "table")]}
    legs: list[Asked] = [
        {"at": 0.25, "above": 0.12},
        {"at": 0.25, "above": 0.0, "dwell": 0.05, "stop": True},
        {"at": 0.25, "above": 0.12, **lifted},
        {"at": -0.25, "above": 0.12, "load": load},
        {"at": -0.25, "above": 0.0, "dwell": 0.05, "stop": True, **lifted},
        {"at": -0.25, "above": 0.12},
    ]
    for leg in legs:
        position = [0.5, leg.pop("at"), 0.252 + leg.pop("above")]
        place = {"position": position, "rotation": down}
        leg["goal"] = {"kind": "pose", "frame": tool, **place}
    legs.append({"goal": joint(home)})
    things = [
        shape("box", (0.5, 0.9, 0.04), name="table", position=(0.55, 0.0, 0.18)),
        shape("box", (0.3, 0.02, 0.1), name="wall", position=(0.5, 0.0, 0.25)),
    ]
    own = arm("panda", locked={"panda_finger_joint1": 0.04})
    more = {"legs": legs, "obstacles": things, "margin": 0.005}
    case = asked(own, home, None, **more)
    return task(case, intervals=12, control="constant")


# -- what holds between start and goal ---------------------------------------------


def rules(source: Source) -> Made:
    """Tool constraints, one of each kind."""
    for kind, name, number in (
        ("tool_speed", "ur5", 0),
        ("tool_speed", "xarm7", 3),
        ("tool_acceleration", "ur5", 0),
        ("upright", "panda", 2),
        ("upright", "ur10", 1),
        ("keep_away", "kinova", 1),
        ("coupling", "z1", 0),
    ):
        make = functools.partial(ruled, kind, name, number)
        yield f"{kind} {name} {number}", make
    for kind in ("line", "orientation", "region"):
        yield f"{kind} ur5", functools.partial(straight, kind)


def ruled(kind: str, name: str, number: int) -> Task:
    """A random goal with an active rule."""
    own = Setting.of(name, number)
    points = np.array([own.tool_at(s).translation for s in np.linspace(0, 1, 50)])
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    rule: Asked = {"kind": kind, "frame": own.tool}
    if kind == "tool_speed":
        rule["limit"] = length / own.seconds
    elif kind == "tool_acceleration":
        rule["limit"] = 4.0 * length / own.seconds**2
    elif kind == "upright":
        axes = [own.tool_at(s).rotation[:, 2] for s in (0.0, 1.0)]
        mean = (axes[0] + axes[1]) / np.linalg.norm(axes[0] + axes[1])
        lean = float(np.arccos(np.clip(axes[0] @ mean, -1.0, 1.0)))
        rule |= {"axis": [0.0, 0.0, 1.0], "direction": mean.tolist()}
        rule["tolerance"] = lean + 0.15
    elif kind == "keep_away":
        rule |= {"point": points[25].tolist(), "distance": 0.1}
    else:
        ways = own.end - own.start
        first, second = (int(k) for k in np.argsort(-np.abs(ways))[:2])
        weights = [1.0, float(-ways[first] / ways[second])]
        total = own.start[first] + weights[1] * own.start[second]
        rule = {"kind": kind, "columns": [first, second], "weights": weights}
        rule |= {"lower": float(total - 0.05), "upper": float(total + 0.05)}
    return task(own.asked(rules=[rule]))


def straight(kind: str) -> Task:
    """The tool of a UR5 moves away from the base, pointing down."""
    own = Setting("ur5", arm("ur5"), member_of(arm("ur5")), NEAR, FAR)
    begin, end = own.tool_at(0.0), own.tool_at(1.0)
    corners = np.array([begin.translation, end.translation])
    rule: Asked = {"kind": kind, "frame": own.tool}
    if kind == "line":
        rule |= {"start": corners[0].tolist(), "end": corners[1].tolist()}
        rule["radius"] = 0.005
    elif kind == "orientation":
        middle = pin.SE3.Interpolate(begin, end, 0.5).rotation
        turn = np.linalg.norm(pin.log3(middle.T @ end.rotation))
        rule |= {"rotation": middle.tolist(), "tolerance": float(turn) + 0.05}
    else:
        low, high = corners.min(axis=0) - 0.02, corners.max(axis=0) + 0.02
        rule |= {"lower": low.tolist(), "upper": high.tolist()}
    return task(own.asked(rules=[rule]))


TRAY = (-0.95776306, -1.19076644, 1.4913508, -1.87138069, 1.57079633, -0.61303327)
ACROSS = (0.61303327, -1.19076644, 1.4913508, -1.87138069, 1.57079633, -2.1838296)
CUP = (-0.7, -1.5, 1.7, -1.7708, -1.5708, 0.0)
BEYOND = (0.8, -1.5, 1.7, -1.7708, -1.5708, 0.0)
# Motions on the verge of slipping gain little from refining, in ten times the time.
ONCE = {"intervals": 40, "control": "linear", "effort": "quick", "refine": None}


def held(source: Source) -> Made:
    """Loads that are not fixed: on a tray, on a suction cup, between two fingers."""
    for level in (True, False):
        name = "level" if level else "tilting"
        yield f"tray, {name}", functools.partial(tray, level)
    for pull in (150.0, 90.0):
        yield f"carton, {pull:g} N", functools.partial(carton, pull)
    yield "carton, spline", functools.partial(carton, 150.0, control="spline")
    yield "grasp", grasp


def tray(level: bool) -> Task:
    """The example ``waiter``."""
    glass = {"mass": 0.3, "center": [0.0, 0.0, 0.08], "support": 0.035}
    held: list[Asked] = [{"kind": "stable", "frame": "tool0", "friction": 0.3, **glass}]
    if level:
        up = {"axis": [0.0, 0.0, 1.0], "direction": [0.0, 0.0, 1.0]}
        held.append({"kind": "upright", "frame": "tool0", "tolerance": 0.02, **up})
    load = {
        "mass": 0.7,
        "frame": "tool0",
        "com": [0.0, 0.0, (0.3 * 0.08 - 0.4 * 0.005) / 0.7],
        "shapes": [
            shape("cylinder", (0.14, 0.01), position=(0.0, 0.0, -0.005)),
            shape("cylinder", (0.035, 0.16), position=(0.0, 0.0, 0.08)),
        ],
    }
    own = arm("ur5", load=load)
    return task(asked(own, np.array(TRAY), joint(ACROSS), rules=held), **ONCE)


def carton(pull: float, **options: Any) -> Task:
    """The example ``suction_carton``."""
    inertia = (3.0 * 0.2**2 / 6.0 * np.eye(3)).tolist()
    middle = [0.0, 0.0, 0.1]
    load = {
        "mass": 3.0,
        "frame": "tool0",
        "com": middle,
        "inertia": inertia,
        "shapes": [shape("box", (0.2, 0.2, 0.2), position=(0.0, 0.0, 0.11))],
    }
    cup: Asked = {
        "kind": "stable",
        "frame": "tool0",
        "center": middle,
        "friction": 0.5,
        "support": 0.04,
        "mass": 3.0,
        "inertia": inertia,
        "adhesion": pull,
    }
    own = arm("ur5", load=load)
    case = asked(own, np.array(CUP), joint(BEYOND), rules=[cup])
    return task(case, **ONCE | options)


def grasp() -> Task:
    """A Panda carries a bottle between its fingers, which press with 40 N."""
    start = np.array([-0.6, -0.4, 0.0, -2.2, 0.0, 1.8, 0.785])
    end = np.array([0.8, 0.1, 0.0, -1.9, 0.0, 2.0, 0.785])
    load = {"mass": 0.8, "frame": "panda_hand_tcp", "com": [0.0, 0.0, 0.05]}
    fingers: Asked = {
        "kind": "grasp",
        "frame": "panda_hand_tcp",
        "force": 40.0,
        "friction": 0.4,
        "mass": 0.8,
        "center": [0.0, 0.0, 0.05],
        "axis": [0.0, 1.0, 0.0],
        "pad_radius": 0.01,
    }
    case = asked(arm("panda", load=load), start, joint(end), rules=[fingers])
    return task(case, **ONCE)


# -- controllers, energy, friction, several arms -----------------------------------


def clock(source: Source) -> Made:
    """On the clock of a controller, with the limits of data sheets."""
    for name, number in (("panda", 0), ("ur5", 0)):
        for period in (0.001, 0.004, 0.008):
            options = {"control_period": period}
            make = functools.partial(goal_task, name, number, options, sheet=True)
            yield f"{name} {1e3 * period:g} ms", make
    yield "segments 4 ms", ticking_segments


def ticking_segments() -> Task:
    """A via point and a stop, on a clock."""
    own = Setting.of("ur5", 1, sheet=True)
    legs: list[Asked] = [
        {"goal": joint(own.at(0.4))},
        {"goal": joint(own.at(0.7)), "stop": True, "dwell": 0.1},
        {"goal": joint(own.end)},
    ]
    case = asked(own.own, own.start, None, legs=legs)
    return task(case, control_period=0.004)


def limits(source: Source) -> Made:
    """Limits of accelerations, jerks and torque rates."""
    for name, number in (("panda", 0), ("panda", 2), ("ur5", 2), ("xarm7", 0)):
        make = functools.partial(goal_task, name, number, sheet=True)
        yield f"data sheet {name} {number}", make
    for kind, name, number in (
        ("acceleration", "kinova", 1),
        ("jerk", "ur5", 3),
        ("jerk", "planar3r", 1),
        ("effort_rate", "z1", 1),
        ("effort_rate", "panda", 4),
    ):
        make = functools.partial(limited, kind, name, number)
        yield f"{kind} {name} {number}", make


def limited(kind: str, name: str, number: int) -> Task:
    """An active limit for all joints."""
    own = Setting.of(name, number)
    way = float(np.max(np.abs(own.end - own.start)))
    most = {
        "acceleration": 3.5 * way / own.seconds**2,
        "jerk": 35.0 * way / own.seconds**3,
    }
    values = np.full(len(own.end), most.get(kind, 0.0))
    if kind == "effort_rate":
        values = 6.0 / own.seconds * np.array(own.own["effort"])
    return task(own.asked(**{kind: values.tolist()}))


def energy(source: Source) -> Made:
    """Energy in the objective, and quiet torques."""
    start = np.array([0.0, -1.2, 1.4, -1.8, -1.57, 0.0])
    end = np.array([2.0, -1.0, 0.6, -1.2, -1.57, 0.0])

    def make(slack: float | None = None, **options: Any) -> Task:
        measure = _roughness if slack is not None else _cost
        case = asked(arm("ur5"), start, joint(end))
        return task(case, slack=slack, measure=measure, **options)

    for weight in (1e-5, 1e-3):
        yield f"torques {weight:g}", functools.partial(make, energy_weight=weight)
    work = {"energy": "work", "energy_weight": 1e-3}
    yield "work 0.001", functools.partial(make, **work)
    for slack in (0.0, 0.01):
        yield f"quiet {slack:g}", functools.partial(make, slack)
    yield "quiet panda", functools.partial(_quiet, "panda", 2)


def _cost(solution: tm.Solution) -> float:
    return float(solution.cost)


def _roughness(solution: tm.Solution) -> float:
    return float(solution.roughness)


def _quiet(name: str, number: int) -> Task:
    more = {"slack": 0.003, "measure": _roughness}
    return goal_task(name, number, more, speed_factor=4.0)


def friction(source: Source) -> Made:
    """Dry friction as a share of the torque limits."""
    for name, number, share, options in (
        ("ur5", 0, 0.1, {}),
        ("kinova", 0, 0.05, {}),
        ("panda", 3, 0.1, {}),
        ("ur10", 4, 0.05, {"method": "collocation"}),
    ):
        make = functools.partial(goal_task, name, number, options, friction=share)
        yield f"{name} {number} {100 * share:g} %", make


def together(source: Source) -> Made:
    """Two arms in one cell."""
    yield "two UR5 exchange crates", crates
    for names, apart in ((("ur5", "panda"), 0.9), (("xarm7", "z1"), 0.8)):
        make = functools.partial(side_by_side, names, apart)
        yield " and ".join(names), make


def crates() -> Task:
    """The example ``two_ur5``."""
    left = np.array([0.2284, -1.35, 1.75, -1.971, -1.571, 0.0])
    right = np.array([-0.6208, -1.35, 1.75, -1.971, -1.571, 0.0])
    load = {
        "mass": 3.0,
        "frame": "tool0",
        "com": [0.0, 0.0, 0.09],
        "shapes": [shape("box", (0.16, 0.16, 0.16), position=(0.0, 0.0, 0.09))],
    }
    arms = [
        arm("ur5", load=load, base=(-0.51, 0.0, 0.0)),
        arm("ur5", load=load, base=(0.51, 0.0, 0.0), base_rpy=(0.0, 0.0, np.pi)),
    ]
    table = shape("box", (0.7, 1.2, 0.04), name="table", position=(0.0, 0.0, -0.03))
    ends = np.concatenate([left, left]), np.concatenate([right, right])
    more = {"obstacles": [table], "margin": 0.01}
    return task(asked(arms, ends[0], joint(ends[1]), **more))


def side_by_side(names: tuple[str, str], apart: float) -> Task:
    """Two arms, each with a random goal."""
    arms = [
        arm(name, base=(0.0, side * 0.5 * apart, 0.0))
        for name, side in zip(names, (-1.0, 1.0), strict=True)
    ]
    pairs = [ends(name)[GOALS[name][0]] for name in names]
    start, end = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return task(asked(arms, start, joint(start + 0.6 * (end - start)), margin=0.005))


# -- methods, options, warm starts -----------------------------------------------------


def methods(source: Source) -> Made:
    """Transcriptions and controls other than the automatic ones."""
    for name, number, options in (
        ("ur5", 0, {"method": "collocation"}),
        ("panda", 2, {"method": "collocation"}),
        ("planar3r", 0, {"method": "adjoint"}),
        ("planar3r", 2, {"method": "adjoint"}),
        ("kinova", 3, {"control": "linear"}),
        ("xarm7", 4, {"control": "spline"}),
    ):
        words = " ".join(options.values())
        make = functools.partial(goal_task, name, number, options)
        yield f"{words} {name} {number}", make
    for method in ("adjoint", "collocation", "penalty"):
        yield f"paper, {method}", functools.partial(paper, method)


def paper(method: str) -> Task:
    """The paper's example with its obstacle."""
    own = arm("planar3r")
    ball = shape("sphere", (0.8,), position=(4.0, 0.0, 0.0))
    goal = {"kind": "position", "frame": "tip", "position": [4.0, 1.0, 0.0]}
    case = asked(own, np.array([0.5, 1.7, -1.7]), goal, obstacles=[ball])
    options: dict[str, Any] = {
        "method": method,
        "intervals": 40,
        "grid": "uniform",
        "smoothing": 0.0,
        "starts": 1,
        "initial_duration": 1.0 if method == "collocation" else 1.5,
        "max_iterations": 300,
    }
    if method == "penalty":
        # The penalty method ends outside of the feasible set, which is to be compared.
        options["feasibility"] = 1e-3
    return task(case, **options)


def switching(source: Source) -> Made:
    """Exact times of switches."""
    for family, name in (
        ("pendulum", "pendulum, upright"),
        ("level", "rods"),
        ("vertical", "vertical rods"),
    ):
        yield name, functools.partial(optimum, family, name, refine="switching")
    options = {"refine": "switching"}
    yield "planar3r 1", functools.partial(goal_task, "planar3r", 1, options)


def choices(source: Source) -> Made:
    """Options that users set."""
    for words, name, number, options in (
        ("quick", "kinova", 0, {"effort": "quick"}),
        ("quick", "panda", 4, {"effort": "quick"}),
        ("feasible", "ur10", 1, {"objective": "feasible"}),
        ("starts", "ur5", 5, {"starts": 3}),
        ("no refinement", "planar3r", 0, {"refine": None}),
        ("grid", "z1", 1, {"refine": "grid"}),
        ("highs", "ur5", 1, {"lp_solver": "highs", "effort": "quick"}),
        ("thorough", "planar3r", 1, {"effort": "thorough"}),
        ("uniform", "panda", 3, {"grid": "uniform", "intervals": 60}),
    ):
        make = functools.partial(goal_task, name, number, options, speed_factor=2.0)
        yield f"{words} {name} {number}", make


def warm(source: Source) -> Made:
    """Plans with a warm start."""
    for name, number in (("ur5", 0), ("panda", 2), ("xarm7", 3)):
        make = functools.partial(warm_task, name, number)
        yield f"goal moved {name} {number}", make
    yield "obstacle ur5 2", functools.partial(warm_task, "ur5", 2, obstacle=True)
    yield "samples kinova 1", functools.partial(warm_task, "kinova", 1, samples=True)


def warm_task(
    name: str, number: int, *, obstacle: bool = False, samples: bool = False
) -> Task:
    """A slightly displaced goal, or an additional obstacle."""
    own = Setting.of(name, number)
    low, high = np.array(own.own["position"])
    end = np.clip(own.end + 0.05 * np.where(own.end > 0.0, -1.0, 1.0), low, high)
    things = []
    if obstacle:
        at = own.tool_at(0.5).translation
        things = [shape("sphere", (0.05,), position=at)]
    former = own.asked()

    def planned() -> tm.Solution:
        return tm.plan(build(former), effort="quick", refine=None)

    def slow() -> tm.Samples:
        return slow_samples(own)

    case = asked(own.own, own.start, joint(end), obstacles=things)
    return task(case, slow if samples else planned)


def slow_samples(own: Setting) -> tm.Samples:
    """A straight motion with smooth speeds that takes three times as long."""
    T = 3.0 * own.seconds
    t = np.linspace(0.0, T, 101)
    s = t / T
    way = own.end - own.start
    zero = np.zeros((len(t), len(way)))
    q = own.start + np.outer(s**3 * (10.0 - 15.0 * s + 6.0 * s**2), way)
    v = np.outer(30.0 * s**2 * (1.0 - s) ** 2 / T, way)
    a = np.outer(60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / T**2, way)
    return tm.Samples(tuple(own.own["joints"]), t, q, v, a, zero)


GROUPS: dict[str, Callable[[Source], Made]] = {
    "optima": optima,
    "goals": goals,
    "goals x 4": fast_goals,
    "clutter": clutter,
    "frame goals": frame_goals,
    "obstacles": obstacles,
    "moving": moving,
    "segments": segments,
    "rules": rules,
    "held loads": held,
    "clock": clock,
    "limits": limits,
    "energy": energy,
    "friction": friction,
    "two arms": together,
    "methods": methods,
    "switching": switching,
    "options": choices,
    "warm starts": warm,
}
# Groups that need the data of MotionBenchMaker.
WITH_DATA = {"clutter": "panda"}
