"""Judging motions of the golden set without the library's verification.

The specification is plain data, as in ``cell_cases.py``, with further keys (see
:func:`judge`). A motion is divided at the ends of its segments, and each part is
checked by ``cell_judge.py`` with its load: torques of the movement, their replay,
limits, the goal, exact distances. This module adds goals other than joints and
positions, torque rates, tool constraints, held loads, and times of segments.
"""

from __future__ import annotations

import dataclasses
import itertools
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pinocchio as pin

from benchmarks.cell_arms import Member, inverse, read_member
from benchmarks.cell_clearance import Cell, read_obstacle
from benchmarks.cell_dynamics import STANDING, Plant
from benchmarks.cell_judge import FEEDBACK, GOAL, LIMIT, SPEED, TIME_STEP, Judge
from benchmarks.cell_movement import Movement, read_movement
from benchmarks.exact_geometry import Array, Body
from benchmarks.random_cells import write_motion

Asked = dict[str, Any]
# Tolerance of the times of segments [s].
INSTANT = 1e-6
# Half of the tolerated violation of a margin [m]; reference for excesses over regions
# and sums of joints [m or rad].
PLACE, REACH = 1e-5, 0.1
# Number of instants between samples at which small distances are measured.
CLOSE, FINER = 2e-3, 121


@dataclass(frozen=True)
class Verdict:
    """Findings on one motion.

    Attributes:
        excess: Largest excess over a limit, relative to the limit; negative if the
            motion is within all limits.
        clearance: Least distance beyond the margin [m]; infinite without pairs.
        faults: Reasons that refute the motion, in short sentences.
    """

    excess: float
    clearance: float
    faults: tuple[str, ...]


def read_arm(item: Mapping[str, Any], gravity: Sequence[float], load: Any) -> Member:
    """Build an arm, with a load of any inertia and shapes.

    Args:
        item: The arm as :func:`~benchmarks.cell_arms.read_member` reads it; its
            position limits may be given.
        gravity: Gravity in the world [m/s^2].
        load: Its load on this segment in addition to its own payload; or None.
    """
    loads = [x for x in (item.get("payload"), load) if x]
    member = read_member({**item, "payload": None}, gravity)
    arm, model = member.arm, member.arm.model
    links, disabled = list(arm.links), set(arm.disabled)
    for carried in loads:
        frame = model.frames[model.getFrameId(carried["frame"])]
        lever = np.array(carried.get("com", np.zeros(3)), dtype=float)
        inertia = np.array(carried.get("inertia", np.zeros((3, 3))), dtype=float)
        body = pin.Inertia(carried["mass"], lever, inertia)
        model.appendBodyToJoint(frame.parentJoint, body, frame.placement)
        for shape in carried.get("shapes", ()):
            solid, _ = read_obstacle({"velocity": np.zeros(3), **shape})
            place = frame.placement * solid.placement
            links.append(Body("payload", frame.parentJoint, solid.shape, place))
        near = {frame.parentJoint, model.parents[frame.parentJoint]}
        # The link that holds a load touches it, and so may its neighbours.
        disabled |= {frozenset((b.name, "payload")) for b in links if b.joint in near}
    if item.get("position") is not None:
        for joint in list(model.joints)[1:]:
            if joint.nq == 1:
                low, high = (row[joint.idx_v] for row in item["position"])
                model.lowerPositionLimit[joint.idx_q] = low
                model.upperPositionLimit[joint.idx_q] = high
    exact = dataclasses.replace(arm, links=tuple(links), disabled=frozenset(disabled))
    return dataclasses.replace(member, arm=exact)


class Rooms(Cell):
    """Distances of a cell, except those of pairs that may touch."""

    def __init__(self, asked: Asked, members: Sequence[Member], begin: float) -> None:
        self._may_touch = {frozenset(pair) for pair in asked.get("may_touch", ())}
        self._own = asked.get("self_collision", True)
        obstacles = [read_obstacle(item) for item in asked["obstacles"]]
        # Moving obstacles have the positions of the beginning of the segment.
        placed = [
            (
                dataclasses.replace(
                    body,
                    placement=pin.SE3(
                        body.placement.rotation,
                        body.placement.translation + begin * velocity,
                    ),
                ),
                velocity,
            )
            for body, velocity in obstacles
        ]
        super().__init__(members, placed, asked["margin"])

    def _matters(self, i: int, j: int) -> bool:
        if self._owner[i] == self._owner[j] and not self._own:
            return False
        names = frozenset((self._bodies[i].name, self._bodies[j].name))
        return names not in self._may_touch and super()._matters(i, j)

    @property
    def watched(self) -> int:
        """Number of checked pairs."""
        return len(self._pairs)


