"""The fresh half of the golden set: problems not used for tuning.

All problems except the clutter are drawn anew from a seed, which is chosen for each
comparison; both commits get the same draw. A motion exists by construction, without
the planner: obstacles are clear of a path, by exact distances, and combinations are
built around a slow motion that satisfies all requirements.
"""

from __future__ import annotations

import functools
import tempfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import tominpmp as tm
from benchmarks.cell_arms import Member, inverse
from benchmarks.exact_geometry import Array
from benchmarks.golden_cases import (
    GOALS,
    TOOL,
    Made,
    Source,
    clutter_task,
    ends,
)
from benchmarks.golden_judge import RULES, Asked, Leg, Rooms, judge, read_arm, shape
from benchmarks.golden_problems import (
    LOCKED,
    Task,
    arm,
    asked,
    joint,
    member_of,
    placement,
    task,
)
from benchmarks.judging import read_request
from benchmarks.motionbenchmaker import SCENES, Case

# Numbers of the problems that are not used for tuning; how many are drawn for a Fetch.
VALIDATION, FETCHED = range(21, 41), 3
ARMS = ("kinova", "xarm7", "z1", "iiwa14")
SCENES_OF_ARM, COMBINATIONS = 5, 16
TOOLS = {**TOOL, "iiwa14": "flange"}
# Least distances of a path from shapes, and of links from each other [m] (links of some
# arms are always close to neighbours); margin [m]; configurations of a path; draws.
RESERVE, APART, MARGIN, SAMPLES, DRAWS = 0.02, 0.004, 0.005, 40, 300
OBSTACLES = 7
# Usable shares of the torque at rest, and during the slow motion.
HOLDS, SLOW = 0.66, 0.8

# Published numbers of the KUKA LBR iiwa 14: heights of the joints and of the centres of
# mass with the arm stretched upwards [m], masses [kg], limits [deg, deg/s, N m].
HEIGHTS = (0.1525, 0.36, 0.5825, 0.78, 0.9825, 1.18, 1.245)
CENTRES = (0.2545, 0.424, 0.6905, 0.866, 1.0585, 1.196, 1.2706)
MASSES = (6.404, 7.89, 2.54, 4.82, 1.76, 2.5, 0.42)
ANGLES = (170, 120, 170, 120, 170, 120, 175)
SPEEDS = (85, 85, 100, 75, 130, 135, 135)
EFFORTS = (320, 320, 176, 176, 110, 40, 40)
FLANGE, THICKNESS = 1.306, (0.075, 0.07, 0.07, 0.065, 0.06, 0.05, 0.04)


@functools.cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    """A folder that is deleted at the end of this process."""
    return tempfile.TemporaryDirectory()


@functools.cache
def iiwa14() -> str:
    """A KUKA LBR iiwa 14 of cylinders; the path of its description."""
    parts = [_link("link0", 5.0, 0.07, 0.15, 0.09)]
    below, parent = 0.0, "link0"
    tops = (*HEIGHTS[1:], FLANGE)
    rows = zip(HEIGHTS, CENTRES, MASSES, ANGLES, SPEEDS, EFFORTS, tops, strict=True)
    for number, (height, centre, mass, angle, speed, effort, top) in enumerate(rows):
        name = f"link{number + 1}"
        axis = "0 1 0" if number % 2 else "0 0 1"
        length = max(top - height - 0.02, 0.04)
        parts.append(_link(name, mass, centre - height, length, THICKNESS[number]))
        parts.append(
            f'<joint name="joint{number + 1}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{name}"/><origin xyz="0 0 {height - below}"/>'
            f'<axis xyz="{axis}"/><limit lower="{-np.deg2rad(angle)}" '
            f'upper="{np.deg2rad(angle)}" velocity="{np.deg2rad(speed)}" '
            f'effort="{effort}"/></joint>'
        )
        below, parent = height, name
    parts.append(
        '<link name="flange"/><joint name="flange_joint" type="fixed">'
        f'<parent link="{parent}"/><child link="flange"/>'
        f'<origin xyz="0 0 {FLANGE - below}"/></joint>'
    )
    path = Path(_folder().name) / "iiwa14.urdf"
    path.write_text(f'<robot name="iiwa14">{"".join(parts)}</robot>', encoding="utf-8")
    return str(path)


