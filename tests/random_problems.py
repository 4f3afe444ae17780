"""Random arms and problems for property tests.

Arms have 1 to 9 joints of any kind about tilted axes, any inertia, friction, and limits
that need neither include zero nor be equal; each link may have a ball for collisions.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import tominpmp as tm

Array = NDArray[np.float64]

KINDS = ("revolute", "continuous", "prismatic")
GOALS = ("joint", "position", "pose", "axis", "region", "joint region", "any", "all")
# Names of the joints, in order.
NAMES = tuple(f"j{i}" for i in range(9))


@dataclass(frozen=True)
class Body:
    """A link with the joint that carries it; all arrays in the frame of the joint."""

    kind: str
    axis: Array
    origin: pin.SE3
    inertia: pin.Inertia
    lower: float
    upper: float
    velocity: float
    effort: tuple[float, float]
    damping: float
    armature: float
    ball: tuple[Array, float] | None = None


@dataclass(frozen=True)
class Arm:
    """Bodies one after another, with the frame "tip" at the end of the last one."""

    bodies: tuple[Body, ...]
    tip: Array
    gravity: Array

    @property
    def n(self) -> int:
        return len(self.bodies)

    def column(self, name: str) -> Array:
        return np.array([getattr(body, name) for body in self.bodies])

    def model(self) -> pin.Model:
        """The arm as a model of Pinocchio, made joint by joint, not from a file."""
        model, parent = pin.Model(), 0
        for name, body in zip(NAMES, self.bodies, strict=False):
            joint = (
                pin.JointModelPrismaticUnaligned(body.axis)
                if body.kind == "prismatic"
                else pin.JointModelRevoluteUnaligned(body.axis)
            )
            parent = model.addJoint(parent, joint, body.origin, name)
            model.appendBodyToJoint(parent, body.inertia, pin.SE3.Identity())
        model.gravity.linear = self.gravity
        model.armature = self.column("armature")
        return model

    def urdf(self) -> str:
        parts = ['<robot name="random"><link name="l0"/>']
        for i, body in enumerate(self.bodies):
            limit = (
                ""
                if body.kind == "continuous"
                else (f'lower="{body.lower!r}" upper="{body.upper!r}" ')
            )
            place = body.origin.translation, pin.rpy.matrixToRpy(body.origin.rotation)
            m, c, inertia = body.inertia.mass, body.inertia.lever, body.inertia.inertia
            entries = [
                f'{name}="{float(inertia[row, column])!r}"'
                for name, row, column in [
                    ("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2),
                    ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2),
                ]
            ]  # fmt: skip
            ball = (
                ""
                if body.ball is None
                else (
                    f'<collision><origin xyz="{_numbers(body.ball[0])}"/><geometry>'
                    f'<sphere radius="{body.ball[1]!r}"/></geometry></collision>'
                )
            )
            parts.append(
                f'<link name="l{i + 1}"><inertial><origin xyz="{_numbers(c)}"/>'
                f'<mass value="{m!r}"/><inertia {" ".join(entries)}/></inertial>{ball}'
                f'</link><joint name="{NAMES[i]}" type="{body.kind}">'
                f'<origin xyz="{_numbers(place[0])}" rpy="{_numbers(place[1])}"/>'
                f'<parent link="l{i}"/><child link="l{i + 1}"/>'
                f'<axis xyz="{_numbers(body.axis)}"/><limit {limit}'
                f'effort="{max(body.effort)!r}" velocity="{body.velocity!r}"/>'
                f'<dynamics damping="{body.damping!r}"/></joint>'
            )
        parts.append(
            f'<link name="tip"/><joint name="end" type="fixed"><parent '
            f'link="l{self.n}"/><child link="tip"/><origin xyz="{_numbers(self.tip)}"/>'
            "</joint></robot>"
        )
        return "".join(parts)

    def robot(self, **changes: Any) -> tm.Robot:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "random.urdf"
            path.write_text(self.urdf(), encoding="utf-8")
            given = {
                "effort": self.column("effort"),
                "armature": self.column("armature"),
                "gravity": self.gravity,
            }
            return tm.load_robot(path, **(given | changes))


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def random_rotation(rng: np.random.Generator) -> Array:
    return np.asarray(pin.Quaternion(_unit(rng, 4)).toRotationMatrix())


def _unit(rng: np.random.Generator, size: int = 3) -> Array:
    vector = rng.normal(size=size)
    return vector / np.linalg.norm(vector)


def random_arm(rng: np.random.Generator, kinds: Sequence[str], balls: bool) -> Arm:
    """An arm whose motors can hold it in most configurations.

    Args:
        rng: Random numbers.
        kinds: Kind of each joint.
        balls: Whether links have collision geometry.
    """
    size = log_uniform(rng, 0.2, 1.0) / np.sqrt(len(kinds))
    gravity = np.zeros(3)
    if rng.random() < 0.7:
        gravity = (
            np.array([0.0, 0.0, -9.81]) if rng.random() < 0.7 else 9.81 * _unit(rng)
        )
    bodies = []
    for index, kind in enumerate(kinds):
        axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.4 else _unit(rng)
        turn = np.eye(3) if rng.random() < 0.4 else random_rotation(rng)
        origin = pin.SE3(turn, size * rng.normal(size=3) if index else np.zeros(3))
        # The inertia of point masses is physically possible.
        points = 0.5 * size * rng.normal(size=(6, 3)) + 0.3 * size * rng.normal(size=3)
        mass = log_uniform(rng, 0.05, 10.0)
        centre = points.mean(axis=0)
        offsets = points - centre
        moment = sum(np.dot(x, x) * np.eye(3) - np.outer(x, x) for x in offsets)
        span = log_uniform(rng, 0.05, 3.0)
        lower = rng.uniform(-2.0, 2.0) - (0.5 * span if rng.random() < 0.7 else 0.0)
        if kind == "prismatic":
            lower, span = 0.3 * lower, 0.3 * span
        if kind == "continuous":
            lower, span = -np.inf, np.inf
        ball = None
        if balls and rng.random() < 0.7:
            ball = 0.3 * size * rng.normal(size=3), float(size * rng.uniform(0.1, 0.3))
        bodies.append(
            Body(
                kind=kind,
                axis=axis,
                origin=origin,
                inertia=pin.Inertia(mass, centre, mass / 6.0 * moment),
                lower=float(lower),
                upper=float(lower + span) if np.isfinite(span) else np.inf,
                velocity=log_uniform(rng, 0.3, 10.0) if rng.random() < 0.9 else 1e3,
                effort=(-1.0, 1.0),
                damping=0.0 if rng.random() < 0.4 else log_uniform(rng, 1e-2, 50.0),
                armature=0.0 if rng.random() < 0.6 else log_uniform(rng, 1e-3, 1.0),
                ball=ball,
            )
        )
    return _with_motors(rng, Arm(tuple(bodies), size * rng.normal(size=3), gravity))


def _with_motors(rng: np.random.Generator, arm: Arm) -> Arm:
    """The arm with effort limits by the torques that hold and accelerate it."""
    model = arm.model()
    data = model.createData()
    holds, masses = [np.zeros(arm.n)], []
    for _ in range(20):
        q = random_configuration(rng, arm)
        holds.append(np.abs(pin.computeGeneralizedGravity(model, data, q)))
        masses.append(np.diag(pin.crba(model, data, q)))
    need = np.max(holds, axis=0)
    inertia = np.max(masses, axis=0)
    bodies = []
    for i, body in enumerate(arm.bodies):
        spare = inertia[i] * log_uniform(rng, 1.0, 30.0)
        top = float(need[i] * rng.uniform(1.0, 3.0) + spare)
        low = -top if rng.random() < 0.7 else -top * float(rng.uniform(0.6, 1.5))
        bodies.append(Body(**(vars(body) | {"effort": (low, top)})))
    return Arm(tuple(bodies), arm.tip, arm.gravity)


def random_configuration(rng: np.random.Generator, arm: Arm) -> Array:
    """A configuration within the limits, sometimes with joints at a limit."""
    lower = np.where(np.isfinite(arm.column("lower")), arm.column("lower"), -4.0)
    upper = np.where(np.isfinite(arm.column("upper")), arm.column("upper"), 4.0)
    share = rng.random(arm.n)
    if rng.random() < 0.15:
        share = np.where(rng.random(arm.n) < 0.4, np.round(share), share)
    return np.clip(lower + share * (upper - lower), lower, upper)


@dataclass(frozen=True)
class Case:
    """A problem as it was drawn, for the library and for the check.

    Attributes:
        arm: The arm.
        q_start: Start configuration [rad or m].
        v_start: Start velocities [rad/s or m/s].
        goals: Kinds of the goals with their arguments.
        any_of: Whether one of the goals suffices; otherwise all must be met.
        obstacles: Spheres: centres and radii [m].
        margin: Smallest allowed clearance [m].
        options: Options of the plan.
    """

    arm: Arm
    q_start: Array
    v_start: Array
    goals: tuple[tuple[str, dict[str, Any]], ...]
    any_of: bool = False
    obstacles: tuple[tuple[Array, float], ...] = ()
    margin: float = 0.0
    options: dict[str, Any] = field(default_factory=dict)

    def problem(self, robot: tm.Robot | None = None) -> tm.Problem:
        """The problem for the library.

        Raises:
            TominpmpError: If the case is no valid problem.
        """
        goals = [_goal(kind, values) for kind, values in self.goals]
        goal = goals[0]
        if len(goals) > 1:
            goal = tm.AnyGoal(goals) if self.any_of else tm.AllGoals(goals)
        scene = tm.Scene(
            [
                tm.Sphere(f"o{i}", radius=radius, position=centre)
                for i, (centre, radius) in enumerate(self.obstacles)
            ]
        )
        return tm.Problem(
            self.arm.robot() if robot is None else robot,
            self.q_start,
            goal,
            scene=scene,
            margin=self.margin,
            v_start=self.v_start,
        )


def _goal(kind: str, values: dict[str, Any]) -> tm.Goal:
    if kind == "joint":
        return tm.JointGoal(values["q"], values["v"])
    if kind == "joint region":
        return tm.JointRegionGoal(**values)
    classes: dict[str, Any] = {
        "position": tm.PositionGoal,
        "pose": tm.PoseGoal,
        "axis": tm.AxisGoal,
        "region": tm.RegionGoal,
    }
    return classes[kind]("tip", **values)  # type: ignore[no-any-return]


def random_case(
    rng: np.random.Generator,
    kinds: Sequence[str],
    goal: str,
    *,
    obstacles: int = 0,
    moving: bool = False,
) -> Case:
    """A problem with a goal that the geometry of the arm can reach.

    Args:
        rng: Random numbers.
        kinds: Kind of each joint.
        goal: One of GOALS.
        obstacles: Number of obstacles, which may block every way.
        moving: Whether the arm moves at the start, and at a joint goal.
    """
    arm = random_arm(rng, kinds, obstacles > 0)
    q_start, end = random_configuration(rng, arm), random_configuration(rng, arm)
    speed = np.minimum(arm.column("velocity"), 3.0)
    v_start = speed * rng.uniform(-0.5, 0.5, arm.n) if moving else np.zeros(arm.n)
    v_goal = speed * rng.uniform(-0.5, 0.5, arm.n) if moving else None
    if goal in ("any", "all"):
        other = ("axis", "position", "joint region") if goal == "all" else GOALS[:6]
        picked = rng.choice(other, size=int(rng.integers(2, 4)))
        found = []
        for kind in picked.tolist():
            q = end if goal == "all" else random_configuration(rng, arm)
            found.append((kind, _random_goal(rng, arm, kind, q, None)))
    else:
        found = [(goal, _random_goal(rng, arm, goal, end, v_goal))]
    model = arm.model()
    data = model.createData()
    balls = [
        (
            place_of(arm, model, data, random_configuration(rng, arm)).translation
            + 0.3 * rng.normal(size=3),
            log_uniform(rng, 0.02, 0.3),
        )
        for _ in range(obstacles)
    ]
    margin = float(rng.choice([0.0, 0.01])) if obstacles else 0.0
    return Case(
        arm, q_start, v_start, tuple(found), goal == "any", tuple(balls), margin
    )


def _random_goal(
    rng: np.random.Generator, arm: Arm, kind: str, q: Array, v: Array | None
) -> dict[str, Any]:
    if kind == "joint":
        return {"q": q, "v": v}
    if kind == "joint region":
        some = rng.random(arm.n) < 0.6
        some[rng.integers(arm.n)] = True
        names = tuple(np.array(NAMES[: arm.n])[some].tolist())
        return {"q": q[some], "joints": names, "tolerance": _tolerance(rng, 0.2)}
    model = arm.model()
    place = place_of(arm, model, model.createData(), q)
    if kind == "position":
        return {"position": place.translation, "tolerance": _tolerance(rng, 0.05)}
    if kind == "pose":
        return {
            "pose": place,
            "tolerance": _tolerance(rng, 0.05),
            "angle_tolerance": _tolerance(rng, 0.3),
        }
    if kind == "axis":
        axis = _unit(rng)
        return {
            "axis": axis,
            "direction": place.rotation @ axis,
            "position": place.translation if rng.random() < 0.4 else None,
            "angle_tolerance": _tolerance(rng, 0.3),
        }
    half = np.abs(rng.normal(size=3)) * 0.1 * (rng.random(3) < 0.8)
    corner = half * rng.uniform(-1.0, 1.0, 3)
    return {
        "pose": place,
        "lower": corner - half,
        "upper": corner + half,
        "angle_tolerance": float(rng.choice([np.pi, 0.2])),
    }


def _tolerance(rng: np.random.Generator, most: float) -> float:
    return 0.0 if rng.random() < 0.6 else float(rng.uniform(0.0, most))


def place_of(arm: Arm, model: pin.Model, data: pin.Data, q: Array) -> pin.SE3:
    """Placement of the tip in the world."""
    pin.forwardKinematics(model, data, q)
    return data.oMi[arm.n] * pin.SE3(np.eye(3), arm.tip)


def plan_quietly(case: Case, **options: Any) -> tm.Solution:
    """Plan without warnings of the library; warnings of NumPy are not suppressed.

    Raises:
        TominpmpError: If the case is no valid problem.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tm.TominpmpWarning)
        problem = case.problem()
        return tm.plan(problem, tm.Options(**(case.options | options)))
