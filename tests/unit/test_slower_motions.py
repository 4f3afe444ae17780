"""A motion on the same path, slower: distances that depend on the path alone are
reused.
"""

from __future__ import annotations

import numpy as np

import tominpmp as tm
from tominpmp.initial_guess.guess import straight_guess
from tominpmp.planner.automatic_options import resolve_options
from tominpmp.planner.first_program import first_program
from tominpmp.transcription.problem_functions import ProblemFunctions

START, END = (0.5, 1.7, -1.7), (2.0, -1.0, 0.5)


def started(obstacle, **more):
    robot = tm.load_robot("planar3r")
    scene = tm.Scene([obstacle])
    problem = tm.Problem(robot, START, tm.JointGoal(END), scene=scene, **more)
    options = resolve_options(problem, tm.Options())
    system = ProblemFunctions.of(problem)
    guess = straight_guess(system, problem.goal.configuration)
    program, z = first_program(system, options, guess)
    return system.clearance.checker, program, z


def slowing_measures_distances(obstacle, **more):
    """Whether distances were measured again; checks the values of the slower motion."""
    checker, program, z = started(obstacle, **more)
    values = program.evaluate(z)
    usual, measured = checker.distances, []
    checker.distances = lambda *given: measured.append(given) or usual(*given)
    slow, found = program.slower(z, 1.3, values)
    del checker.distances
    np.testing.assert_array_equal(slow, program.time_scale(z, 1.3))
    np.testing.assert_allclose(found, program.evaluate(slow), atol=1e-9)
    assert np.max(np.abs(found - values)) > 1e-3  # torques are smaller
    return bool(measured)


def post(**more):
    return tm.Sphere("post", radius=0.05, position=(-0.5, -0.5, 0.0), **more)


def test_slower_motion_reuses_distances_to_static_obstacles():
    assert not slowing_measures_distances(post())


def test_slower_motion_measures_distances_if_obstacle_or_path_changes():
    assert slowing_measures_distances(post(motion=tm.ConstantVelocity((0.1, 0.0, 0.0))))
    assert slowing_measures_distances(post(), v_start=(0.5, 0.0, 0.0))