def _link(name: str, mass: float, centre: float, length: float, radius: float) -> str:
    """A link with a cylinder of uniform density that begins at its joint."""
    across = mass * (3.0 * radius**2 + length**2) / 12.0
    tensor = f'ixx="{across}" iyy="{across}" izz="{0.5 * mass * radius**2}"'
    return (
        f'<link name="{name}"><inertial><origin xyz="0 0 {centre}"/>'
        f'<mass value="{mass}"/><inertia {tensor} ixy="0" ixz="0" iyz="0"/></inertial>'
        f'<collision><origin xyz="0 0 {0.5 * length}"/><geometry>'
        f'<cylinder radius="{radius}" length="{length}"/></geometry></collision></link>'
    )


def source_of(name: str) -> str:
    """Argument of ``load_robot`` for an arm."""
    return iiwa14() if name == "iiwa14" else name


def goals(source: Source) -> Made:
    """Random goals of all arms, with their speeds and with four times those."""
    for name in GOALS:
        for factor in (1.0, 4.0):
            make = functools.partial(fresh_goal, source.seed, name, factor)
            yield f"{name} x {factor:g}", make


def fresh_goal(seed: int, name: str, factor: float) -> Task:
    """The first random goal of a seed at whose ends links are apart."""
    own = arm(name, speed_factor=factor)
    member = member_of(own)
    rooms = Rooms({"obstacles": [], "margin": 0.0}, [member], 0.0)
    salted = seed + int(1000 * factor)
    for pair in ends(name, 40, salted):
        if _room(rooms, np.array(pair)) >= APART:
            return task(asked(own, pair[0], joint(pair[1])))
    raise RuntimeError(f"no free goal of {name} was found")


def _room(rooms: Rooms, q: Array) -> float:
    """Least distance at some configurations [m]."""
    if not rooms.watched:
        return np.inf
    return rooms.at(np.zeros(len(q))).closest(q).distance


def clutter(source: Source) -> Made:
    """MotionBenchMaker: the problems not used for tuning."""
    folder = source.folder("panda")
    if folder is None:
        return
    for scene in SCENES:
        for number in VALIDATION:
            case = Case(scene, number, folder)
            if case.request_path.exists():
                make = functools.partial(clutter_task, case)
                yield f"{scene} {number}", make


def fetch(source: Source) -> Made:
    """MotionBenchMaker: a Fetch, some problems of each scene."""
    folder = source.folder("fetch")
    if folder is None:
        return
    rng = np.random.default_rng(source.seed)
    for scene in SCENES:
        numbers = rng.choice(np.arange(1, 21), FETCHED, replace=False)
        for number in sorted(int(one) for one in numbers):
            case = Case(scene, number, folder)
            yield f"{scene} {number}", functools.partial(fetch_task, case)


def fetch_task(case: Case) -> Task:
    """A problem of the Fetch, read by the library and once more for the judge."""
    urdf = case.folder / "fetch.urdf"
    own = arm(str(urdf), locked={})
    request = read_request(case.request_path)
    start, goal = (
        np.array([values[name] for name in own["joints"]])
        for values in (request.start, request.goal)
    )
    things = moveit_shapes(case.scene_path)
    asked_for = asked(own, start, joint(goal), obstacles=things)
    robot = tm.load_robot(urdf)
    problem = tm.load_moveit(robot, case.scene_path, case.request_path)
    return Task(problem, lambda found: judge(asked_for, found), asked_for)


def moveit_shapes(path: Path) -> list[Asked]:
    """Shapes of a MoveIt planning scene as plain data."""
    scene = yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)
    found = []
    for item in scene["world"]["collision_objects"]:
        pairs = zip(item["primitives"], item["primitive_poses"], strict=True)
        for number, (solid, pose) in enumerate(pairs):
            size = [float(x) for x in solid["dimensions"]]
            if solid["type"] == "cylinder":
                size = size[::-1]
            place = {"position": pose["position"], "rotation": pose["orientation"]}
            name = f"{item['id']} {number}"
            found.append(shape(solid["type"], size, name=name, **place))
    return found


# -- scenes around a path ----------------------------------------------------------


def scenes(source: Source) -> Made:
    """Random scenes that leave room for a path."""
    for name in ARMS:
        for number in range(SCENES_OF_ARM):
            make = functools.partial(scene_task, source.seed, name, number)
            yield f"{name} {number}", make


def _rng(*words: object) -> np.random.Generator:
    return np.random.default_rng([zlib.crc32(str(word).encode()) for word in words])


def _configurations(
    rng: np.random.Generator, own: Asked, member: Member, load: Any = None
) -> Iterator[Array]:
    """Endless random configurations that motors can hold, away from limits."""
    low, high = np.array(own["position"])
    low, high = np.maximum(low, -np.pi), np.minimum(high, np.pi)
    middle, half = 0.5 * (low + high), 0.45 * (high - low)
    carrying = member if load is None else read_arm(own, own["gravity"], load)
    effort = np.array(own["effort"])
    while True:
        q = middle + half * rng.uniform(-1.0, 1.0, len(low))
        if _holds(carrying, q[None], effort):
            yield q


