"""Arms that sweep fast past corners: rows where pairs come nearest between the rows."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.arrays import Array
from tominpmp.certificate.active_limits import Motion
from tominpmp.certificate.clearances import Nearest, nearest_instants
from tominpmp.certificate.task import Task
from tominpmp.status import Status
from tominpmp.transcription.anchoring import with_nearest
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

# A box and a ball, side by side where the tip passes: without further rows the plan
# ended at 3.855 s, of which small changes promised 6 %.
START, GOAL = [2.36108, -0.14796, 1.95794], [2.74605, 0.83243, 2.70663]
BOX = tm.Box("box", size=[0.212, 0.36, 0.274], position=[-3.6765, 1.1352, 0.0])
BALL = tm.Sphere("ball", radius=0.1593, position=[-3.3817, 0.5666, 0.0])


@pytest.fixture(scope="module")
def problem() -> tm.Problem:
    """The arm of the paper between a box and a ball."""
    arm = tm.load_robot("planar3r")
    return tm.Problem(arm, START, tm.JointGoal(GOAL), tm.Scene([BOX, BALL]))


def test_a_motion_that_is_too_close_between_its_rows_is_settled_again(
    problem: tm.Problem,
) -> None:
    solution = tm.plan(problem)

    assert solution.success
    assert solution.T < 2.8
    assert solution.status is Status.CONVERGED
    assert solution.certificate.ok


def test_rows_where_pairs_are_nearest_join_the_others(problem: tm.Problem) -> None:
    system = ProblemFunctions.of(problem)
    shares = np.full((6, 2), 1.0 / 12.0)
    of = InverseTranscription(system, shares, 3.0)
    start, end = np.array(START), np.array(GOAL)
    z = of.start(lambda t: start + np.multiply.outer(t / 3.0, end - start), 3.0)
    program = NonlinearProgram.of(of).at(z)
    nearest = nearest_instants(Motion.of(Task.of(problem), of.trajectory(z)))
    instants = np.unique(nearest.times).size
    assert instants

    more = with_nearest(program, z, nearest)
    none = with_nearest(program, z, Nearest.none(system.n))

    before, after = program.evaluate(z), more.evaluate(z)
    assert after.size == before.size + instants * len(problem.checker.pairs)
    # Nothing at the old instants is as near as what is between them.
    lacks = [_clearance(one, z).max() for one in (program, more)]
    assert lacks[1] > lacks[0]
    np.testing.assert_array_equal(none.evaluate(z), before)


def _clearance(program: NonlinearProgram, z: Array) -> Array:
    """What distances lack at the instants of a program."""
    of = program.transcription
    (block,) = (one for one in program.blocks if one.name == "clearance")
    _, states = block.states(of, of.motion(z))
    return block.constraint.evaluate(states)
