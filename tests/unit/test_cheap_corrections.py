"""What keeps the linear programs of a plan few and short."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

import tominpmp as tm
from tominpmp.linear_programs import LinearProgram, make_solver
from tominpmp.solvers.correction import least_change
from tominpmp.transcription.blocks import Sampled
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram


def test_the_least_change_keeps_the_rows_and_is_the_smallest():
    rng = np.random.default_rng(3)
    matrix, missed = rng.normal(size=(4, 9)), 1e-2 * rng.normal(size=4)
    scale = rng.uniform(0.5, 2.0, 9)
    change = least_change(sp.csr_matrix(matrix), missed, scale, small=1e-8)
    expected = scale * (np.linalg.pinv(matrix * scale) @ missed)
    assert change == pytest.approx(expected, abs=1e-6)


def test_rows_that_contradict_each_other_are_met_half_way():
    twice = sp.csr_matrix(np.array([[1.0, 0.0], [1.0, 0.0]]))
    change = least_change(twice, np.array([0.0, 2.0]), np.ones(2))
    assert change == pytest.approx([1.0, 0.0], abs=1e-5)


def test_what_a_program_leaves_free_stays_near_zero():
    free = LinearProgram(
        cost=np.array([1.0, 0.0]),
        matrix=sp.csc_matrix(np.array([[1.0, 1.0]])),
        row_lower=np.array([-1.0]),
        row_upper=np.array([5.0]),
        lower=np.array([-1.0, -0.2]),
        upper=np.array([1.0, 2.0]),
        row_keys=np.arange(1),
        column_keys=np.arange(2),
    )
    wanders = make_solver("piqp").solve(free)
    stays = make_solver("piqp").solve(replace(free, nearness=np.array([0.0, 1e-2])))
    assert abs(wanders.x[1]) > 0.1
    assert stays.x == pytest.approx([-1.0, 0.0], abs=0.03)


@pytest.fixture(scope="module")
def torque_block():
    robot = tm.load_robot("planar3r")
    limits = robot.limits
    middle = 0.5 * (limits.position_lower + limits.position_upper)
    problem = tm.Problem(robot, middle, tm.JointGoal(middle + 0.1))
    system = ProblemFunctions.of(problem)
    of = InverseTranscription(system, np.full((4, 1), 0.25), 1.0)
    blocks = NonlinearProgram.of(of).blocks
    return next(block for block in blocks if block.name == "torque")


def test_new_instants_have_rows_for_what_is_at_stake_there_alone(torque_block: Sampled):
    more = Instants(np.array([0, 1]), np.array([0.25, 0.25]))
    ignored = np.array([[True, False, True], [False, True, True]])
    before = torque_block.lower.shape[0]
    block = torque_block.with_instants(more, ignored)
    assert np.isfinite(block.upper[:before]).all()
    assert np.array_equal(np.isinf(block.upper[before:]), ignored)
    whole = block.with_instants(Instants(np.array([1]), np.array([0.75])), None)
    assert np.isfinite(whole.upper[-1]).all()
    assert np.array_equal(np.isinf(whole.upper[before:-1]), ignored)