def _holds(member: Member, q: Array, effort: Array) -> bool:
    zero = np.zeros_like(q)
    needed = np.abs(inverse([member], q, zero, zero))
    return bool(np.all(needed <= HOLDS * effort - member.friction))


def _path(
    rng: np.random.Generator, own: Asked, member: Member
) -> tuple[Array, Callable[[Array], Array]]:
    """A path via a third configuration, without self-collision."""
    rooms = Rooms({"obstacles": [], "margin": 0.0}, [member], 0.0)
    drawn = _configurations(rng, own, member)
    effort = np.array(own["effort"])
    s = np.linspace(0.0, 1.0, SAMPLES)
    for _ in range(DRAWS):
        a, m, b = (next(drawn) for _ in range(3))
        m = 0.5 * (a + b) + 0.5 * (m - 0.5 * (a + b))

        def at(s: Array, a: Array = a, m: Array = m, b: Array = b) -> Array:
            s = np.asarray(s)[:, None]
            return np.asarray((1 - s) ** 2 * a + 2 * s * (1 - s) * m + s**2 * b)

        q = at(s)
        if _holds(member, q, effort) and _room(rooms, q) >= APART:
            return q, at
    raise RuntimeError("no free path was found")


def scene_task(seed: int, name: str, number: int) -> Task:
    """An arm among shapes that are clear of a path, some of them only just."""
    rng = _rng("scene", seed, name, number)
    own = arm(source_of(name), locked=LOCKED.get(name, {}))
    member = member_of(own)
    path, at = _path(rng, own, member)
    things: list[Asked] = []
    for _ in range(DRAWS):
        if len(things) == OBSTACLES:
            break
        thing = _thing(rng, member, at, TOOLS[name], len(things))
        alone = {"obstacles": [thing], "margin": MARGIN, "self_collision": False}
        rooms = Rooms(alone, [member], 0.0)
        if _room(rooms, path) >= RESERVE:
            things.append(thing)
    case = asked(own, path[0], joint(path[-1]), obstacles=things, margin=MARGIN)
    return task(case)


def _thing(
    rng: np.random.Generator,
    member: Member,
    at: Callable[[Array], Array],
    tool: str,
    number: int,
) -> Asked:
    """A shape next to the path of the tool."""
    q = at(np.array([rng.uniform(0.1, 0.9)]))[0]
    aside = rng.normal(size=3)
    aside *= rng.uniform(0.05, 0.35) / np.linalg.norm(aside)
    kind = str(rng.choice(["sphere", "box", "cylinder", "capsule"]))
    width = rng.uniform(0.02, 0.1)
    size = {
        "sphere": [width],
        "box": rng.uniform(0.05, 0.4, 3).tolist(),
        "cylinder": [width, rng.uniform(0.1, 0.6)],
        "capsule": [width, rng.uniform(0.1, 0.6)],
    }[kind]
    turn = rng.normal(size=4)
    where = placement(member, q, tool).translation + aside
    place = {"position": where, "rotation": turn / np.linalg.norm(turn)}
    return shape(kind, size, name=f"thing{number}", **place)


# -- combinations around a slow motion ---------------------------------------------


def combinations(source: Source) -> Made:
    """Segments, loads, grasps, friction and times of arrival in random combinations."""
    for number in range(COMBINATIONS):
        make = functools.partial(combined_task, source.seed, number)
        yield f"combination {number}", make


def combined_task(seed: int, number: int) -> Task:
    """A random combination, feasible for a slow motion that stops at every goal."""
    return task(combined_case(seed, number)[0])


