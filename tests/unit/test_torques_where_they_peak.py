"""Torques are looked at where they peak: beside turns, and between close instants."""

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
def there_and_back() -> tm.Solution:
    """Rods with dry friction that start the wrong way, and turn inside an interval."""
    arm = make_arm(rod(4.0, 0.6), rod(2.0, 0.5), effort=EFFORT, friction=(0.6, 0.4))
    start, goal = [0.0, 0.0], tm.JointGoal([0.6, -0.5])
    problem = tm.Problem(arm, start, goal, v_start=[-1.5, 1.0], self_collision=False)
    return tm.plan(problem, intervals=13, control="linear", refine=None, effort="quick")


def test_torques_keep_their_limits_beside_turns(there_and_back: tm.Solution) -> None:
    assert there_and_back.success, there_and_back.message
    times = np.linspace(0.0, there_and_back.T, 4001)
    motion = there_and_back.trajectory(times)
    assert np.any(np.diff(np.sign(motion.v[1:-1]), axis=0) != 0.0)
    share = np.abs(motion.u) / np.array(EFFORT)
    assert share.max() < 1.0 + 2.0 * EFFORT_TOLERANCE


def test_turns_have_an_instant_before_and_one_after(
    there_and_back: tm.Solution,
) -> None:
    motion = there_and_back.trajectory
    layout = Layout.of_motion(motion)
    assert layout is not None
    of, z = layout.represented(ProblemFunctions.of(there_and_back.problem), motion)
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


def test_no_peak_is_wide_enough_to_hide_between_instants() -> None:
    shares = np.sort(np.concatenate([*INSPECTED, [*TORQUE_SHARES, 1.0]]))
    assert np.diff(shares).max() <= 1.0 / 16.0


def test_a_joint_with_friction_that_never_turns_is_looked_at_too() -> None:
    arm = make_arm(rod(4.0, 0.6), effort=EFFORT[:1], friction=(0.6,))
    problem = tm.Problem(arm, [0.0], tm.JointGoal([0.8]))
    solution = tm.plan(problem, intervals=12, control="linear", refine=None)
    assert solution.success, solution.message
    assert solution.status is not tm.Status.FEASIBLE
