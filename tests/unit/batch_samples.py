"""Problems for the tests of batches: a mass on a rail, planned within milliseconds."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import tominpmp as tm

RAIL = """<robot name="rail"><link name="base"/>
<link name="mass"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="mass"/>
<axis xyz="1 0 0"/>
<limit lower="-9" upper="9" effort="2" velocity="1.5"/></joint></robot>"""
QUICK: dict[str, Any] = {"intervals": 8, "refine": None, "starts": 1}


def rail(folder: Path) -> tm.Robot:
    """The mass on a rail."""
    path = folder / "rail.urdf"
    path.write_text(RAIL)
    return tm.load_robot(path)


def problems(folder: Path, count: int = 6) -> list[tm.Problem]:
    """Problems along the rail, each goal a little farther than its predecessor."""
    robot = rail(folder)
    far = 8.0 / max(count, 32)
    goals = [tm.JointGoal([0.5 + far * k]) for k in range(count)]
    return [tm.Problem(robot, [0.0], goal) for goal in goals]


class Deadly:
    """An object whose unpickling kills every process but the one that made it."""

    def __init__(self) -> None:
        self.home = os.getpid()

    def __reduce__(self) -> tuple[Any, ...]:
        return _kill_unless, (self.home,)


def _kill_unless(home: int) -> None:
    if os.getpid() != home:
        os._exit(1)


class Unsendable:
    """An object that cannot be pickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError("a lock is in it")


def slept(number: int, seconds: float) -> tuple[int, float]:
    """The arguments, after a pause."""
    time.sleep(seconds)
    return number, seconds
