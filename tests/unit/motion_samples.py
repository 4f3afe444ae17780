"""Problems and hand-made motions for the tests of the output."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from robot_samples import INERTIAL, joint, link, load
from robot_samples import robot as description

from tominpmp.dynamics import RobotDynamics
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import PositionGoal
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.obstacles import Box, Capsule, Cylinder, Sphere
from tominpmp.scene.scene import Scene

PANDA_HOME = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)
START = (0.5, 1.7, -1.7)
END = (0.9, -1.2, -0.9)


def planar_problem(goal: Goal | None = None, scene: Scene | None = None) -> Problem:
    """The paper's arm, goal and obstacle."""
    if scene is None:
        scene = Scene([Sphere("O", radius=0.8, position=(4, 0, 0))])
    goal = goal or PositionGoal("tip", (4, 1, 0))
    return Problem(load_robot("planar3r"), START, goal, scene=scene)


def four_shapes() -> Scene:
    """One obstacle of each kind, all of them away from the paper's arm."""
    return Scene(
        [
            Sphere("ball", radius=0.5, position=(4, -1, 0)),
            Box("crate", size=(1, 2, 3), position=(-2, -3, 0)),
            Cylinder("can", radius=0.4, length=1.0, position=(0, -3, 0)),
            Capsule("pill", radius=0.3, length=1.0, position=(2, -3, 0)),
        ]
    )


def simple_arm(
    folder: Path, axes: Sequence[str], kinds: Sequence[str] = (), inside: str = ""
) -> Robot:
    """A chain of joints about (or along) axes, without any geometry of its own.

    What is inside each link, beyond its inertia, may be given.
    """
    parts = [link("base", "")]
    for i, axis in enumerate(axes, 1):
        kind = kinds[i - 1] if kinds else "revolute"
        parent = "base" if i == 1 else f"l{i - 1}"
        body = link(f"l{i}") if not inside else link(f"l{i}", INERTIAL + inside)
        parts += [body, joint(f"j{i}", parent, f"l{i}", kind=kind, axis=axis)]
    return load(folder, description(*parts))


def quintic(
    robot: Robot, start: ArrayLike, end: ArrayLike, duration: float, intervals: int
) -> Trajectory:
    """From rest to rest along a polynomial, with the torque held on each interval."""
    first = np.asarray(start, dtype=float)
    way = np.asarray(end, dtype=float) - first
    s = np.linspace(0.0, 1.0, intervals + 1)[:, None]
    q = first + (10 * s**3 - 15 * s**4 + 6 * s**5) * way
    v = (30 * s**2 - 60 * s**3 + 30 * s**4) * way / duration
    a = (60 * s - 180 * s**2 + 120 * s**3) * way / duration**2
    u = RobotDynamics(robot).inverse(q, v, a)
    return Trajectory(robot.joint_names, s[:, 0] * duration, q, v, u)


def speed_up_and_brake(
    robot: Robot, start: ArrayLike, end: ArrayLike, duration: float, intervals: int
) -> Trajectory:
    """From rest to rest with one acceleration and its opposite, which it jumps to."""
    first = np.asarray(start, dtype=float)
    way = np.asarray(end, dtype=float) - first
    h = duration / intervals
    sign = np.where(np.arange(intervals) < intervals // 2, 1.0, -1.0)[:, None]
    a = 4.0 * sign * way / duration**2
    v = np.vstack([0.0 * way, np.cumsum(a * h, axis=0)])
    steps = v[:-1] * h + a * h**2 / 2
    q = first + np.vstack([0.0 * way, np.cumsum(steps, axis=0)])
    inverse = RobotDynamics(robot).inverse
    u = inverse(q, v, np.vstack([a, a[-1:]]))
    times = np.linspace(0.0, duration, intervals + 1)
    return Trajectory(robot.joint_names, times, q, v, u, a, inverse)


def planar_motions() -> tuple[Problem, Trajectory, Trajectory]:
    """The paper's problem, a motion with held torques, one with held accelerations."""
    problem = planar_problem()
    held = quintic(problem.robot, START, END, 1.1, 20)
    return problem, held, speed_up_and_brake(problem.robot, START, END, 0.95, 12)
