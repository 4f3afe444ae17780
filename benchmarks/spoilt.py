"""Motions spoilt on purpose, and the verdicts of all judges on them.

    python -m benchmarks.spoilt                  # all, compared with stored verdicts
    python -m benchmarks.spoilt --every 5        # some of them
    python -m benchmarks.spoilt --accept         # store the verdicts anew

A few motions of small arms are planned, and two hundred variants are made of them, each
with a single fault of about 0.1, 1 or 10 %: a limit is lowered below the values of the
motion, an obstacle grows or is placed where the arm passes between two samples, a load,
a friction or a time differs from that of the problem, torques or positions are changed.
Each is given to ``verify``, ``certify``, ``prove_clearance`` and ``check_export``.
Their verdicts are stored in ``tests/spoilt_verdicts.csv``, where the column ``missed``
names the judges that should have detected the fault, and did not: faults beyond the
documented tolerances must be detected. Some of the variants are tests
(``tests/test_spoilt_motions.py``).
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import one_thread

one_thread()

import argparse
import csv
import functools
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import tominpmp as tm

Array = NDArray[np.float64]
STORED = Path(__file__).resolve().parents[1] / "tests" / "spoilt_verdicts.csv"
JUDGES = ("verify", "certify", "prove", "export")
COLUMNS = ("motion", "kind", "amount", *JUDGES, "excess", "missed")
AMOUNTS = (0.001, 0.01, 0.1)
# Tolerances: shares of limits, distances from goals [rad or m], predicted gains.
LIMIT, GOAL, PROMISE = 5e-3, 1e-3, 1e-2
# Relative difference of excesses that counts as agreement.
SAME = 0.05
INSTANTS = 20001
# Length of the intervals of piecewise constant torques [s].
STEP = 4e-3
OK = "ok"
ACCEPT = "python -m benchmarks.spoilt --accept"


@dataclass(frozen=True)
class Spoilt:
    """A motion with a single fault.

    Attributes:
        motion: Name of the original motion.
        kind: Kind of the fault.
        amount: Size of the fault: a share, or [m], [rad] or [s].
        solution: The solution, with its problem or trajectory changed.
        finders: Judges that must detect the fault.
    """

    motion: str
    kind: str
    amount: float
    solution: tm.Solution
    finders: tuple[str, ...]

    @property
    def name(self) -> tuple[str, str, str]:
        """Key of the motion in the file of verdicts."""
        return self.motion, self.kind, f"{self.amount:g}"

    @property
    def trajectory(self) -> tm.Trajectory:
        """The motion."""
        assert self.solution.trajectory is not None
        return self.solution.trajectory


# -- the original motions --------------------------------------------------------------

START, GOAL_Q = (0.5, 1.7, -1.7), (1.6, 0.4, -0.6)
# Start velocity that makes joints reverse [rad/s].
AWAY = (-1.5, 1.5, 2.0)
CONTROLS = ("constant", "linear", "spline", "collocation")


@functools.cache
def arm(**changes: float) -> tm.Robot:
    """The planar arm, limited by its torques, or by other limits."""
    robot = tm.load_robot("planar3r").with_changes(velocity=100.0)
    return robot.with_changes(**changes) if changes else robot


def planned(problem: tm.Problem, **options: Any) -> tm.Solution:
    """A correct motion.

    Raises:
        RuntimeError: If no motion is found.
    """
    # Without a time limit, as the motions must not depend on the load of the machine.
    quick = {"effort": "quick", "intervals": 40, "refine": None}
    solution = tm.plan(problem, **quick | {"max_planning_time": math.inf} | options)
    verified = solution.verification
    if not solution.success or verified is None or not verified.ok:
        raise RuntimeError(f"no motion to be spoilt: {solution.message}")
    return solution


def controlled(name: str) -> dict[str, Any]:
    """Options of a kind of control."""
    if name == "collocation":
        return {"method": "collocation"}
    return {"control": name}


@functools.cache
def free(control: str) -> tm.Solution:
    """Torques are the active limits, joints reverse."""
    problem = tm.Problem(arm(), START, tm.JointGoal(GOAL_Q), v_start=AWAY)
    return planned(problem, **controlled(control))


@functools.cache
def fast(control: str) -> tm.Solution:
    """Speeds are the active limits."""
    problem = tm.Problem(arm(velocity=2.5), START, tm.JointGoal(GOAL_Q))
    return planned(problem, **controlled(control))


@functools.cache
def limited(kind: str) -> tm.Solution:
    """A limit of accelerations, jerks or torque rates is active."""
    values = {"acceleration": 20.0, "jerk": 300.0, "effort_rate": 600.0}
    limits = tm.MotionLimits(**{kind: values[kind]})
    goal = tm.JointGoal(GOAL_Q)
    return planned(tm.Problem(arm(), START, goal, motion_limits=limits))


@functools.cache
def ruled(kind: str) -> tm.Solution:
    """A constraint on the tool is active."""
    rule, more = rules(kind, 1.0), {}
    if kind == "orientation":
        more["v_start"] = AWAY  # turns farther during the motion than at both ends
    goal = tm.JointGoal(GOAL_Q)
    return planned(tm.Problem(arm(), START, goal, constraints=(rule,), **more))


def rules(kind: str, upper: float) -> tm.PathConstraint:
    """A constraint on the tool.

    Args:
        kind: Its kind.
        upper: Factor on its limit.
    """
    if kind == "tool speed":
        return tm.ToolSpeed("tip", 4.0 * upper)
    if kind == "tool acceleration":
        return tm.ToolAcceleration("tip", 60.0 * upper)
    if kind == "orientation":
        return tm.KeepOrientation("tip", TURNED, tolerance=1.5 * upper)
    return tm.JointCoupling(("joint1", "joint2"), (1.0, 1.0), upper=2.25 * upper)


# Half way between the orientations of start and goal.
TURNED = np.array([0.0, 0.0, math.sin(0.475), math.cos(0.475)])


def motion_at(solution: tm.Solution, share: float = 0.5) -> Array:
    """Position of the tool at a share of the time, shape (3,)."""
    motion = solution.trajectory
    assert motion is not None
    return tool_places(solution.problem.robot, motion(share * motion.duration).q[None])[
        0
    ]


def tool_places(robot: tm.Robot, q: Array) -> Array:
    """Positions of the tool, by Pinocchio alone, shape (m, 3)."""
    model = robot.model
    data, frame = model.createData(), model.getFrameId("tip")
    found = []
    for row in q:
        pin.framesForwardKinematics(model, data, row)
        found.append(data.oMf[frame].translation.copy())
    return np.array(found)


BALL, MARGIN = 0.2, 0.05


@functools.cache
def beside(moving: bool) -> tm.Solution:
    """Past a fixed or moving ball."""
    place = motion_at(fast("constant"), 0.5) + np.array([0.0, 0.15, 0.0])
    more: dict[str, Any] = {}
    if moving:
        velocity = np.array([0.4, -0.4, 0.0])
        more["motion"] = tm.ConstantVelocity(velocity)
        place = place - 0.6 * velocity
    ball = tm.Sphere("ball", radius=BALL, position=place, **more)
    goal = tm.JointGoal(GOAL_Q)
    return planned(tm.Problem(arm(), START, goal, [ball], margin=MARGIN))


@functools.cache
def rubbing(share: float) -> tm.Solution:
    """Joints with dry friction, a share of the torque limits."""
    robot = arm()
    robot = robot.with_changes(friction=share * robot.limits.effort_upper)
    return planned(tm.Problem(robot, START, tm.JointGoal(GOAL_Q), v_start=AWAY))


DWELL, LATEST, LOAD = 0.2, 4.0, 0.3


@functools.cache
def by_way() -> tm.Solution:
    """An intermediate stop, and a load after it."""
    return planned(way(DWELL, LOAD, None))


@functools.cache
def waiting() -> tm.Solution:
    """The same with an earliest time of arrival."""
    return planned(way(DWELL, LOAD, (2.0, LATEST)))


def way(dwell: float, mass: float, arrival: tuple[float, float] | None) -> tm.Problem:
    """A problem of two segments."""
    load = tm.Payload(mass, "tip")
    first = tm.Segment(tm.JointGoal((1.0, 1.0, -1.0)), dwell=dwell, arrival=arrival)
    last = tm.Segment(tm.JointGoal(GOAL_Q), payload=load)
    return tm.Problem(arm(), START, segments=[first, last])


# -- faults ----------------------------------------------------------------------------


Maker = Callable[[], Spoilt]


def everything() -> Iterator[Maker]:
    """Functions that make all spoilt motions."""
    of_control = (
        lower_position,
        lower_speed,
        lower_effort,
        wrong_load,
        added_friction,
        scaled_torque,
        node_aside,
    )
    for control in CONTROLS:
        stretched = (quicker, slower) if control != "collocation" else ()
        for spoil in (*of_control, *stretched):
            yield from _each(spoil, control, AMOUNTS)
        for spoil in (other_goal, other_start):
            yield from _each(spoil, control, (5e-4, 1.5e-3, 1e-2, 1e-1))
    for kind in ("acceleration", "jerk", "effort_rate"):
        yield from _each(lower_motion_limit, kind, AMOUNTS)
    for kind in ("tool speed", "tool acceleration", "orientation"):
        yield from _each(narrower_rule, kind, AMOUNTS)
    # A larger change would violate it at the start.
    yield from _each(narrower_rule, "coupling", (0.001, 0.01, 0.02))
    for moving in (False, True):
        for spoil in (larger_ball, larger_margin):
            yield from _each(spoil, moving, (2e-4, 1e-3, 1e-2))
    for control in CONTROLS:
        yield from _each(touch_between_samples, control, (2e-4, 1e-3, 2e-3))
        yield functools.partial(bullet, control)
    for control in ("constant", "spline"):
        yield from _each(late_torque, control, (1e-3, 4e-3, 1e-2))
    for amount in AMOUNTS:
        for spoil in (wrong_friction, longer_dwell, later_arrival, load_of_segment):
            yield functools.partial(spoil, amount)


def label(make: Maker) -> str:
    """A short name of a function that makes a spoilt motion."""
    assert isinstance(make, functools.partial)
    return "-".join([make.func.__name__, *map(str, make.args)])


def _each(
    spoil: Callable[[Any, float], Spoilt], what: object, amounts: Sequence[float]
) -> Iterator[Maker]:
    for amount in amounts:
        yield functools.partial(spoil, what, amount)


def quick() -> Iterator[Maker]:
    """The part for a test: motions that are planned and judged quickly."""
    part = functools.partial
    for control in ("constant", "collocation"):
        for spoil in (lower_position, lower_speed, lower_effort, other_goal):
            yield part(spoil, control, 0.01)
        for spoil in (wrong_load, added_friction, node_aside):
            yield part(spoil, control, 0.01)
        yield part(touch_between_samples, control, 1e-3)
    yield part(bullet, "collocation")
    for spoil in (lower_position, lower_speed, lower_effort):
        yield from _each(spoil, "constant", (0.001, 0.1))
    yield part(other_goal, "collocation", 5e-4)
    for spoil in (quicker, slower):
        yield part(spoil, "constant", 0.1)
    yield part(scaled_torque, "constant", 0.01)
    for kind in ("acceleration", "jerk", "effort_rate"):
        yield part(lower_motion_limit, kind, 0.01)
    for kind in ("tool speed", "tool acceleration"):
        yield part(narrower_rule, kind, 0.01)
    for spoil in (larger_ball, larger_margin):
        yield part(spoil, False, 2e-4)
    for spoil in (longer_dwell, load_of_segment):
        yield part(spoil, 0.01)


def times_of(motion: tm.Trajectory) -> Array:
    """Closely spaced instants of a motion, shape (m,) [s]."""
    return np.linspace(0.0, motion.duration, INSTANTS)


def with_problem(solution: tm.Solution, **changes: Any) -> tm.Solution:
    """The same motion for another problem."""
    problem = replace(solution.problem, **changes)
    return replace(solution, problem=problem, verification=None)


def with_motion(solution: tm.Solution, motion: tm.Trajectory) -> tm.Solution:
    """Another motion for the same problem."""
    return replace(solution, trajectory=motion, verification=None)


def finders(amount: float, tolerance: float = LIMIT) -> tuple[str, ...]:
    """Judges that must detect an excess beyond the tolerances: those of limits."""
    return ("verify", "certify", "export") if amount > tolerance else ()


def lower_position(control: str, amount: float) -> Spoilt:
    """A position limit below the reversal of a joint, by a share of its range."""
    solution = free(control)
    motion, robot = solution.trajectory, solution.problem.robot
    assert motion is not None
    q = motion(times_of(motion)).q
    inner = q.max(axis=0) - np.maximum(q[0], q[-1])
    joint = int(np.argmax(inner))
    upper, lower = np.array(robot.limits.position_upper), robot.limits.position_lower
    top = float(q[:, joint].max())
    upper[joint] = (top + amount * lower[joint]) / (1.0 + amount)
    upper[joint] = max(upper[joint], q[[0, -1], joint].max() + 1e-9)
    changed = with_problem(solution, robot=robot.with_changes(position_upper=upper))
    beyond = (top - upper[joint]) / (upper[joint] - lower[joint])
    return Spoilt(control, "position limit", amount, changed, finders(beyond))


def lower_speed(control: str, amount: float) -> Spoilt:
    """A speed limit below the largest speed of a joint."""
    solution = fast(control)
    motion, robot = solution.trajectory, solution.problem.robot
    assert motion is not None
    speed = np.abs(motion(times_of(motion)).v).max(axis=0)
    limits = np.array(robot.limits.velocity)
    joint = int(np.argmax(speed / limits))
    limits[joint] = speed[joint] / (1.0 + amount)
    changed = with_problem(solution, robot=robot.with_changes(velocity=limits))
    return Spoilt(control, "speed limit", amount, changed, finders(amount))


def lower_effort(control: str, amount: float) -> Spoilt:
    """A torque limit below the largest torque of a motor, by a share of its range."""
    solution = free(control)
    motion, robot = solution.trajectory, solution.problem.robot
    assert motion is not None
    torque = np.abs(motion(times_of(motion)).u).max(axis=0)
    limits = np.array(robot.limits.effort_upper)
    joint = int(np.argmax(torque / limits))
    limits[joint] = torque[joint] / (1.0 + 2.0 * amount)
    changed = with_problem(solution, robot=robot.with_changes(effort=limits))
    return Spoilt(control, "torque limit", amount, changed, finders(amount))


def lower_motion_limit(kind: str, amount: float) -> Spoilt:
    """A limit of accelerations, jerks or torque rates below the largest value."""
    solution = limited(kind)
    motion, limits = solution.trajectory, solution.problem.motion_limits
    assert motion is not None and limits is not None
    times = times_of(motion)
    state = motion(times)
    values = state.u if kind == "effort_rate" else state.a
    if kind != "acceleration":
        # Rates are means over a millisecond.
        step = int(np.ceil(1e-3 / times[1]))
        values = (values[step:] - values[:-step]) / (times[step] - times[0])
    top = np.abs(values).max(axis=0)
    limit = np.full(top.size, float(getattr(limits, kind)))
    joint = int(np.argmax(top / limit))
    limit[joint] = top[joint] / (1.0 + amount)
    lower = tm.MotionLimits(**{kind: limit})
    changed = with_problem(solution, motion_limits=lower)
    return Spoilt("limited", kind.replace("_", " "), amount, changed, finders(amount))


def narrower_rule(kind: str, amount: float) -> Spoilt:
    """A constraint on the tool that is tighter than the motion."""
    solution = ruled(kind)
    motion = solution.trajectory
    assert motion is not None
    share = taken(kind, solution.problem.robot, motion)
    rule = rules(kind, share / (1.0 + amount))
    changed = with_problem(solution, constraints=(rule,))
    return Spoilt("ruled", kind, amount, changed, finders(amount))


def taken(kind: str, robot: tm.Robot, motion: tm.Trajectory) -> float:
    """Largest value of a constraint on the tool, as a share of its limit."""
    state = motion(times_of(motion)[::5])
    if kind == "coupling":
        return float((state.q[:, 0] + state.q[:, 1]).max()) / 2.25
    if kind == "orientation":
        turn = state.q.sum(axis=1)
        return float(np.abs(turn - 2.0 * 0.475).max()) / 1.5
    model = robot.model
    data, frame = model.createData(), model.getFrameId("tip")
    axes, found = pin.LOCAL_WORLD_ALIGNED, []
    for q, v, a in zip(state.q, state.v, state.a, strict=True):
        pin.forwardKinematics(model, data, q, v, a)
        pin.updateFramePlacements(model, data)
        if kind == "tool speed":
            value = pin.getFrameVelocity(model, data, frame, axes)
        else:
            value = pin.getFrameClassicalAcceleration(model, data, frame, axes)
        found.append(np.linalg.norm(value.linear))
    return float(np.max(found)) / (4.0 if kind == "tool speed" else 60.0)


def larger_ball(moving: bool, amount: float) -> Spoilt:
    """An obstacle that reaches into the margin [m]."""
    solution = beside(moving)
    (ball,) = solution.problem.scene.obstacles
    grown = replace(ball, radius=BALL + amount + _room(solution))
    changed = with_problem(solution, scene=tm.Scene([grown]))
    return Spoilt(_standing(moving), "obstacle", amount, changed, _of_clearance())


def larger_margin(moving: bool, amount: float) -> Spoilt:
    """A margin that the motion violates [m]."""
    solution = beside(moving)
    changed = with_problem(solution, margin=MARGIN + amount + _room(solution))
    return Spoilt(_standing(moving), "margin", amount, changed, _of_clearance())


def _of_clearance() -> tuple[str, ...]:
    return ("verify", "certify", "prove", "export")


def _standing(moving: bool) -> str:
    return "moving ball" if moving else "ball"


@functools.cache
def _room(solution: tm.Solution) -> float:
    """Clearance beyond the margin at a ball, by distances of line segments [m]."""
    motion = solution.trajectory
    assert motion is not None
    (ball,) = solution.problem.scene.obstacles
    times = times_of(motion)[::5]
    places = np.broadcast_to(ball.position, (times.size, 3))
    if ball.motion is not None:
        places = places + times[:, None] * np.asarray(ball.motion.velocity)
    away = distances(solution.problem.robot, motion(times).q, places)
    return float(away.min()) - THICK - BALL - MARGIN


THICK = 1e-3  # radius of the links [m]


def distances(robot: tm.Robot, q: Array, places: Array) -> Array:
    """Distances of the lines of the links to points, shape (m,)."""
    model = robot.model
    data, tip = model.createData(), model.getFrameId("tip")
    found = []
    for row, point in zip(q, places, strict=True):
        pin.framesForwardKinematics(model, data, row)
        joints = [data.oMi[k].translation for k in (1, 2, 3)]
        corners = np.array([*joints, data.oMf[tip].translation])
        first, ways = corners[:-1], np.diff(corners, axis=0)
        share = np.einsum("ij,ij->i", point - first, ways)
        share = np.clip(share / np.einsum("ij,ij->i", ways, ways), 0.0, 1.0)
        away = np.linalg.norm(first + share[:, None] * ways - point, axis=1)
        found.append(away.min())
    return np.array(found)


def touch_between_samples(control: str, amount: float) -> Spoilt:
    """A small ball that the end of the arm grazes between two milliseconds [m].

    The amount is the least penetration.
    """
    solution = free(control)
    motion, robot = solution.trajectory, solution.problem.robot
    assert motion is not None
    times = times_of(motion)
    places = tool_places(robot, motion(times).q)
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / times[1]
    fastest = float(times[int(np.argmax(speeds))])
    between = (math.floor(1e3 * fastest) + 0.5) * 1e-3
    q = motion(between).q
    place = tool_places(robot, q[None])[0]
    outward = (place - _elbow(robot, q)) / np.linalg.norm(place - _elbow(robot, q))
    radius = 2e-3
    centre = place + (radius + THICK - amount) * outward
    thorn = tm.Sphere("thorn", radius=radius, position=centre)
    changed = with_problem(solution, scene=tm.Scene([thorn]))
    return Spoilt(control, "touch between samples", amount, changed, _of_clearance())


def bullet(control: str) -> Spoilt:
    """A ball of 4 mm that crosses a link at 40 m/s, between two milliseconds."""
    solution = free(control)
    motion, robot = solution.trajectory, solution.problem.robot
    assert motion is not None
    between = (math.floor(5e2 * motion.duration) + 0.5) * 1e-3
    q = motion(between).q
    middle = 0.5 * (tool_places(robot, q[None])[0] + _elbow(robot, q))
    velocity = np.array([0.0, 0.0, 40.0])
    start = middle - between * velocity
    flight = tm.ConstantVelocity(velocity)
    ball = tm.Sphere("bullet", radius=4e-3, position=start, motion=flight)
    changed = with_problem(solution, scene=tm.Scene([ball]))
    return Spoilt(control, "bullet", 0.004, changed, _of_clearance())


def _elbow(robot: tm.Robot, q: Array) -> Array:
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return np.array(data.oMi[3].translation)


def wrong_load(control: str, amount: float) -> Spoilt:
    """A load of a share of the mass of the arm that the torques do not include."""
    solution = free(control)
    robot = solution.problem.robot
    mass = amount * sum(inertia.mass for inertia in list(robot.model.inertias)[1:])
    loaded = robot.with_payload(tm.Payload(mass, "tip"))
    changed = with_problem(solution, robot=loaded)
    return Spoilt(control, "load", amount, changed, finders(amount))


def node_aside(control: str, amount: float) -> Spoilt:
    """One node whose position differs from the effect of the torques [rad]."""
    solution = free(control)
    motion = solution.trajectory
    assert motion is not None
    q = np.array(motion.q)
    q[q.shape[0] // 2, 1] += amount
    changed = with_motion(solution, replace(motion, q=q))
    # The replay of given torques does not use positions; the check of a file does.
    found = ("export",) if control == "collocation" else ("verify", "export")
    return Spoilt(control, "node", amount, changed, found if amount > LIMIT else ())


def added_friction(control: str, amount: float) -> Spoilt:
    """Dry friction, a share of the torque limits, that the torques do not include."""
    solution = free(control)
    robot = solution.problem.robot
    rough = robot.with_changes(friction=amount * robot.limits.effort_upper)
    changed = with_problem(solution, robot=rough)
    return Spoilt(control, "friction", amount, changed, finders(amount))


def wrong_friction(amount: float) -> Spoilt:
    """Torques with dry friction of the wrong sign."""
    solution = rubbing(amount)
    motion, robot = solution.trajectory, solution.problem.robot
    assert motion is not None
    spoilt = given(motion, lambda t, u: u - 2.0 * robot.friction * np.sign(motion(t).v))
    changed = with_motion(solution, spoilt)
    return Spoilt("rubbing", "sign of friction", amount, changed, finders(amount))


def given(motion: tm.Trajectory, torque: Callable[[Array, Array], Array]) -> Any:
    """A motion with the same positions and given torques.

    Args:
        motion: The motion.
        torque: Torques in the middle of intervals, of times and torques of the motion.
    """
    t = np.unique(np.concatenate([motion.t, np.arange(0.0, motion.duration, STEP)]))
    state, middle = motion(t), np.append(0.5 * (t[1:] + t[:-1]), t[-1])
    u = torque(middle, motion(middle).u)
    return tm.Trajectory(motion.joint_names, t, state.q, state.v, u)


def scaled_torque(control: str, amount: float) -> Spoilt:
    """Torques that are larger by a share."""
    solution = free(control)
    motion = solution.trajectory
    assert motion is not None
    spoilt = given(motion, lambda t, u: (1.0 + amount) * u)
    changed = with_motion(solution, spoilt)
    return Spoilt(control, "torques", amount, changed, finders(amount))


def late_torque(control: str, amount: float) -> Spoilt:
    """Delayed torques [s]."""
    solution = free(control)
    motion = solution.trajectory
    assert motion is not None
    spoilt = given(motion, lambda t, u: motion(np.maximum(t - amount, 0.0)).u)
    changed = with_motion(solution, spoilt)
    return Spoilt(control, "late torques", amount, changed, finders(1.0))


def quicker(control: str, amount: float) -> Spoilt:
    """The same path in less time, with the required torques."""
    return _stretched(control, "quicker", amount, 1.0 / (1.0 + amount))


def slower(control: str, amount: float) -> Spoilt:
    """The same path in more time: feasible, but not time-optimal."""
    return _stretched(control, "slower", amount, 1.0 + amount)


def _stretched(control: str, kind: str, amount: float, factor: float) -> Spoilt:
    """A motion in another time; its problem has the resulting start velocity."""
    solution = free(control)
    motion, robot = solution.trajectory, solution.problem.robot
    assert motion is not None
    t, v, state = motion.t * factor, motion.v / factor, motion(motion.t)
    dynamics = Rigid(robot)
    spoilt = tm.Trajectory(
        motion.joint_names,
        t,
        motion.q,
        v,
        dynamics(motion.q, v, state.a / factor**2),
        a=None if motion.a is None else motion.a / factor**2,
        inverse_dynamics=dynamics,
    )
    begun = tuple(float(x) / factor for x in AWAY)
    changed = with_problem(with_motion(solution, spoilt), v_start=begun)
    if kind == "slower":
        found = ("certify",) if amount > 2.0 * PROMISE else ()
    else:
        found = finders(amount)
    return Spoilt(control, kind, amount, changed, found)


class Rigid:
    """Torques of the arm by Pinocchio, as a function of rows."""

    def __init__(self, robot: tm.Robot) -> None:
        self._model, self._damping = robot.model, robot.damping

    def __call__(self, q: Array, v: Array, a: Array) -> Array:
        """Torques, all of shape (m, n)."""
        data = self._model.createData()
        rows = [
            pin.rnea(self._model, data, *row).copy()
            for row in zip(q, v, a, strict=True)
        ]
        return np.array(rows) + self._damping * v


def other_goal(control: str, amount: float) -> Spoilt:
    """A goal that is slightly missed [rad]."""
    solution = free(control)
    goal = tm.JointGoal(np.array(GOAL_Q) + amount * np.array([1.0, 0.0, 0.0]))
    changed = with_problem(solution, goal=goal)
    return Spoilt(control, "goal", amount, changed, finders(amount, GOAL))


def other_start(control: str, amount: float) -> Spoilt:
    """A start that differs from the beginning of the motion [rad]."""
    solution = free(control)
    start = np.array(START) + amount * np.array([0.0, 1.0, 0.0])
    changed = with_problem(solution, q_start=start)
    return Spoilt(control, "start", amount, changed, finders(amount, GOAL))


def longer_dwell(amount: float) -> Spoilt:
    """A dwell that is too short, by a share."""
    solution = by_way()
    wanted = way(DWELL * (1.0 + amount), LOAD, None)
    changed = replace(solution, problem=wanted, verification=None)
    return Spoilt("by way", "dwell", amount, changed, finders(amount))


def later_arrival(amount: float) -> Spoilt:
    """An arrival that is too early, by a share."""
    solution = waiting()
    wanted = way(DWELL, LOAD, (2.0 * (1.0 + amount), LATEST))
    changed = replace(solution, problem=wanted, verification=None)
    return Spoilt("waiting", "arrival", amount, changed, finders(amount))


def load_of_segment(amount: float) -> Spoilt:
    """A load that is heavier by a share than the load assumed by the torques."""
    solution = by_way()
    wanted = way(DWELL, LOAD * (1.0 + amount), None)
    changed = replace(solution, problem=wanted, verification=None)
    return Spoilt("by way", "load of a segment", amount, changed, finders(amount))


# -- verdicts --------------------------------------------------------------------------


def verdicts(spoilt: Spoilt) -> dict[str, str]:
    """A row: the verdicts of the judges."""
    solution, motion = spoilt.solution, spoilt.trajectory
    row = dict(zip(COLUMNS, spoilt.name, strict=False))
    verification = None
    try:
        verification = tm.verify(solution.problem, motion)
        row["verify"] = _kinds(verification.violations)
        row["excess"] = _largest(verification.violations)
    except tm.TominpmpError as error:
        row |= {"verify": type(error).__name__, "excess": ""}
    row["certify"] = _asked(lambda: _certified(solution, motion, verification))
    row["prove"] = _asked(lambda: _proved(solution))
    row["export"] = _asked(lambda: _exported(solution))
    missed = [judge for judge in spoilt.finders if row[judge] == OK]
    return row | {"missed": " ".join(missed)}


def _asked(judge: Callable[[], str]) -> str:
    try:
        return judge()
    except tm.TominpmpError as error:
        return type(error).__name__


def _kinds(violations: Sequence[Any]) -> str:
    return ", ".join(sorted({item.kind for item in violations})) or OK


def _largest(violations: Sequence[Any]) -> str:
    shares = [item.share for item in violations]
    return f"{max(shares):.4g}" if shares else ""


def _certified(
    solution: tm.Solution, motion: tm.Trajectory, verification: tm.Verification | None
) -> str:
    found = tm.certify(solution.problem, motion, verification=verification)
    return OK if found.ok else "refused"


def _proved(solution: tm.Solution) -> str:
    found = solution.prove_clearance()
    if found.proved:
        return OK
    return "contact" if found.contact else "open"


def _exported(solution: tm.Solution) -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = solution.export(Path(folder) / "motion.csv", verify=False)
        found = tm.check_export(solution, path)
    return OK if found.ok else _kinds(found.violations)


def read(path: Path = STORED) -> dict[tuple[str, ...], dict[str, str]]:
    """Stored verdicts by name; none if there is no file."""
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {(row["motion"], row["kind"], row["amount"]): row for row in rows}


def write(rows: Sequence[Mapping[str, str]], path: Path = STORED) -> None:
    """Store verdicts."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def differences(row: Mapping[str, str], known: Mapping[str, str] | None) -> list[str]:
    """Differences of a verdict from the stored one, a clause each.

    Args:
        row: The verdict.
        known: The stored verdict; None if there is no stored one.
    """
    if known is None:
        return ["is not stored"]
    found = [
        f"{name}: {known[name]} -> {row[name]}"
        for name in (*JUDGES, "missed")
        if known[name] != row[name]
    ]
    a, b = (float(x["excess"] or "nan") for x in (known, row))
    if math.isnan(a) != math.isnan(b) or abs(b - a) > SAME * abs(a):
        found.append(f"excess: {known['excess']} -> {row['excess']}")
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge, report differences and missed faults; 1 if a verdict differs."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.spoilt",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--every", type=int, default=1, help="one of so many")
    parser.add_argument("--accept", action="store_true", help="store the verdicts")
    given = parser.parse_args(arguments)
    if given.accept and given.every != 1:
        parser.error("--accept stores all, without --every")
    known, rows, different = read(), [], 0
    for number, make in enumerate(everything()):
        if number % given.every:
            continue
        spoilt = make()
        row = verdicts(spoilt)
        rows.append(row)
        lines = differences(row, known.get(spoilt.name))
        different += bool(lines)
        if lines or row["missed"]:
            words = [*lines, f"missed by {row['missed']}" if row["missed"] else ""]
            print(" | ".join([*spoilt.name, *filter(None, words)]), flush=True)
    print(f"{len(rows)} spoilt motions, {different} verdicts differ")
    if given.accept:
        write(rows)
        return 0
    return int(bool(different))


if __name__ == "__main__":
    raise SystemExit(main())