def combined_case(seed: int, number: int) -> tuple[Asked, float]:
    """Specification of a random combination, and duration of its slow motion [s]."""
    rng = _rng("combination", seed, number)
    name = str(rng.choice(["panda", "ur5", "xarm7", "iiwa14"]))
    friction = float(rng.choice([0.0, 0.05, 0.1]))
    source, locked = source_of(name), LOCKED.get(name, {})
    # Arms given by name have data sheets.
    own = arm(source, locked=locked, sheet=source == name, friction=friction)
    member = member_of(own)
    mass = float(rng.uniform(0.3, 1.5))
    load = {"mass": mass, "frame": TOOLS[name], "com": [0.0, 0.0, 0.03]}
    count = int(rng.integers(2, 5))
    goals = _apart(rng, own, member, load, count + 1)
    legs: list[Asked] = []
    clock = 0.0
    for k in range(count):
        leg: Asked = {"goal": joint(goals[k + 1])}
        if rng.random() < 0.6:
            leg["load"] = load
            if rng.random() < 0.5:
                leg["rules"] = [_grasp(mass, TOOLS[name])]
        last = k == count - 1
        if not last and rng.random() < 0.4:
            leg |= {"stop": True, "dwell": float(rng.choice([0.0, 0.1]))}
        clock += _slow_time(own, leg, goals[k], goals[k + 1])
        if rng.random() < 0.3:
            earliest = float(clock * rng.uniform(0.4, 1.0))
            leg["arrival"] = [earliest, float(rng.choice([np.inf, 1.2 * clock]))]
        clock += leg.get("dwell", 0.0)
        legs.append(leg)
    return asked(own, goals[0], None, legs=legs), clock


def _apart(
    rng: np.random.Generator, own: Asked, member: Member, load: Asked, count: int
) -> list[Array]:
    """Goals with straight lines between them without self-collision, with the load."""
    rooms = Rooms({"obstacles": [], "margin": 0.0}, [member], 0.0)
    carrying = read_arm(own, own["gravity"], load)
    drawn, effort = _configurations(rng, own, member, load), np.array(own["effort"])
    # No path leads out of a self-collision.
    found = [next(q for q in drawn if _room(rooms, q[None]) >= APART)]
    s = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    for _ in range(DRAWS):
        q = found[-1] + s * rng.uniform(0.3, 0.8) * (next(drawn) - found[-1])
        if _holds(carrying, q, effort) and _room(rooms, q) >= APART:
            found.append(q[-1])
            if len(found) == count:
                return found
    raise RuntimeError("no ways between goals were found")


def _grasp(mass: float, frame: str) -> Asked:
    """Two fingers that hold a load at rest with at most 0.6 of their grip."""
    radius, lever, friction = 0.02, 0.03, 0.5
    worst = mass * 9.81 * np.hypot(1.0, lever / radius)
    return {
        "kind": "grasp",
        "frame": frame,
        "force": float(worst / (0.6 * 2.0 * friction)),
        "friction": friction,
        "mass": mass,
        "center": [0.0, 0.0, lever],
        "axis": [0.0, 1.0, 0.0],
        "pad_radius": radius,
    }


def _slow_time(own: Asked, leg: Asked, start: Array, end: Array) -> float:
    """Duration of a straight motion from rest to rest that keeps all limits [s]."""
    member = read_arm(own, own["gravity"], leg.get("load"))
    s = np.linspace(0.0, 1.0, SAMPLES)
    way = end - start
    q = start + np.outer(s**3 * (10.0 - 15.0 * s + 6.0 * s**2), way)
    T = float(np.max(1.875 * np.abs(way) / np.array(own["velocity"])))
    for _ in range(100):
        v = np.outer(30.0 * s**2 * (1.0 - s) ** 2 / T, way)
        a = np.outer(60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / T**2, way)
        torque = inverse([member], q, v, a)
        rates = {
            "acceleration": a,
            "jerk": np.outer(60.0 * (1.0 - 6.0 * s + 6.0 * s**2) / T**3, way),
            "effort_rate": np.gradient(torque, s * T, axis=0),
        }
        needed = np.abs(torque) + member.friction
        fits = bool(np.all(needed <= SLOW * np.array(own["effort"]))) and all(
            np.all(np.abs(rates[name]) <= np.array(most))
            for name, most in own["limits"].items()
        )
        if fits and all(
            _kept(own, leg, rule, q, v, a) for rule in leg.get("rules", ())
        ):
            return T
        T *= 1.15
    raise RuntimeError("no slow motion was found")


def _kept(own: Asked, leg: Asked, rule: Asked, q: Array, v: Array, a: Array) -> bool:
    """Whether a grasp holds a load on a motion."""
    member = read_arm(own, own["gravity"], leg.get("load"))
    judged = Leg.__new__(Leg)
    judged.case, judged.members = {"gravity": own["gravity"]}, [member]
    return bool(RULES[rule["kind"]](judged, rule, q, v, a)[0] <= -0.1)


GROUPS: dict[str, Callable[[Source], Made]] = {
    "goals": goals,
    "clutter": clutter,
    "fetch": fetch,
    "scenes": scenes,
    "combinations": combinations,
}
WITH_DATA = {"clutter": "panda", "fetch": "fetch"}