class Turning(Plant):
    """Arms whose slow joints may reverse by rounding, as dry friction holds them."""

    def dry(
        self, p: int, s: Array, state: tuple[Array, Array, Array], u: Array
    ) -> Array:
        """Dry friction at shares s of a piece."""
        found, slow = super().dry(p, s, state, u), np.abs(state[1]) < STANDING
        if not np.any(slow & (self.friction > 0.0)):
            return found
        left = u - inverse(self.members, *state)
        held = np.clip(left, -self.friction, self.friction)
        return np.where(slow, held, found)


class Leg(Judge):
    """The judge of one segment.

    Args:
        asked: The specification, including that of the segment.
        movement: Its part of the motion, from time 0.
        begin: Time at which it begins [s].
        last: Whether it is the last segment.
    """

    def __init__(
        self, asked: Asked, movement: Movement, begin: float, last: bool
    ) -> None:
        self.case, self.movement, self.begin, self.last = asked, movement, begin, last
        load, carrier = asked.get("load"), asked.get("carrier", 0)
        self.members = [
            read_arm(item, asked["gravity"], load if number == carrier else None)
            for number, item in enumerate(asked["arms"])
        ]
        self.faults = []
        self.figures = {"T": float(movement.t[-1])}
        models = [member.arm.model for member in self.members]
        self.low, self.high = np.hstack([m.position_limits() for m in self.members])
        self.speed = np.concatenate([model.velocityLimit for model in models])
        self.effort = np.concatenate([model.effortLimit for model in models])
        self.plant = Turning(self.members, movement)

    def limits_and_torques(self) -> None:
        """Limits of every judge, torque rates, and the rules."""
        super().limits_and_torques()
        if self.case.get("effort_rate") is not None:
            excess = self._steepest() - 1.0
            self.figures["effort_rate_excess"] = excess
            self.check(excess <= LIMIT, f"torque rate off by {excess:.2e}")
        move, s = self.movement, np.linspace(0.0, 1.0, 21)
        for rule in self.case["rules"]:
            worst, most = -np.inf, 0.0
            for k in move.pieces:
                q, v, a, _ = move.state(k, s)
                excess, most = RULES[rule["kind"]](self, rule, q, v, a)
                worst = max(worst, excess)
            name = f"{rule['kind']}_excess"
            self.figures[name] = max(self.figures.get(name, -np.inf), worst)
            self.check(worst <= most, f"{rule['kind']} off by {worst:.2e}")

    def _steepest(self) -> float:
        """Largest torque rate over a millisecond, as a share of its limit.

        Dry friction is left out, as it jumps where a joint reverses, which no torque
        with a finite rate can follow.
        """
        move, s = self.movement, np.linspace(0.0, 1.0, 21)
        times, motors = [], []
        for k in move.pieces:
            state, u = move.state(k, s)[:3], move.torque(k, s)
            begin, end = move.breaks[k], move.breaks[k + 1]
            times.append(begin + s * (end - begin))
            motors.append(u - self.plant.dry(k, s, state, u))
        t, u = np.concatenate(times), np.concatenate(motors)
        later = np.minimum(t + TIME_STEP, t[-1])
        after = np.array([np.interp(later, t, column) for column in u.T]).T
        rates = np.abs(after - u) / TIME_STEP
        return float(np.max(rates / np.array(self.case["effort_rate"])))

    def replay(self) -> tuple[Array, Array, Array]:
        """Replay of the torques; without feedback if they do not follow the nodes.

        Given torques that are constant on long intervals deviate from the cubics
        between the nodes, and feedback would pull the motion back to the cubics.
        """
        found = super().replay()
        if not self.movement.held or self.figures["feedback"] <= FEEDBACK:
            return found
        self.faults = [text for text in self.faults if "feedback" not in text]
        with mock.patch("benchmarks.cell_judge.RATE", 0.0):
            return super().replay()

    def place(self, frame: str, q: Array) -> pin.SE3:
        """Pose of a frame in the world; "1/tool0" is a frame of the second arm."""
        number, _, own_name = frame.rpartition("/")
        arm = int(number or 0)
        member = self.members[arm]
        begin = sum(other.n for other in self.members[:arm])
        model, data = member.arm.model, member.arm.model.createData()
        own = member.configuration(q[begin : begin + member.n])
        pin.framesForwardKinematics(model, data, own)
        return member.base * data.oMf[model.getFrameId(own_name)]

    def goal(self, q: Array, v: Array) -> None:
        """End of the replay, after its dwell."""
        goal = self.case["goal"]
        miss = self.miss(goal, q)
        self.figures["goal_error"] = miss
        self.check(miss <= GOAL, f"goal missed by {miss:.1e}")
        if not (self.last or self.case.get("stop") or goal.get("v") is not None):
            return
        wanted = np.zeros_like(v) if goal.get("v") is None else np.array(goal["v"])
        speed = float(np.abs(v - wanted).max())
        self.figures["goal_speed"] = speed
        self.check(speed <= SPEED, f"{speed:.1e} too fast at the goal")

    def miss(self, goal: Mapping[str, Any], q: Array) -> float:
        """Distance of a configuration from a goal [rad or m]."""
        kind = goal["kind"]
        if kind == "any":
            return min(self.miss(one, q) for one in goal["goals"])
        if kind == "all":
            return max(self.miss(one, q) for one in goal["goals"])
        if kind == "joint":
            off = np.abs(q - np.array(goal["q"]))
            # Joints without limits are angles: any number of whole turns is accepted.
            turned = np.abs(off - 2.0 * np.pi * np.round(off / (2.0 * np.pi)))
            off = np.where(np.isinf(self.high), turned, off)
            return float(np.max(off - np.array(goal.get("tolerance", 0.0))))
        place = self.place(goal["frame"], q)
        off = 0.0
        if goal.get("position") is not None:
            off = float(np.linalg.norm(place.translation - np.array(goal["position"])))
        if goal.get("rotation") is not None:
            turn = pin.log3(np.array(goal["rotation"]).T @ place.rotation)
            off = max(off, float(np.linalg.norm(turn)))
        if goal.get("lower") is not None:
            low, high = np.array(goal["lower"]), np.array(goal["upper"])
            x = place.translation
            off = max(off, float(np.max(np.maximum(x - high, low - x))))
        if goal.get("axis") is not None:
            off = max(off, _angle(place.rotation @ goal["axis"], goal["direction"]))
        return off

    def clearance(self, t: Array, q: Array) -> None:
        """Exact distances every millisecond, and more densely where they are small."""
        cell = Rooms(self.case, self.members, self.begin)
        if not cell.watched:
            return
        keep = np.concatenate([[True], np.diff(t) > 1e-9])
        t, q = t[keep], q[keep]
        found = cell.at(t).closest(q)
        if found.distance <= CLOSE:
            first, last = max(found.sample - 3, 0), min(found.sample + 3, len(t) - 1)
            near = np.linspace(t[first], t[last], FINER)
            dense = np.array([np.interp(near, t, column) for column in q.T]).T
            closer = cell.at(near).closest(dense)
            found = min(found, closer, key=lambda one: one.distance)
        self.figures["clearance"] = float(found.distance)
        # The margin may be violated by 0.02 mm, but no bodies may touch.
        least = -2.0 * PLACE if self.case["margin"] > PLACE else 0.0
        text = f"room of {found.distance * 1e3:.4f} mm between {found.first}"
        self.check(found.distance > least, f"{text} and {found.second}")


