"""Goals on a frame whose configurations collide.

Inverse kinematics moves them out of the collision, or the plan ends early.
"""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.exceptions import ProblemError
from tominpmp.initial_guess.guess import GuessRequest
from tominpmp.initial_guess.inverse_kinematics import (
    REACHED,
    GoalSearch,
    Target,
    isolated,
)
from tominpmp.initial_guess.rrt import is_free
from tominpmp.transcription.problem_functions import ProblemFunctions

# An arm with two links of 3 m, or with three links of 3, 2 and 1 m, turns from upright
# to a place on one side.
UPRIGHT = np.pi / 2
PLACE = (4.0, 2.0, 0.0)
# The positions of the elbow with which the arm of two links is at the place.
ELBOWS = (1.108, 2.789), (2.894, -0.789)
# Spheres around the place, which also keep the redundant arm of three links out.
RING = [
    (PLACE[0] + z.real, PLACE[1] + z.imag)
    for z in 0.5 * np.exp(2j * np.pi * np.arange(10) / 10)
]


def turning(
    two: bool, *spheres: tuple[float, float], lower: float = -6.0
) -> tm.Problem:
    """Turn to the place among spheres, with a lower limit of the joint positions."""
    arm = tm.load_robot("planar3r", position_lower=lower, velocity=3.0)
    if two:
        arm = arm.with_locked({"joint3": 0.0})
    scene = tm.Scene(
        [
            tm.Sphere(f"S{i}", radius=0.2, position=(x, y, 0.0))
            for i, (x, y) in enumerate(spheres)
        ]
    )
    start = np.append(UPRIGHT, np.zeros(arm.n - 1))
    return tm.Problem(arm, start, tm.PositionGoal("tip", PLACE), scene)


def search_goal(problem: tm.Problem) -> tuple[ProblemFunctions, GoalSearch]:
    system = ProblemFunctions.of(problem)
    rng = np.random.default_rng(0)
    return system, Target(system, problem.goal).configurations(20, rng)


@pytest.mark.parametrize("two", [True, False])
def test_configurations_of_a_nonredundant_arm_are_isolated(two: bool) -> None:
    system, search = search_goal(turning(two))
    assert search.free
    alone = [isolated(Target(system, system.problem.goal), q) for q in search.free]
    assert alone == [two] * len(alone)


def test_goal_whose_configurations_all_collide_is_refused_at_once() -> None:
    words = r"goal: all 3 configurations found to reach it are in collision.*'S\d' lack"
    with pytest.raises(ProblemError, match=words) as refused:
        tm.plan(turning(True, *ELBOWS))
    assert refused.value.field == "goal"


def test_goal_behind_triangles_is_refused_with_both_names() -> None:
    """Coal knows no margins below zero for triangles: its error ended the plan."""
    corners = np.array([[-1, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 0.4 + PLACE
    faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    tent = tm.Mesh("tent", vertices=corners, triangles=faces, convex="none")
    problem = turning(True).with_scene([tent])
    with pytest.raises(ProblemError, match="'link3' and obstacle 'tent'"):
        tm.plan(problem)


def test_goal_that_is_clear_with_the_other_elbow_is_planned() -> None:
    few = {"effort": "quick", "refine": None, "intervals": 24}
    # The lower limit excludes the same elbow a full turn below, which is clear as well,
    # but with the sphere on the way.
    solution = tm.plan(turning(True, ELBOWS[1], lower=-3.0), **few)
    assert solution.success, solution.message
    assert solution.trajectory.q[-1, 1] < 0.0


def test_null_space_motion_leads_out_of_a_collision() -> None:
    problem = turning(False, (2.06, 2.478))
    system = ProblemFunctions.of(problem)
    blocked = np.array([1.19337527, -1.45945531, 0.0])
    assert not is_free(system, blocked)
    q, error = Target(system, problem.goal, keep_clear=True).solve(blocked)
    assert error < REACHED
    assert is_free(system, q)
    there = system.kinematics.placement(q, "tip").translation
    assert there == pytest.approx(PLACE, abs=1e-5)


def test_jacobian_of_clear_target_matches_finite_differences() -> None:
    system = ProblemFunctions.of(turning(False, *ELBOWS))
    clear_target = Target(system, system.problem.goal, keep_clear=True)
    q = np.array([1.19, -1.45, 0.01])
    (value,), (by_q,) = clear_target.residual(q[None])
    assert value.size > 3
    steps = 1e-6 * np.eye(3)
    slopes = (
        clear_target.residual(q + steps)[0] - clear_target.residual(q - steps)[0]
    ) / 2e-6
    assert by_q.T == pytest.approx(slopes, abs=1e-4)


def test_guesses_that_end_in_collision_are_marked_as_blocked() -> None:
    def first(problem: tm.Problem) -> bool:
        system = ProblemFunctions.of(problem)
        return next(GuessRequest(np.random.default_rng(0)).guesses(system)).blocked

    assert first(turning(False, *RING))
    assert not first(turning(False))


def test_descents_to_goals_in_collision_end_early_on_coarse_grids_too() -> None:
    solution = tm.plan(turning(False, *RING))
    assert not solution
    assert "all" in solution.message
    assert "in collision" in solution.message
    # 107 iterations when only descents on the requested grid ended early, now 58.
    assert len(solution.history) < 80


def test_a_link_may_reach_into_an_obstacle_that_it_may_touch() -> None:
    problem = turning(False)
    sphere = tm.Sphere("ball", radius=0.4, position=PLACE)
    given = problem.robot, problem.q_start, problem.goal, tm.Scene([sphere])
    with pytest.raises(ProblemError, match=r"link 'link3' .* in every orientation"):
        tm.Problem(*given)
    solution = tm.plan(tm.Problem(*given, may_touch=[("link3", "ball")]), seed=0)
    assert solution.success
    with pytest.raises(ProblemError, match="in every orientation"):
        tm.Problem(*given, may_touch=[("link2", "ball")])
