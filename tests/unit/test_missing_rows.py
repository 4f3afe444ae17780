"""Row exchange between nodes adds the rows that are missing, and no row twice."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, rod
from tominpmp.initial_guess.guess import straight_guess
from tominpmp.options import Options
from tominpmp.planner.first_program import first_program
from tominpmp.transcription.blocks import SampledRows
from tominpmp.transcription.exchange import Inspection, exchanged
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.layout import Layout
from tominpmp.transcription.problem_functions import ProblemFunctions

# The second joint is so strong that it never comes near its limit.
EFFORT = (12.0, 4.0e3)


@pytest.fixture(scope="module", params=["constant", "linear"])
def hasty(request: pytest.FixtureRequest):
    """A program, and a motion of it that is much too fast for one joint of two."""
    arm = make_arm(rod(4.0, 0.6), rod(2.0, 0.5), effort=EFFORT)
    problem = tm.Problem(arm, [0.0, 0.0], tm.JointGoal([0.9, 0.4]))
    system = ProblemFunctions.of(problem).without_self_collision
    options = Options(method="inverse", intervals=6, control=request.param)
    guess = straight_guess(system, problem.goal.configuration)
    program, z = first_program(system, options, guess)
    z = program.time_scale(z, 0.4)
    return program.at(z), z


def torques(program) -> SampledRows:
    return next(block for block in program.blocks if block.name == "torque")


def test_row_exchange_adds_no_instant_that_has_its_rows(hasty) -> None:
    program, z = hasty
    more = exchanged(program, z)
    assert more is not None
    assert torques(more).fixed.size > torques(program).fixed.size
    # The motion is the same: its violated rows are in the program by now.
    assert exchanged(more, z) is None


def test_row_exchange_adds_instants_of_another_motion_once(hasty) -> None:
    program, z = hasty
    more = exchanged(program, z)
    assert more is not None
    faster = more.time_scale(z, 0.03)
    again = exchanged(more.at(faster), faster) or more
    pairs = torques(again).fixed.pairs
    assert len(pairs) > torques(program).fixed.size
    assert len(set(pairs)) == len(pairs)


def whipping(control: str, pace: float, swing: float = 0.2):
    """A program of an arm that swings to and fro, and a motion of it at some pace."""
    arm = make_arm(
        rod(4.0, 0.6), rod(2.0, 0.5), rod(1.0, 0.4), effort=(200.0, 80.0, 20.0)
    )
    problem = tm.Problem(arm, [0.0, 0.0, 0.0], tm.JointGoal([0.9, 0.4, -1.2]))
    system = ProblemFunctions.of(problem).without_self_collision
    options = Options(method="inverse", intervals=12, control=control)
    guess = straight_guess(system, problem.goal.configuration)
    program, z = first_program(system, options, guess)
    points = z[:-1] + swing * np.sin(0.9 * np.arange(z.size - 1))
    z = program.time_scale(np.append(points, z[-1]), pace)
    return program.at(z), z


@pytest.mark.parametrize("control", ["constant", "linear"])
@pytest.mark.parametrize("pace", [0.9, 1.2, 1.6, 2.2, 3.0])
def test_inspection_of_jumps_misses_no_violated_instant(control, pace) -> None:
    program, z = whipping(control, pace)
    of, block = program.transcription, torques(program)
    motion, tolerance = of.motion(z), 1e-3
    inspection = Inspection(block, motion, tolerance)
    found = inspection.violated_jumps()
    worst = {}
    for shares in of.inspected:
        at = Instants.spread(of.intervals, shares)
        excess = inspection.excess(at)
        for row in np.flatnonzero(np.any(excess > tolerance, axis=1)).tolist():
            part = int(at.interval[row]), shares
            worst[part] = max(worst.get(part, 0.0), float(excess[row].max()))
    parts = {
        (interval, shares)
        for interval, share in zip(found.interval, found.share, strict=True)
        for shares in of.inspected
        if share in shares
    }
    assert parts == set(worst)
    if worst:
        largest = inspection.excess(found).max()
        assert largest == pytest.approx(max(worst.values()), rel=1e-12)


# A wedge at the end of an arm of 1 m.
WEDGE = """<robot name="sweeper"><link name="base"/><link name="blade">
<inertial><origin xyz="0.5 0 0"/><mass value="1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.09" iyz="0" izz="0.09"/></inertial>
<collision><origin xyz="0.9 0 0" rpy="0 0 0.7853981633974483"/>
<geometry><box size="0.14142135623731 0.14142135623731 0.02"/></geometry></collision>
</link><joint name="turn" type="revolute"><parent link="base"/><child link="blade"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="50" velocity="10"/></joint>
<link name="tip"/><joint name="end" type="fixed"><parent link="blade"/>
<child link="tip"/><origin xyz="1 0 0"/></joint></robot>"""


def test_corners_that_pass_each_other_within_a_step_get_a_row(tmp_path) -> None:
    # At 8 m/s the corners are closer than the margin for 0.1 ms, by 0.15 mm.
    (tmp_path / "sweeper.urdf").write_text(WEDGE)
    arm, margin, size = tm.load_robot(tmp_path / "sweeper.urdf"), 1e-3, 0.1
    for angle in np.linspace(0.9, 1.1, 10):
        placement, turn = np.eye(4), angle + 0.25 * np.pi
        placement[:2, 0] = np.cos(turn), np.sin(turn)
        placement[:2, 1] = -np.sin(turn), np.cos(turn)
        away = 1.0 + 0.85 * margin + size / np.sqrt(2.0)
        placement[:2, 3] = away * np.cos(angle), away * np.sin(angle)
        corner = tm.Box("corner", position=placement, size=3 * [size])
        goal = tm.JointGoal([2.0])
        problem = tm.Problem(arm, [0.0], goal, scene=[corner], margin=margin)
        system = ProblemFunctions.of(problem).padded(0.01)
        options = Options(intervals=20, control="linear")
        guess = straight_guess(system, goal.configuration)
        program, z = first_program(system, options, guess)
        blocks = program.at(z).blocks
        clearance = next(block for block in blocks if block.name == "clearance")
        inspection = Inspection(clearance, program.transcription.motion(z))
        found = inspection.worst_instants()
        assert found.size == 1
        assert inspection.excess(found).max() * system.reach > 1e-4


def test_torque_rates_are_inspected_on_their_own_segment() -> None:
    def reaching(first: float, second: float) -> tm.Problem:
        there = [0.8, -1.0, 1.2, -1.6, -1.5, 0.5], [1.5, -1.3, 1.4, -1.6, -1.5, 0.5]
        segments = [
            tm.Segment(tm.JointGoal(q), motion_limits=tm.MotionLimits(effort_rate=most))
            for q, most in zip(there, (first, second), strict=True)
        ]
        start = [0.0, -1.2, 1.5, -1.8, -1.5, 0.0]
        return tm.Problem(tm.load_robot("ur5"), start, segments=segments)

    quick = tm.plan(reaching(1e5, 1e5), effort="quick", refine=None)
    problem = reaching(1e5, 400.0)
    layout = Layout.of_motion(quick.trajectory, problem.segments)
    program, z = layout.represented(ProblemFunctions.of(problem), quick.trajectory)
    of = program.transcription
    more = exchanged(program, z)
    assert more is not None
    for before, after in zip(program.blocks, more.blocks, strict=True):
        if before.name == "torque rate on segment 2":
            joined = after.fixed.interval[before.fixed.size :]
            assert joined.size
            assert joined.min() >= of.segment_ends[0]


def test_torque_rates_assume_no_directions_of_joints_with_dry_friction() -> None:
    """Its jumps are left out of the rates; a joint that turned counted as a change."""
    friction = np.array([0.2, 0.2])
    arm = make_arm(rod(4.0, 0.6), rod(2.0, 0.5), effort=EFFORT, friction=friction)
    limits = tm.MotionLimits(effort_rate=1e12)
    problem = tm.Problem(arm, [0, 0], tm.JointGoal([0.9, 0.4]), motion_limits=limits)
    system = ProblemFunctions.of(problem).without_self_collision
    guess = straight_guess(system, problem.goal.configuration)
    options = Options(intervals=6, control="linear")
    program, z = first_program(system, options, guess)
    blocks = {block.name: block for block in program.at(z).blocks}
    assert blocks["torque"].constraint.motors.signs is not None
    rates = blocks["torque rate"]
    assert rates.constraint.motors.signs is None
    # Too fast a motion to and fro, with torques far beyond their limits.
    wild = z + 3.0 * np.random.default_rng(0).normal(size=z.size) * (program.cost == 0)
    motion = program.transcription.motion(program.time_scale(wild, 0.2))
    assert Inspection(blocks["torque"], motion).exchanged()[1]
    assert not Inspection(rates, motion).exchanged()[1]
