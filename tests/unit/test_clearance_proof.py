"""`prove_clearance`: proofs of a least clearance at all times of a motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.collision.checker import CollisionChecker
from tominpmp.exceptions import ProblemError
from tominpmp.motion.trajectory import Trajectory
from tominpmp.robot.robot import Robot
from tominpmp.scene.obstacles import Box, Sphere
from tominpmp.scene.scene import Scene
from tominpmp.verification.clearance import prove_clearance
from tominpmp.verification.closest_approach import ClosestApproach
from tominpmp.verification.replay import planned


def turning(robot: Robot, first: float, last: float, intervals: int = 4) -> Trajectory:
    """The stretched arm turns about its base at constant speed in one second."""
    t = np.linspace(0.0, 1.0, intervals + 1)
    q, v = np.zeros((t.size, 3)), np.zeros((t.size, 3))
    q[:, 0] = first + (last - first) * t
    v[:, 0] = last - first
    a = np.zeros((intervals, 3))
    return Trajectory(robot.joint_names, t, q, v, 0.0 * q, a)


def wandering(robot: Robot, rng: np.random.Generator) -> Trajectory:
    """A random motion of a few intervals."""
    n, t = robot.n, np.linspace(0.0, 0.8, 6)
    h = np.diff(t)[:, None]
    a = rng.normal(scale=8.0, size=(5, n))
    v = np.concatenate([rng.normal(size=(1, n)), np.zeros((5, n))])
    v[1:] = v[0] + np.cumsum(h * a, axis=0)
    low, high = robot.limits.position_lower, robot.limits.position_upper
    start = rng.uniform(low, high)[None]
    q = np.concatenate([start, start + np.cumsum(h * (v[:-1] + 0.5 * h * a), axis=0)])
    return Trajectory(robot.joint_names, t, q, v, 0.0 * q, a)


def tip_sphere(angle: float, radius: float, distance: float) -> Scene:
    """A ball at an angle and a distance from the base."""
    position = distance * np.array([np.cos(angle), np.sin(angle), 0.0])
    return Scene([Sphere("ball", radius=radius, position=position)])


def test_contact_between_nodes_is_found(planar3r: Robot) -> None:
    motion = turning(planar3r, 0.2, 2.2)
    # A small ball in the way, between the middles and the ends of the four intervals.
    checker = CollisionChecker(planar3r, tip_sphere(0.2 + 2.0 * 0.3, 0.02, 5.5))
    sampled = np.linspace(0.0, 1.0, 9)
    assert np.min(checker.distances(motion(sampled).q)) > 0.1
    found = prove_clearance(checker, motion)
    assert not found.proved and found.contact
    assert found.bound == -np.inf
    assert found.time == pytest.approx(0.3, abs=0.02)
    assert found.distance < 0.0
    assert found.pair is not None and found.pair[1] == "ball"
    assert "Not clear" in found.message


def test_clearance_is_proved_up_to_the_least_distance(planar3r: Robot) -> None:
    motion = turning(planar3r, 0.2, 2.2)
    # The tip passes at a distance that is known.
    checker = CollisionChecker(planar3r, tip_sphere(1.0, 0.1, 7.0))
    least = float(np.min(checker.distances(motion(np.linspace(0.3, 0.5, 4001)).q)))
    found = prove_clearance(checker, motion, 0.9 * least)
    assert found.proved and not found.contact
    assert 0.9 * least - 1e-4 <= found.bound <= least
    assert found.distance >= least - 1e-9
    assert "at all times" in found.message
    close = prove_clearance(checker, motion, least, slack=1e-3)
    assert close.proved
    assert least - 1e-3 <= close.bound <= least
    assert close.time == pytest.approx(0.4, abs=0.02)
    assert not prove_clearance(checker, motion, 1.001 * least).proved


def test_closest_approach_is_that_of_the_whole_motion(planar3r: Robot) -> None:
    motion = turning(planar3r, 0.2, 2.3)
    checker = CollisionChecker(planar3r, tip_sphere(1.0, 0.1, 7.0))
    least = float(np.min(checker.distances(motion(np.linspace(0.3, 0.5, 4001)).q)))
    found = prove_clearance(checker, motion, 0.1)
    assert found.proved
    assert found.distance == pytest.approx(least, abs=1e-5)


def test_proof_ends_undecided_after_the_largest_number_of_stretches(
    planar3r: Robot,
) -> None:
    motion = turning(planar3r, 0.2, 2.2)
    checker = CollisionChecker(planar3r, tip_sphere(1.0, 0.1, 7.0))
    found = prove_clearance(checker, motion, 0.8989, max_stretches=4)
    assert not found.proved and not found.contact
    assert "Neither" in found.message


def test_proof_rejects_a_motion_of_other_joints(planar3r: Robot) -> None:
    """Regression: the proof compared only the number of joints."""
    motion = replace(turning(planar3r, 0.2, 2.2), joint_names=("one", "two", "three"))
    with pytest.raises(ProblemError, match="a motion of one, two, three, expected a"):
        prove_clearance(CollisionChecker(planar3r, Scene()), motion)


def test_deviation_of_the_real_motion_reduces_the_proved_clearance(
    planar3r: Robot,
) -> None:
    motion = turning(planar3r, 0.2, 2.2)
    checker = CollisionChecker(planar3r, tip_sphere(1.0, 0.1, 7.0))
    least = float(np.min(checker.distances(motion(np.linspace(0.3, 0.5, 4001)).q)))
    margin = least - 0.02
    assert prove_clearance(checker, motion, margin).proved
    # 0.01 rad at the base are 6 cm at the tip.
    stray = np.array([0.01, 0.0, 0.0])
    assert not prove_clearance(
        checker, motion, margin, deviation=stray, max_stretches=2000
    ).proved


def test_proved_bounds_hold_on_random_motions(
    planar3r: Robot, rng: np.random.Generator
) -> None:
    scene = Scene(
        [
            Box("wall", size=(0.5, 3.0, 1.0), position=(3.5, -2.0, 0.0)),
            Sphere("ball", radius=0.4, position=(-1.5, 3.0, 0.0)),
        ]
    )
    checker = CollisionChecker(planar3r, scene)
    proved = contacts = 0
    for _ in range(14):
        motion = wandering(planar3r, rng)
        sampled = checker.distances(motion(np.linspace(0.0, 0.8, 801)).q)
        least = float(np.min(sampled))
        found = prove_clearance(checker, motion, 0.02, slack=1e-3)
        if found.proved:
            assert 0.019 <= found.bound <= least + 1e-6
            proved += 1
        if found.contact:
            assert least < 0.02
            at = checker.distances(motion(np.array([found.time])).q)
            assert found.distance == pytest.approx(float(np.min(at)), abs=1e-6)
            contacts += 1
        if least < 0.019 - 1e-6:
            assert not found.proved
        elif least > 0.02:
            assert found.proved
    assert proved >= 3 and contacts >= 3


def test_motion_without_pairs_is_proved_at_once(planar3r: Robot) -> None:
    checker = CollisionChecker(planar3r, Scene(), self_collision=False)
    found = prove_clearance(checker, turning(planar3r, 0.2, 2.2))
    assert found.proved and found.pair is None
    assert found.bound == np.inf and found.stretches == 0


def test_cubic_motion_is_proved_as_its_parabolic_equivalent(planar3r: Robot) -> None:
    motion = turning(planar3r, 0.2, 2.2, 12)
    cubic = replace(motion, a=None)
    checker = CollisionChecker(planar3r, tip_sphere(1.0, 0.1, 7.0))
    one, other = (prove_clearance(checker, item, 0.5) for item in (motion, cubic))
    assert one.proved and other.proved
    assert one.bound == pytest.approx(other.bound, abs=1e-9)


# -- messages --------------------------------------------------------------------------


def test_message_has_the_proved_margin_and_the_closest_approach(
    planar3r: Robot,
) -> None:
    """Regression: the message was "Clear by 0.00317 m" for a proved 0.02 m."""
    motion = turning(planar3r, 0.2, 2.2)
    scene = tip_sphere(1.0, 0.1, 7.0)
    checker = CollisionChecker(planar3r, scene, self_collision=False)
    found = prove_clearance(checker, motion, 0.5, slack=0.0)
    assert found.message.startswith(
        "Proved: every pair stays at least 0.5000 m apart (required margin 0.5 m) at "
        "all times; the closest approach measured is link 'link3' and obstacle 'ball', "
    )
    assert found.message.endswith(f"{found.distance:.4f} m at {found.time:.3f} s.")
    (kept,) = found.kept
    assert kept.margin == 0.5 <= kept.bound == found.bound
    # No digit is rounded up.
    for margin, slack, words in (
        (0.49999, 0.0, "at least 0.4999 m apart (required margin 0.5 m)"),
        (0.0, 1e-4, "every pair stays apart (no margin required)"),
    ):
        assert words in prove_clearance(checker, motion, margin, slack=slack).message


def test_message_separates_pairs_of_different_margins(ur5: Robot) -> None:
    t = np.linspace(0.0, 1.0, 3)
    q = np.array([0.0, -1.2, 1.4, 0.3, 0.2, 0.1]) + t[:, None] * [0.5, 0, 0, 0, 0, 0]
    v = np.tile([0.5, 0.0, 0.0, 0.0, 0.0, 0.0], (3, 1))
    motion = Trajectory(ur5.joint_names, t, q, v, 0.0 * q, np.zeros((2, 6)))
    ball = Sphere("ball", radius=0.1, position=(0.0, 0.0, 2.0))
    checker = CollisionChecker(ur5, Scene([ball]), self_collision=True)
    margins = checker.margins(0.3)
    found = prove_clearance(checker, motion, margins, slack=0.0)
    assert found.message.startswith(
        "Proved: links and obstacles stay at least 0.3000 m apart (required margin "
        "0.3 m), links of the robot stay apart (no margin required) at all times; the "
        "least measured clearance is between "
    )
    assert [item.margin for item in found.kept] == [0.3, 0.0]
    assert all(item.bound >= item.margin for item in found.kept)
    assert found.bound == min(item.bound for item in found.kept)
    each = np.linspace(1e-3, 5e-3, margins.size)
    found = prove_clearance(checker, motion, each, slack=0.0)
    words = "every pair keeps its margin at all times, 0.001 to 0.005 m"
    assert words in found.message


def test_message_subtracts_the_slack_from_the_proved_margin(planar3r: Robot) -> None:
    motion = turning(planar3r, 0.2, 2.2)
    checker = CollisionChecker(planar3r, tip_sphere(1.0, 0.1, 7.0))
    least = float(np.min(checker.distances(motion(np.linspace(0.3, 0.5, 4001)).q)))
    found = prove_clearance(checker, motion, least + 0.0005, slack=0.01)
    shown = float(found.message.partition("at least ")[2].partition(" m")[0])
    assert found.bound - 1e-4 < shown <= found.bound <= least
    # The margin is zero with a slack of 1 mm, and the overlap is 0.5 mm.
    touching = CollisionChecker(planar3r, tip_sphere(1.0, 0.1 + least + 5e-4, 7.0))
    found = prove_clearance(touching, motion, slack=1e-3)
    assert found.proved and -1e-3 <= found.bound <= -5e-4
    shown = float(found.message.partition("clear but for ")[2].partition(" m")[0])
    assert -found.bound <= shown < 1e-5 - found.bound


def test_message_names_the_pair_in_contact_and_its_margin(planar3r: Robot) -> None:
    motion = turning(planar3r, 0.2, 2.2)
    checker = CollisionChecker(planar3r, tip_sphere(1.0, 0.1, 7.0))
    least = float(np.min(checker.distances(motion(np.linspace(0.3, 0.5, 4001)).q)))
    found = prove_clearance(checker, motion, least + 0.05)
    assert found.contact and not found.kept
    assert (
        "Not clear: too close are link 'link3' and obstacle 'ball', " in found.message
    )
    assert f"(required margin {least + 0.05:.4g} m)" in found.message


def test_proof_uses_the_obstacles_of_each_segment(planar3r: Robot) -> None:
    """Regression: the proof used the obstacles of the problem on every segment."""
    rest = np.array([0.5, 0.0, 0.0])
    goals = [tm.JointGoal([angle, 0.0, 0.0]) for angle in (1.0, 0.5)]
    ahead = tip_sphere(0.75, 0.1, 6.0)
    ways = [tm.Segment(goals[0], stop=True), tm.Segment(goals[1])]
    free = tm.plan(tm.Problem(planar3r, rest, segments=ways), effort="quick")
    assert free.success and free.prove_clearance().proved
    # The ball is in the way of the second segment alone.
    later = [ways[0], replace(ways[1], scene=ahead)]
    blocked = tm.Problem(planar3r, rest, segments=later)
    found = replace(free, problem=blocked).prove_clearance()
    assert found.contact and found.pair[1] == "ball"
    assert found.time > free.segments[0].end
    # The ball of the problem is out of reach, that of the second segment is not.
    other = tm.Problem(
        planar3r, rest, scene=tip_sphere(0.9, 0.1, 6.6), segments=[ways[0], later[1]]
    )
    assert not replace(free, problem=other).prove_clearance().proved
    # Segments with an empty scene of their own are clear.
    gone = [replace(way, scene=Scene()) for way in ways]
    clear = tm.Problem(planar3r, rest, scene=ahead, segments=gone)
    assert replace(free, problem=clear).prove_clearance().proved


def test_motion_of_zero_duration_is_proved(planar3r: Robot) -> None:
    q = [0.5, 1.7, -1.7]
    scene = Scene([Sphere("ball", radius=0.3, position=(0.0, 2.5, 0.0))])
    problem = tm.Problem(planar3r, q, tm.JointGoal(q), scene=scene, margin=0.02)
    proof = tm.plan(problem).prove_clearance()
    assert proof.proved and proof.distance == pytest.approx(1.257, abs=1e-3)


def test_closest_approach_measures_a_row_at_its_own_time(planar3r: Robot) -> None:
    gate = tm.Box("gate", size=(1, 1, 1), motion=tm.ConstantVelocity((0, 0.5, 0)))
    checker = CollisionChecker(planar3r, Scene([replace(gate, position=(0, -9, 0))]))
    rows = planned(turning(planar3r, 0.2, 0.9)).between(1.0, 1.0)
    search = ClosestApproach(checker, rows, np.zeros(len(checker.pairs))).run()
    assert search.time == pytest.approx(1.0)
    nearest = np.min(checker.distances(rows.q, times=np.ones(1)))
    assert search.clearance == pytest.approx(nearest)
