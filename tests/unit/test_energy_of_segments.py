"""Time against energy over several segments: closed forms, payloads, dwells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tominpmp as tm
from tests.energy_derivatives import check_gradient
from tests.sample_arms import make_arm, slide, swinging_arm
from tominpmp.motion.measures import ENERGIES
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.layout import Layout
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.verification.verification import verify

RAIL = make_arm(slide(1.0), effort=np.array([100.0]))
LIFT = make_arm(
    slide(1.0, axis=(0.0, 0.0, 1.0)),
    effort=np.array([200.0]),
    gravity=(0.0, 0.0, -9.81),
)


def closed_form(distance: float, weight: float = 1.0, mass: float = 1.0) -> float:
    """Optimal cost of a mass on a rail from rest to rest without limits."""
    return 4.0 / 3.0 * (36.0 * weight * mass**2 * distance**2) ** 0.25


def to(q: float, **fields) -> tm.Segment:
    return tm.Segment(tm.JointGoal([q]), **fields)


def planned(segments, weight=1.0, robot=RAIL, **options):
    problem = tm.Problem(robot, [0.0], segments=segments)
    solution = tm.plan(problem, energy_weight=weight, **options)
    assert solution.success, solution.message
    assert solution.verification.ok
    return solution


@pytest.mark.parametrize(
    ("segments", "expected"),
    [
        # With a stop the costs add up: accelerations jump at the stop.
        ([to(1.0, stop=True), to(3.0)], closed_form(1.0) + closed_form(2.0)),
        ([to(1.0, dwell=0.2), to(3.0)], closed_form(1.0) + closed_form(2.0) + 0.2),
        # There and back: the mass stops at the reversal without a demand.
        ([to(1.0), to(0.0)], 2.0 * closed_form(1.0)),
        # The via point is on the optimal path.
        ([to(1.0), to(3.0)], closed_form(3.0)),
    ],
    ids=["stop", "dwell", "back", "passed"],
)
def test_cost_of_a_rail_with_via_points_matches_the_closed_form(segments, expected):
    solution = planned(segments)
    assert solution.cost == pytest.approx(expected, rel=1e-6)
    assert "locally optimal trade" in solution.message


def test_payload_of_each_segment_enters_the_cost():
    load = tm.Payload(3.0, "tip")
    segments = [to(1.0, payload=load, stop=True), to(0.0)]
    solution = planned(segments, weight=0.5)
    expected = closed_form(1.0, 0.5, mass=4.0) + closed_form(1.0, 0.5)
    assert solution.cost == pytest.approx(expected, rel=1e-6)
    loaded, empty = solution.segments
    assert loaded.duration == pytest.approx(2.0 * empty.duration, rel=1e-4)


def test_motion_file_holds_where_accelerations_jump(tmp_path):
    load = tm.Payload(2.0, "tip")
    segments = [to(1.0, dwell=0.1), to(0.2, payload=load), to(1.4)]
    robot = make_arm(slide(1.0), effort=np.array([10.0]))
    solution = planned(segments, 0.05, robot, intervals=12)
    jumps = np.array(solution.trajectory.segment_ends[:-1])
    before, after = (solution.trajectory(t).a for t in (jumps - 1e-9, jumps + 1e-9))
    assert np.abs(before - after).max() > 1.0
    for ending in ("csv", "npz"):
        path = solution.export(tmp_path / f"motion.{ending}")
        read = tm.load_motion(path)
        np.testing.assert_allclose(read.segment_ends, solution.trajectory.segment_ends)
        verdict = tm.verify(solution.problem, read)
        assert verdict.ok, verdict.message


def test_dwell_under_gravity_takes_energy():
    stopping, dwelling = (
        planned([to(0.3, **how), to(0.0)], 1e-3, LIFT, intervals=16)
        for how in ({"stop": True}, {"dwell": 0.4})
    )
    held = 0.4 * 9.81**2
    assert dwelling.energy - stopping.energy == pytest.approx(held, rel=1e-4)
    assert dwelling.T - stopping.T == pytest.approx(0.4, rel=1e-4)


def test_tool_speed_limit_of_a_segment_holds_with_an_energy_weight():
    slow = (tm.ToolSpeed("tip", 0.4),)
    solution = planned([to(1.0, constraints=slow, stop=True), to(0.0)], intervals=20)
    slow_part, free = solution.segments
    assert np.abs(slow_part.trajectory.v).max() < 0.4 * 1.005
    assert slow_part.duration > 2.5
    assert free.duration == pytest.approx(2.449490, rel=1e-4)


@pytest.fixture(scope="module")
def two_links():
    """A problem with via point, payload and dwell; its options and fastest motion."""
    arm = swinging_arm(22.0, 12.0)
    place = tm.PositionGoal("tip", (0.9, 1.2, 0.0), tolerance=0.05)
    segments = [
        tm.Segment(tm.JointGoal([0.8, 0.1])),
        tm.Segment(place, payload=tm.Payload(0.4, "tip"), dwell=0.1),
        tm.Segment(tm.JointGoal([0.3, 0.4])),
    ]
    problem = tm.Problem(arm, [0.3, 0.4], segments=segments)
    quick = tm.Options(intervals=12, starts=1, refine=None)
    return problem, quick, tm.plan(problem, quick)


@pytest.mark.parametrize("measure", ["torque_squared", "work"])
def test_energy_plan_spends_less_and_is_verified(two_links, measure):
    problem, quick, fastest = two_links
    options = quick.changed({"energy": measure, "energy_weight": 1e-2})
    solution = tm.plan(problem, options)
    assert solution.success, solution.message
    assert verify(problem, solution.trajectory).ok
    spent = tm.plan(problem, options.changed({"energy_weight": 0.0})).energy
    assert solution.energy < spent
    assert solution.cost < fastest.T + 1e-2 * spent
    assert solution.certificate.message.startswith("This is about the duration alone")


def program_of(fastest, degree, breaks):
    """A program of splines whose accelerations may jump at the ends of segments."""
    problem, motion = fastest.problem, fastest.trajectory
    layout = Layout.of_motion(motion, problem.segments).with_intervals(24)
    where = layout.segment_ends[:-1] if breaks else ()
    layout = replace(layout, degree=degree, breaks=where)
    return layout.represented(ProblemFunctions.of(problem), motion)


@pytest.mark.parametrize("kind", ENERGIES.values(), ids=ENERGIES)
@pytest.mark.parametrize(
    ("degree", "breaks"), [(2, False), (3, False), (3, True)], ids=str
)
def test_energy_gradient_of_segments_matches_differences(
    two_links, degree, breaks, kind
):
    program, z = program_of(two_links[2], degree, breaks)
    rng = np.random.default_rng(1)
    z = z + 1e-3 * rng.standard_normal(z.size)
    check_gradient(program, kind, z, rng, step=1e-7, rel=1e-4)


def test_accelerations_jump_at_breaks_only(two_links):
    program, z = program_of(two_links[2], 3, True)
    rng = np.random.default_rng(2)
    of = program.transcription
    z = z + 1e-2 * rng.standard_normal(z.size)
    motion = of.trajectory(z)
    ends = {segment[1] for segment in of.segments[:-1]}
    plain = of.motion(z)
    t = np.cumsum(plain.h)[:-1]
    nodes = np.arange(1, of.intervals)
    before = of.states(plain, Instants(nodes - 1, np.ones(t.size)), 2)
    after = of.states(plain, Instants(nodes, np.zeros(t.size)), 2)
    np.testing.assert_allclose(before.q, after.q, atol=1e-12)
    np.testing.assert_allclose(before.v, after.v, atol=1e-9)
    jumps = np.abs(before.a - after.a).max(axis=1) > 1e-6
    assert set(nodes[jumps].tolist()) == ends
    assert motion.degree == 3
