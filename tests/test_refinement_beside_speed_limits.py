"""Grid refinement if some joints are at their speed limits."""

from __future__ import annotations

from functools import cache

import tominpmp as tm

START = (-1.68, -1.73, -2.69, 0.67, -2.17, -0.81)
GOAL = (1.16, -2.36, -1.85, -2.6, -2.56, -0.56)
# Largest relative excess of T over that of four times the intervals: for the default,
# and for a grid that was refined as far as it pays.
USUALLY, EXACTLY = 3e-3, 2e-4


def problem():
    """A base that turns at its speed limit, and a wrist whose swing helps the base."""
    robot = tm.load_robot("ur10", limits="urdf", friction=0.0)
    robot = robot.with_changes(velocity=4.0 * robot.limits.velocity)
    return tm.Problem(robot, START, tm.JointGoal(GOAL), self_collision=False)


@cache
def planned(**options):
    solution = tm.plan(problem(), **options)
    assert solution.success and solution.verification.ok
    return solution


def test_default_refinement_gains_time_beside_speed_limits():
    finer = planned(intervals=160, refine=None)
    assert planned().T < (1.0 + USUALLY) * finer.T


def test_thorough_refinement_reaches_the_finest_grid(monkeypatch):
    monkeypatch.setattr("tominpmp.planner.thorough.WAVES", 0)
    exact = planned(effort="thorough")
    assert len(exact.trajectory.t) > len(planned().trajectory.t)
    assert exact.T < (1.0 + EXACTLY) * planned(intervals=160, refine=None).T
