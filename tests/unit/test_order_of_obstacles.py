"""The order in which obstacles are listed changes neither distances nor motions."""

from __future__ import annotations

import numpy as np

import tominpmp as tm

OBSTACLES = (
    tm.Sphere("ball", radius=0.4, position=(3.0, 1.0, 0.0)),
    tm.Box("post", size=(0.2, 0.2, 1.0), position=(-2.0, 2.5, 0.0)),
    tm.Sphere("other", radius=0.2, position=(3.0, 1.0, 0.5)),
    tm.Box("plate", size=(0.2, 0.5, 1.0), position=(3.0, 1.0, 0.5)),
)
START, END = (0.5, 1.7, -1.7), (2.0, -1.0, 0.5)


def reach(scene):
    robot = tm.load_robot("planar3r")
    return tm.Problem(robot, START, tm.JointGoal(END), scene=scene)


def test_collision_pairs_do_not_depend_on_the_order_of_obstacles():
    one, other = (
        reach(tm.Scene(listed)).checker for listed in (OBSTACLES, OBSTACLES[::-1])
    )
    assert one.pairs == other.pairs
    q = np.array([START, END])
    np.testing.assert_array_equal(one.distances(q), other.distances(q))


def test_motion_does_not_depend_on_the_order_of_obstacles():
    one, other = (
        tm.plan(reach(tm.Scene(listed)), effort="quick", refine=None)
        for listed in (OBSTACLES[:3], OBSTACLES[2::-1])
    )
    assert one.success
    assert one.T.hex() == other.T.hex()
    np.testing.assert_array_equal(one.trajectory.q, other.trajectory.q)
