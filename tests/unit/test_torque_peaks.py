"""Torques are inspected where they peak: beside reversals, and at closely spaced
instants.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, rod
from tominpmp.constraints.friction import EFFORT_TOLERANCE
from tominpmp.transcription.blocks import SampledRows, blocks_of
from tominpmp.transcription.bspline import INSPECTED, TORQUE_SHARES
from tominpmp.transcription.exchange import REVERSAL_OFFSET, Inspection
from tominpmp.transcription.layout import Layout
from tominpmp.transcription.problem_functions import ProblemFunctions

EFFORT = (12.0, 4.0)


@pytest.fixture(scope="module")
def reversing_motion() -> tm.Solution:
    """Rods with dry friction that start in the wrong direction and reverse inside an
    interval.
    """
    arm = make_arm(rod(4.0, 0.6), rod(2.0, 0.5), effort=EFFORT, friction=(0.6, 0.4))
    start, goal = [0.0, 0.0], tm.JointGoal([0.6, -0.5])
    problem = tm.Problem(arm, start, goal, v_start=[-1.5, 1.0], self_collision=False)
    return tm.plan(problem, intervals=13, control="linear", refine=None, effort="quick")


def test_torques_keep_their_limits_beside_reversals(
    reversing_motion: tm.Solution,
) -> None:
    assert reversing_motion.success, reversing_motion.message
    times = np.linspace(0.0, reversing_motion.T, 4001)
    motion = reversing_motion.trajectory(times)
    assert np.any(np.diff(np.sign(motion.v[1:-1]), axis=0) != 0.0)
    share = np.abs(motion.u) / np.array(EFFORT)
    assert share.max() < 1.0 + 2.0 * EFFORT_TOLERANCE


def test_reversals_are_inspected_before_and_after(
    reversing_motion: tm.Solution,
) -> None:
    motion = reversing_motion.trajectory
    layout = Layout.of_motion(motion)
    assert layout is not None
    system = ProblemFunctions.of(reversing_motion.problem)
    program, z = layout.represented(system, motion)
    of = program.transcription
    every = np.ones(2, dtype=bool)
    (block,) = (block for block in blocks_of(of) if block.name == "torque")
    assert isinstance(block, SampledRows)
    inspection = Inspection(block, of.motion(z))
    at = inspection.around_reversals(every)
    assert at.size >= 2
    v = of.states(of.motion(z), at, 1).v
    ways = [set(np.sign(v[:, joint])) for joint in range(2)]
    assert any({-1.0, 1.0} <= way for way in ways)
    pairs = [b - a for a, b in itertools.pairwise(at.share) if b > a]
    assert min(pairs) <= 2.0 * REVERSAL_OFFSET + 1e-9
    assert not inspection.around_reversals(~every).size


def test_inspected_instants_are_at_most_a_sixteenth_apart() -> None:
    shares = np.sort(np.concatenate([*INSPECTED, [*TORQUE_SHARES, 1.0]]))
    assert np.diff(shares).max() <= 1.0 / 16.0


def test_joint_with_friction_and_without_reversals_is_inspected() -> None:
    arm = make_arm(rod(4.0, 0.6), effort=EFFORT[:1], friction=(0.6,))
    problem = tm.Problem(arm, [0.0], tm.JointGoal([0.8]))
    solution = tm.plan(problem, intervals=12, control="linear", refine=None)
    assert solution.success, solution.message
    assert solution.status is not tm.Status.FEASIBLE