def _angle(one: Any, other: Any) -> float:
    """The angle between two directions [rad]."""
    a, b = np.array(one, dtype=float), np.array(other, dtype=float)
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


# -- rules: constraints at all times ---------------------------------------------------

# A function of a judge, a rule and states at some instants, which returns the excess
# and the tolerated excess.
Measure = Callable[[Leg, Mapping[str, Any], Array, Array, Array], tuple[float, float]]


def _frame_states(
    leg: Leg, frame: str, q: Array, v: Array, a: Array
) -> list[tuple[pin.SE3, pin.Motion, pin.Motion]]:
    """Placements, velocities and classical accelerations of a frame, world axes."""
    (member,) = leg.members
    model, data = member.arm.model, member.arm.model.createData()
    number, axes = model.getFrameId(frame), pin.LOCAL_WORLD_ALIGNED
    found = []
    for row in zip(q, v, a, strict=True):
        own = member.configuration(row[0])
        pin.forwardKinematics(model, data, own, row[1], row[2])
        pin.updateFramePlacements(model, data)
        velocity = pin.getFrameVelocity(model, data, number, axes)
        classical = pin.getFrameClassicalAcceleration(model, data, number, axes)
        found.append((data.oMf[number].copy(), velocity, classical))
    return found


def _relative(values: Any, limit: float) -> tuple[float, float]:
    return float(np.max(values)) / limit - 1.0, LIMIT


def _tool_speed(leg: Leg, rule: Any, q: Array, v: Array, a: Array) -> Any:
    states = _frame_states(leg, rule["frame"], q, v, a)
    return _relative([np.linalg.norm(s[1].linear) for s in states], rule["limit"])


