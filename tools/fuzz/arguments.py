"""Wrong arguments: every public callable, with one or two unsuitable values."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

import tominpmp as tm
from tools.fuzz.nonsense import NONSENSE

# Limits of plans whose arguments happen to be valid.
QUICK = {"intervals": 6, "max_iterations": 2, "starts": 1, "max_planning_time": 2.0}


class World:
    """Valid values of every type, each made at its first use."""

    @cached_property
    def robot(self) -> tm.Robot:
        """An arm of three joints."""
        return tm.load_robot("planar3r")

    @cached_property
    def goal(self) -> tm.JointGoal:
        """A goal of that arm."""
        return tm.JointGoal([2.0, -1.0, 0.5])

    @cached_property
    def scene(self) -> tm.Scene:
        """A ball that is far away."""
        return tm.Scene([tm.Sphere("ball", radius=0.1, position=(9.0, 0.0, 0.0))])

    @cached_property
    def problem(self) -> tm.Problem:
        """A problem of that arm."""
        return tm.Problem(self.robot, [0.5, 1.7, -1.7], self.goal, self.scene)

    @cached_property
    def options(self) -> tm.Options:
        """Options that make planning quick."""
        return tm.Options(**QUICK)

    @cached_property
    def solution(self) -> tm.Solution:
        """A solution of that problem."""
        few = tm.Options(intervals=8, effort="quick", refine=None)
        return tm.plan(self.problem, few)

    @cached_property
    def trajectory(self) -> tm.Trajectory:
        """Its motion."""
        assert self.solution.trajectory is not None  # noqa: S101
        return self.solution.trajectory

    @cached_property
    def samples(self) -> tm.Samples:
        """Samples of it."""
        return self.trajectory.sample(0.05)

    @cached_property
    def workcell(self) -> tm.Workcell:
        """Two such arms."""
        bases = {"a": (self.robot, (0, 0, 0)), "b": (self.robot, (30.0, 0, 0))}
        return tm.Workcell(bases)

    def kinds(self) -> list[Any]:
        """Valid objects that have the wrong type for most arguments."""
        pose = pin.SE3.Identity()
        named = (
            "robot", "goal", "scene", "problem", "options", "solution", "trajectory",
            "samples", "workcell",
        )  # fmt: skip
        return [getattr(self, name) for name in named] + [pose]


# A callable by its name, and valid arguments for it.
Case = tuple[Callable[..., Any], Mapping[str, Any]]


def goal_cases(_: World) -> dict[str, Case]:
    """Goals."""
    pose = pin.SE3(np.eye(3), np.array([3.0, 1.0, 0.0]))
    joint, position = tm.JointGoal([2.0, -1.0, 0.5]), tm.PositionGoal("tip", (4, 1, 0))
    region: dict[str, Any] = {
        "frame": "tip", "lower": (-1, -1, -1), "upper": (1, 1, 1), "pose": pose,
        "angle_tolerance": (0.1, 0.1, 0.1),
    }  # fmt: skip
    return {
        "JointGoal": (tm.JointGoal, {"q": [2.0, -1.0, 0.5], "v": [0.0, 0, 0]}),
        "JointRegionGoal": (
            tm.JointRegionGoal,
            {"q": [1.0, 0.0, 0.0], "tolerance": 0.1, "joints": None},
        ),
        "PositionGoal": (
            tm.PositionGoal,
            {"frame": "tip", "position": (4, 1, 0), "tolerance": 0.0},
        ),
        "PoseGoal": (tm.PoseGoal, {"frame": "tip", "pose": pose}),
        "RegionGoal": (tm.RegionGoal, region),
        "AxisGoal": (
            tm.AxisGoal,
            {"frame": "tip", "axis": (0, 0, 1), "direction": (0, 0, 1)},
        ),
        "AnyGoal": (tm.AnyGoal, {"goals": (joint, position)}),
        "AllGoals": (tm.AllGoals, {"goals": (position,)}),
    }


def scene_cases(_: World) -> dict[str, Case]:
    """Obstacles and their motions."""
    at = {"position": (0, 9, 0), "rotation": np.eye(3), "motion": None}
    ball = tm.Sphere("a", radius=0.1)
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    return {
        "Scene": (tm.Scene, {"obstacles": [ball]}),
        "Sphere": (tm.Sphere, {"name": "a", "radius": 0.1, **at}),
        "Box": (tm.Box, {"name": "a", "size": (0.1, 0.1, 0.1), **at}),
        "Cylinder": (tm.Cylinder, {"name": "a", "radius": 0.1, "length": 0.2, **at}),
        "Capsule": (tm.Capsule, {"name": "a", "radius": 0.1, "length": 0.2, **at}),
        "Mesh": (
            tm.Mesh,
            {
                "name": "a", "vertices": points, "triangles": faces, "scale": 1.0,
                "convex": "auto", "path": None, **at,
            },
        ),
        "HeightField": (
            tm.HeightField,
            {"name": "a", "heights": np.zeros((3, 3)), "size": (1, 1), **at},
        ),
        "OcTree": (tm.OcTree, {"name": "a", "points": points, "resolution": 0.1, **at}),
        "ConstantVelocity": (
            tm.ConstantVelocity,
            {"velocity": (0, 0.1, 0), "start": 0.0, "end": 3.0},
        ),
        "Waypoints": (
            tm.Waypoints,
            {"times": [0.0, 1.0], "positions": np.zeros((2, 3)), "rotations": None},
        ),
        "PoseFunction": (
            tm.PoseFunction,
            {"function": lambda t: pin.SE3.Identity(), "speed": 1.0},
        ),
    }  # fmt: skip


def robot_cases(world: World) -> dict[str, Case]:
    """Robots, and functions that describe them."""
    robot, per_joint = world.robot, [1.0, 1.0, 1.0]
    values: dict[str, Any] = {
        "damping": 0.1, "armature": 0.01, "effort": 20.0, "velocity": per_joint,
        "position_lower": {"joint1": -1.0}, "position_upper": 3.0,
        "gravity": (0, 0, -9),
    }  # fmt: skip
    loading = {"package_dirs": (), "srdf": None, "locked_joints": {}, **values}
    limits = {
        "position_lower": -np.ones(3), "position_upper": np.ones(3),
        "velocity": np.ones(3), "effort_lower": -np.ones(3), "effort_upper": np.ones(3),
    }  # fmt: skip
    return {
        "load_robot": (tm.load_robot, {"source": "planar3r", **loading}),
        "with_changes": (robot.with_changes, values),
        "with_payload": (
            robot.with_payload,
            {"payload": tm.Payload(mass=0.1, frame="tip")},
        ),
        "frame_id": (robot.frame_id, {"name": "tip"}),
        "group_state": (robot.group_state, {"name": "start"}),
        "Payload": (
            tm.Payload,
            {"mass": 0.1, "frame": "tip", "com": (0, 0, 0), "inertia": None},
        ),
        "JointLimits": (tm.JointLimits, limits),
        "MotionLimits": (
            tm.MotionLimits,
            {
                "acceleration": 10.0, "jerk": [100.0] * 3, "effort_rate": None,
                "effort_scale": 0.9, "effort_curves": {},
            },
        ),
        "EffortCurve": (tm.EffortCurve, {"speed": [0.0, 1.0], "effort": [9.0, 5.0]}),
        "combine_robots": (
            tm.combine_robots,
            {"parts": [("a", robot, (0, 0, 0)), ("b", robot, (30, 0, 0))]},
        ),
        "Workcell": (
            tm.Workcell,
            {"robots": {"a": (robot, (0, 0, 0)), "b": (robot, (30, 0, 0))}},
        ),
    }  # fmt: skip


def planning_cases(world: World) -> dict[str, Case]:
    """Problems, plans and their verification."""
    problem, motion = world.problem, world.trajectory
    judged = {"problem": problem, "trajectory": motion}
    return {
        "Problem": (
            tm.Problem,
            {
                "robot": world.robot, "q_start": [0.5, 1.7, -1.7], "goal": world.goal,
                "scene": world.scene, "margin": 0.01, "v_start": None,
                "motion_limits": None, "self_collision": None,
            },
        ),
        "Options": (tm.Options, {name: None for name in tm.Options.names()}),
        "Tolerances": (tm.Tolerances, {"goal": 1e-3, "speed": 1e-2, "limits": 5e-3}),
        "plan": (
            tm.plan,
            {"problem": problem, "options": world.options, "start": None},
        ),
        "smooth": (tm.smooth, {"solution": world.solution, "slack": 0.02}),
        "verify": (tm.verify, {**judged, "tolerances": None, "geometry": "convex"}),
        "certify": (tm.certify, judged),
        "lower_bound": (tm.lower_bound, {"problem": problem}),
        "prove_clearance": (
            tm.prove_clearance,
            {
                "checker": problem.checker, "trajectory": motion,
                "margins": problem.margins, "slack": 0.0,
            },
        ),
        "with_scene": (problem.with_scene, {"scene": world.scene}),
        "workcell.problem": (
            world.workcell.problem,
            {
                "start": {"a": [0.5, 1.7, -1.7], "b": [0.5, 1.7, -1.7]},
                "goal": {"a": world.goal, "b": world.goal},
            },
        ),
        "workcell.split": (world.workcell.split, {"trajectory": motion}),
    }  # fmt: skip


def motion_cases(world: World) -> dict[str, Case]:
    """Motions."""
    motion, samples = world.trajectory, world.samples
    rows = {key: getattr(samples, key) for key in ("joint_names", "t", *"qvau")}
    curve = {key: getattr(motion, key) for key in ("joint_names", "t", *"qvua")}
    return {
        "Trajectory": (tm.Trajectory, curve),
        "Samples": (tm.Samples, rows),
        "trajectory()": (motion, {"time": 0.1, "hold": False}),
        "sample": (motion.sample, {"dt": 0.1}),
    }


def file_cases(world: World) -> dict[str, Case]:
    """Callables that read or write a file."""
    from tominpmp.files.export import export
    from tominpmp.viz.playback import play
    from tominpmp.viz.plots import plot_trajectory

    problem, solution = world.problem, world.solution
    shown = {"problem": problem, "trajectory": world.trajectory}
    return {
        "load_motion": (tm.load_motion, {"path": "motion.csv"}),
        "load_scenario": (tm.load_scenario, {"path": "scenario.toml"}),
        "load_joint_limits": (tm.load_joint_limits, {"path": "limits.yaml"}),
        "load_motion_limits": (
            tm.load_motion_limits,
            {"path": "limits.yaml", "robot": world.robot},
        ),
        "load_moveit": (
            tm.load_moveit,
            {
                "robot": world.robot,
                "scene_path": "scene.yaml",
                "request_path": "request.yaml",
            },
        ),
        "load_moveit_scene": (
            tm.load_moveit_scene,
            {"robot": world.robot, "path": "scene.yaml"},
        ),
        "save_scenario": (
            tm.save_scenario,
            {"path": "saved.toml", "problem": problem, "options": world.options},
        ),
        "export": (
            export,
            {"trajectory": world.trajectory, "path": "a.csv", "dt": 0.1},
        ),
        "solution.export": (solution.export, {"path": "b.csv", "dt": 0.1}),
        "plot": (solution.plot, {"path": "a.png"}),
        "plot_trajectory": (plot_trajectory, {**shown, "path": "b.png"}),
        "plot_certificate": (solution.plot_certificate, {"path": "c.png"}),
        "solution.play": (solution.play, {"path": "a.html", "ghosts": 3}),
        "play": (play, {**shown, "path": "b.html", "ghosts": 3, "speed": 1.0}),
    }


FAMILIES = (
    goal_cases,
    scene_cases,
    robot_cases,
    planning_cases,
    motion_cases,
    file_cases,
)
# Slow ones are tried less often.
RARE = {"plan", "smooth", "plot", "plot_trajectory", "plot_certificate", "certify"}
RARE |= {"solution.play", "play", "Problem"}


def make_cases(world: World) -> dict[str, Case]:
    """All callables, each with valid arguments."""
    found: dict[str, Case] = {}
    for family in FAMILIES:
        for name, (function, given) in family(world).items():
            known = inspect.signature(function).parameters
            takes_all = any(p.kind is p.VAR_KEYWORD for p in known.values())
            found[name] = (
                function,
                {k: v for k, v in given.items() if takes_all or k in known},
            )
    return found


class Wrong:
    """Calls with wrong arguments, by number."""

    def __init__(self) -> None:
        self.world = World()
        self.cases = make_cases(self.world)
        names = sorted(self.cases)
        self.names = [n for n in names for _ in range(1 if n in RARE else 4)]

    def run(self, rng: np.random.Generator) -> tuple[str, Callable[[], Any]]:
        """Choose a call.

        Returns:
            What it is, and the call.
        """
        name = self.names[rng.integers(len(self.names))]
        function, given = self.cases[name]
        given = dict(given)
        if name == "Options":
            given = {}
            chosen = rng.choice(tm.Options.names(), size=2).tolist()
        else:
            keys = sorted(given)
            chosen = rng.choice(keys, size=min(len(keys), 1 + rng.integers(2))).tolist()
        wrong = []
        for key in dict.fromkeys(chosen):
            value, label = self._value(rng)
            given[key] = value
            wrong.append(f"{key}=<{label}>")
        return f"{name}({', '.join(wrong)})", lambda: function(**given)

    def _value(self, rng: np.random.Generator) -> tuple[Any, str]:
        kinds = self.world.kinds()
        at = int(rng.integers(len(NONSENSE) + len(kinds)))
        if at < len(NONSENSE):
            label = list(NONSENSE)[at]
            return NONSENSE[label](), label
        value = kinds[at - len(NONSENSE)]
        return value, type(value).__name__
