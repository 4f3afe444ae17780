"""The time at speed limits with ramps at both ends."""

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tominpmp.planner.ramps import time_at_speed_limits
from tominpmp.transcription.problem_functions import ProblemFunctions


@pytest.mark.parametrize(("effort", "ramped"), [(40.0, True), (0.3, False)])
def test_ramps_of_a_rail_are_told_where_they_are_short(effort, ramped):
    rail = make_arm(slide(1.0), effort=effort, velocity=0.5)
    problem = tm.Problem(rail, [0.0], tm.JointGoal([1.0]))
    motion = tm.plan(problem, refine=None, effort="quick").trajectory
    system = ProblemFunctions.of(problem)
    mass = float(system.dynamics.inverse_jacobians(*np.zeros((3, 1, 1))).tau_a[0, 0, 0])
    lost = 0.5 * mass / effort if ramped else 0.0
    found = time_at_speed_limits(system, motion)
    assert found == pytest.approx(2.0 + lost, rel=1e-6)
    assert found <= motion.duration * (1.0 + 1e-6)