def _tool_acceleration(leg: Leg, rule: Any, q: Array, v: Array, a: Array) -> Any:
    states = _frame_states(leg, rule["frame"], q, v, a)
    return _relative([np.linalg.norm(s[2].linear) for s in states], rule["limit"])


def _upright(leg: Leg, rule: Any, q: Array, v: Array, a: Array) -> Any:
    turned = [leg.place(rule["frame"], x).rotation @ rule["axis"] for x in q]
    angles = [_angle(axis, rule["direction"]) for axis in turned]
    return _relative(angles, rule["tolerance"])


def _orientation(leg: Leg, rule: Any, q: Array, v: Array, a: Array) -> Any:
    wanted = np.array(rule["rotation"]).T
    turns = [pin.log3(wanted @ leg.place(rule["frame"], x).rotation) for x in q]
    return _relative([np.linalg.norm(turn) for turn in turns], rule["tolerance"])


def _points(leg: Leg, rule: Any, q: Array) -> Array:
    return np.array([leg.place(rule["frame"], x).translation for x in q])


def _line(leg: Leg, rule: Any, q: Array, v: Array, a: Array) -> Any:
    start, end = np.array(rule["start"]), np.array(rule["end"])
    way = end - start
    points = _points(leg, rule, q)
    share = np.clip((points - start) @ way / (way @ way), 0.0, 1.0)
    away = np.linalg.norm(points - start - share[:, None] * way, axis=1)
    return _relative(away, rule["radius"])


def _region(leg: Leg, rule: Any, q: Array, v: Array, a: Array) -> Any:
    x, low, high = _points(leg, rule, q), np.array(rule["lower"]), rule["upper"]
    return float(np.max(np.maximum(x - np.array(high), low - x))) / REACH, LIMIT


def _keep_away(leg: Leg, rule: Any, q: Array, v: Array, a: Array) -> Any:
    away = np.linalg.norm(_points(leg, rule, q) - rule["point"], axis=1)
    return 1.0 - float(away.min()) / rule["distance"], LIMIT


def _coupling(leg: Leg, rule: Any, q: Array, v: Array, a: Array) -> Any:
    total = q[:, rule["columns"]] @ np.array(rule["weights"])
    beyond = np.maximum(total - rule["upper"], rule["lower"] - total)
    return float(beyond.max()) / REACH, LIMIT


