"""A cart that moves in a plane between boxes, for the tests of initial guesses."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

import tominpmp as tm
from tominpmp.initial_guess.path import RoundedPath
from tominpmp.initial_guess.timing import time_path
from tominpmp.transcription.problem_functions import ProblemFunctions

GANTRY = """<robot name="gantry"><link name="base"/>
<link name="beam"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<link name="cart"><inertial><mass value="2"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="beam"/>
<axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="30" velocity="2"/></joint>
<joint name="y" type="prismatic"><parent link="beam"/><child link="cart"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="20" velocity="2"/></joint>
</robot>"""
START, END = (-1.5, 0.0), (1.5, 0.0)


def gantry(folder: Path) -> tm.Robot:
    """Masses of 3 kg along x and 2 kg along y, with forces of 30 N and 20 N."""
    path = folder / "gantry.urdf"
    path.write_text(GANTRY)
    return tm.load_robot(path)


def wall(name: str, x: float, low: float, high: float) -> tm.Box:
    """A wall across the plane, from one y to another."""
    size, middle = (0.2, high - low, 1.0), 0.5 * (high + low)
    return tm.Box(name, size=size, position=(x, middle, 0.0))


def maze(
    folder: Path, *walls: tm.Box, end: tuple[float, float] = END
) -> ProblemFunctions:
    """From left to right through walls."""
    scene = tm.Scene(walls)
    problem = tm.Problem(gantry(folder), START, tm.JointGoal(end), scene=scene)
    return ProblemFunctions.of(problem)


def fine(corners: np.ndarray, step: float = 0.01) -> np.ndarray:
    """Points on a polyline, this far apart at most."""
    pieces = [
        a
        + np.linspace(0.0, 1.0, 2 + int(np.abs(b - a).max() / step))[:, None] * (b - a)
        for a, b in itertools.pairwise(corners)
    ]
    return np.concatenate(pieces)


class Timed(NamedTuple):
    """A path, and its parameter over time."""

    path: RoundedPath
    s: CubicHermiteSpline

    @property
    def duration(self) -> float:
        """T [s]."""
        return float(self.s.x[-1])

    def position(self, times: np.ndarray) -> np.ndarray:
        """Configurations at times, shape (k, n)."""
        return self.path.evaluate(np.clip(self.s(times), 0.0, 1.0))[0]


def timed(system: ProblemFunctions, corners: np.ndarray) -> Timed | None:
    """Traverse a path with rounded corners from rest to rest in minimum time."""
    path = RoundedPath.through(corners, system.problem.robot.limits.velocity)
    s = time_path(system, path)
    return None if s is None else Timed(path, s)


def time_straight_line(system, q_start, q_end):
    """Traverse a straight line from rest to rest in minimum time."""
    return timed(system, np.stack([q_start, q_end]))