def _wrenches(leg: Leg, rule: Any, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Forces and moments that accelerate a load, about the frame, in its axes."""
    gravity = np.array(leg.case["gravity"], dtype=float)
    inertia = np.array(rule.get("inertia") or np.zeros((3, 3)))
    centre, forces, moments = np.array(rule["center"], dtype=float), [], []
    for place, velocity, classical in _frame_states(leg, rule["frame"], q, v, a):
        turn = place.rotation.T
        w, alpha = turn @ velocity.angular, turn @ classical.angular
        pull = turn @ (classical.linear - gravity)
        pull = pull + np.cross(alpha, centre) + np.cross(w, np.cross(w, centre))
        force = rule["mass"] * pull
        forces.append(force)
        own = inertia @ alpha + np.cross(w, inertia @ w)
        moments.append(np.cross(centre, force) + own)
    return np.array(forces), np.array(moments)


def _stable(leg: Leg, rule: Any, q: Array, v: Array, a: Array) -> Any:
    force, moment = _wrenches(leg, rule, q, v, a)
    press = force[:, 2] + rule.get("adhesion", 0.0)
    weight = 9.81 * rule["mass"]
    slip = np.hypot(force[:, 0], force[:, 1]) - rule["friction"] * press
    tip = np.hypot(moment[:, 0], moment[:, 1]) / rule["support"] - press
    return float(max(slip.max(), tip.max()) / weight), LIMIT


def _grasp(leg: Leg, rule: Any, q: Array, v: Array, a: Array) -> Any:
    force, moment = _wrenches(leg, rule, q, v, a)
    axis = np.array(rule["axis"], dtype=float)
    along = force @ axis
    across = np.linalg.norm(force - along[:, None] * axis, axis=1)
    most = 2.0 * rule["friction"] * rule["force"]
    share = np.hypot(across / most, (moment @ axis) / (most * rule["pad_radius"]))
    return _relative(share, 1.0)


RULES: dict[str, Measure] = {
    "tool_speed": _tool_speed,
    "tool_acceleration": _tool_acceleration,
    "upright": _upright,
    "orientation": _orientation,
    "line": _line,
    "region": _region,
    "keep_away": _keep_away,
    "coupling": _coupling,
    "stable": _stable,
    "grasp": _grasp,
}


# -- the whole motion ------------------------------------------------------------------


def judge(asked: Asked, solution: Any) -> Verdict:
    """Judge a motion.

    Args:
        asked: As a case of ``cell_cases.py``, with ``legs`` in place of a goal: each a
            dictionary with ``goal`` and optionally ``load``, ``rules``, ``obstacles``,
            ``may_touch``, ``acceleration``, ``stop``, ``dwell`` and ``arrival``. Beside
            them ``rules`` for all, ``effort_rate``, ``self_collision`` and ``period``.
        solution: The solution, whose segments are used.
    """
    faults: list[str] = []
    figures: dict[str, float] = {}
    friction = np.concatenate([np.array(arm["friction"]) for arm in asked["arms"]])
    legs, parts = asked["legs"], solution.segments
    for number, (leg, part) in enumerate(zip(legs, parts, strict=True)):
        movement = _movement(part.trajectory, friction)
        own = {**asked, **leg, "rules": [*asked["rules"], *leg.get("rules", ())]}
        if number:
            own |= {"q_start": movement.q[0], "v_start": movement.v[0]}
        found = Leg(own, movement, part.begin, number == len(legs) - 1)
        found.run()
        name = f"segment {number + 1}: " if len(legs) > 1 else ""
        faults += [name + text for text in found.faults]
        faults += [name + text for text in _times(leg, part, movement)]
        for key, value in found.figures.items():
            pick = min if key == "clearance" else max
            figures[key] = pick(figures.get(key, value), value)
    faults += _joints(parts) + _ticks(asked.get("period"), solution.trajectory)
    excess = max(
        value
        for name, value in figures.items()
        if name.endswith("_excess") and name != "torque_excess"
    )
    return Verdict(excess, figures.get("clearance", np.inf), tuple(faults))


def _movement(trajectory: Any, friction: Array) -> Movement:
    """The motion, written to a file and read without the library."""
    robot = SimpleNamespace(friction=friction)
    part = SimpleNamespace(trajectory=trajectory, problem=SimpleNamespace(robot=robot))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "motion.npz"
        write_motion(part, path)
        return read_movement(path)


def _times(leg: Mapping[str, Any], part: Any, movement: Movement) -> list[str]:
    """Faults of the arrival at a goal, and of the dwell there."""
    found = []
    dwell = leg.get("dwell", 0.0)
    if dwell:
        inside = movement.t >= movement.t[-1] - dwell + INSTANT
        fastest = float(np.abs(movement.v[inside]).max())
        if fastest > SPEED:
            found.append(f"moves at {fastest:.1e} while it should stay")
        where = int(np.argmin(np.abs(movement.t - (movement.t[-1] - dwell))))
        off = float(np.abs(movement.q[where] - movement.q[-1]).max())
        if off > GOAL:
            found.append(f"moves by {off:.1e} while it should stay")
    arrived = part.begin + movement.t[-1] - dwell
    earliest, latest = leg.get("arrival") or (0.0, np.inf)
    if not earliest - INSTANT <= arrived <= latest + INSTANT:
        found.append(f"arrives at {arrived:.6f} s")
    return found


def _joints(parts: Sequence[Any]) -> list[str]:
    """Whether the motion is continuous from segment to segment."""
    found = []
    for one, other in itertools.pairwise(parts):
        a, b = one.trajectory, other.trajectory
        off = max(np.abs(a.q[-1] - b.q[0]).max(), np.abs(a.v[-1] - b.v[0]).max())
        if off > INSTANT or abs(one.end - other.begin) > INSTANT:
            found.append(f"segments are {off:.1e} apart")
    return found


def _ticks(period: float | None, trajectory: Any) -> list[str]:
    """Whether all nodes are multiples of the period of a controller."""
    if period is None:
        return []
    off = float(np.abs(trajectory.t / period - np.round(trajectory.t / period)).max())
    return [f"nodes are off the clock by {off:.1e}"] if off > INSTANT else []


def shape(kind: str, size: Sequence[float], **place: Any) -> Asked:
    """A shape as plain data, by default at the origin."""
    return {
        "name": place.get("name", kind),
        "shape": kind,
        "size": [float(x) for x in size],
        "position": [float(x) for x in place.get("position", np.zeros(3))],
        "rotation": [float(x) for x in place.get("rotation", (0.0, 0.0, 0.0, 1.0))],
        "velocity": [float(x) for x in place.get("velocity", np.zeros(3))],
    }
