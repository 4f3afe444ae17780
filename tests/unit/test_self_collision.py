"""Self-collision: links keep clear of each other, also without obstacles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clocks import Clock
from optimum_cases import HANGING, ROD, ROD_WEIGHT, UPRIGHT
from robot_samples import INERTIAL, joint, link, load, robot
from sample_arms import DOWNWARD, describe

import tominpmp as tm
from tominpmp.collision.checker import CollisionChecker
from tominpmp.initial_guess.guess import Guess
from tominpmp.planner import descent
from tominpmp.planner.automatic_options import resolve_options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.descent import descent_work
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.torque_starts import torques_may_lead
from tominpmp.transcription.problem_functions import ProblemFunctions

# The straight line between these configurations leads the wrist of a Panda through its
# base.
FOLDED = [1.1983, 1.5287, -0.6743, -2.9015, 2.2466, 1.8704, 0.3356]
TURNED = [-2.3445, 1.3482, 2.7482, -2.7004, 1.2406, 2.9528, 0.9919]
FINGERS = {"panda_finger_joint1": 0.0, "panda_finger_joint2": 0.0}


def through_itself(**changes: object) -> tm.Problem:
    panda = tm.load_robot("panda", limits="urdf", locked_joints=FINGERS)
    return tm.Problem(panda, FOLDED, tm.JointGoal(TURNED), **changes)


def colliding_on_the_way() -> tm.Problem:
    # Eight times as fast, so that torques rule, and the search begins on coarse grids.
    ur5 = tm.load_robot("ur5", limits="urdf")
    fast = ur5.with_changes(velocity=8.0 * ur5.limits.velocity)
    start, goal = [-1.2, 0.3, 0.9, 2.3, 2.3, -1.5], [1.5, 0.8, -0.7, 1.7, 2.4, -0.1]
    return tm.Problem(fast, start, tm.JointGoal(goal))


def meshes_touch(problem: tm.Problem, motion: tm.Trajectory) -> bool:
    meshes = CollisionChecker(
        problem.robot, tm.Scene(), self_collision=True, geometry="mesh"
    )
    times = np.linspace(0.0, motion.duration, 400)
    return not all(meshes.is_free(q) for q in motion(times).q)


def test_plan_without_obstacles_avoids_self_collision() -> None:
    problem = through_itself()
    solution = tm.plan(problem)
    assert solution.success
    assert not meshes_touch(problem, solution.trajectory)
    assert 0.0 < solution.verification.min_clearance < np.inf
    assert solution.prove_clearance().contact is False


def test_replay_rejects_self_collision() -> None:
    straight = {"control": "constant", "effort": "quick", "refine": None}
    blind = tm.plan(through_itself(self_collision=False), **straight)
    problem = through_itself()
    assert blind.success
    assert meshes_touch(problem, blind.trajectory)
    found = tm.verify(problem, blind.trajectory)
    assert not found.ok
    assert found.worst["clearance"].violated
    assert "panda_link" in found.message
    assert found.min_clearance < -0.04


def test_self_collision_on_a_coarse_grid_is_resolved_before_replay(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = colliding_on_the_way()
    replays: list[bool] = []
    usual = Candidate.verified

    def verified(self: Candidate, *arguments: Any, **changes: Any) -> Candidate:
        candidate = usual(self, *arguments, **changes)
        replays.append(candidate.touches)
        return candidate

    monkeypatch.setattr(Candidate, "verified", verified)
    solution = tm.plan(problem, effort="quick", refine=None, intervals=24)
    assert solution.success, solution.message
    assert replays
    assert not any(replays)


@pytest.mark.parametrize(("elbow", "touch"), [(1.0, False), (3.0, True)])
def test_guess_with_self_collision_gets_self_collision_rows(
    elbow: float, touch: bool
) -> None:
    """Regression: the time of an iCub was spent on a motion without these rows; T was
    2.33 s in place of 0.24 s.
    """
    ur5 = tm.load_robot("ur5")
    begin, middle = [0.0, -1.5, 1.0, 0.0, 0.5, 0.0], [0.3, -1.5, elbow, 0.0, 0.5, 0.0]
    problem = tm.Problem(ur5, begin, tm.JointGoal([0.6, -1.5, 1.0, 0.0, 0.5, 0.0]))
    state = PlanState(problem, resolve_options(problem, tm.Options()))
    system, t = ProblemFunctions.of(problem), np.linspace(0.0, 4.0, 201)
    ends = np.stack([begin, middle, problem.goal.q])
    q = np.stack([np.interp(t, [0.0, 2.0, 4.0], x) for x in ends.T], axis=1)
    guess = Guess("by the elbow", t, q, timed=True)
    work = descent_work(system, state.options, guess, state)
    assert work.self_collision_rows is touch


def test_interrupted_resolution_of_self_collision_leaves_a_motion() -> None:
    problem = colliding_on_the_way()

    def late(record: tm.IterationRecord) -> bool:
        return record.start > 1  # after starts without and with self-collision rows

    few = {"intervals": 24, "max_planning_time": 300.0}
    solution = tm.plan(problem, callback=late, **few)
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.success, solution.message


def test_motion_that_touches_is_not_replayed_again_at_the_time_limit(
    monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    """Regression: the motion without self-collision rows was replayed again, and
    reported as refuted. A path around the links, slowed down, is left.
    """
    usual, replayed = Candidate.verified, []

    def verified(self: Candidate, *arguments: Any, **changes: Any) -> Candidate:
        candidate = usual(self, *arguments, **changes)
        clock.advance(0.0 if replayed else 60.0)
        replayed.extend([self.trajectory.duration] * candidate.feasible)
        return candidate

    monkeypatch.setattr(Candidate, "verified", verified)
    monkeypatch.setattr(descent, "is_free", lambda *_: True)  # the guess counts as free
    problem, motion = through_itself(), {"control": "constant", "refine": None}
    solution = tm.plan(problem, effort="quick", max_planning_time=60.0, **motion)
    assert solution.status is tm.Status.TIME_LIMIT
    assert solution.success and solution.verification.ok, solution.message
    assert replayed[0] not in replayed[1:]


def test_self_collision_check_does_not_slow_down_a_clear_motion() -> None:
    ur5 = tm.load_robot("ur5", limits="urdf")
    ends = [0.0, -1.2, 1.0, 0.0, 0.5, 0.0], [1.5, -0.8, 0.4, 0.3, -0.5, 1.0]
    watched, blind = (
        tm.plan(tm.Problem(ur5, ends[0], tm.JointGoal(ends[1]), self_collision=own))
        for own in (None, False)
    )
    assert watched.success
    assert watched.T == blind.T
    assert watched.verification.min_clearance < np.inf
    assert blind.verification.min_clearance == np.inf


def swinging_arm(tmp_path: Path) -> tm.Robot:
    """A weak pendulum with shapes, beside a box that it does not come near."""
    box = "<collision><geometry><box size='{0} 0.02 0.02'/></geometry></collision>"
    urdf = describe([ROD]).replace(
        '<link name="base"/>',
        f'<link name="base">{box.format("0.1")}</link><link name="post">'
        f'{box.format("0.1")}</link><joint name="fixed" type="fixed"><parent '
        'link="base"/><child link="post"/><origin xyz="0 0 3"/></joint>',
    )
    urdf = urdf.replace(
        '<link name="link1">', f'<link name="link1">{box.format("1.0")}'
    )
    (tmp_path / "arm.urdf").write_text(urdf)
    (tmp_path / "arm.srdf").write_text(
        '<robot name="sample"><disable_collisions link1="base" link2="link1" '
        'reason="Adjacent"/></robot>'
    )
    return tm.load_robot(
        tmp_path / "arm.urdf",
        srdf=tmp_path / "arm.srdf",
        effort=0.6 * ROD_WEIGHT,
        gravity=DOWNWARD,
    )


def test_weak_pendulum_with_collision_shapes_swings_up(tmp_path: Path) -> None:
    arm = swinging_arm(tmp_path)
    problem = tm.Problem(arm, [HANGING], tm.JointGoal([UPRIGHT]))
    assert problem.checker.pairs
    assert torques_may_lead(ProblemFunctions.of(problem))
    solution = tm.plan(problem, effort="quick")
    assert solution.success
    assert 2.0 < solution.verification.min_clearance < np.inf


def test_self_collision_at_the_start_names_the_remedies() -> None:
    arm = tm.load_robot("ur5", limits="urdf")
    folded = [0.0, -1.0, 3.1, 0.0, 0.0, 0.0]
    with pytest.raises(tm.ProblemError, match="they overlap as described") as caught:
        tm.Problem(arm, folded, tm.JointGoal(np.zeros(6)))
    assert "disable_collisions" in str(caught.value)
    assert "self_collision=False" in str(caught.value)
    assert (
        tm.Problem(
            arm, folded, tm.JointGoal(np.zeros(6)), self_collision=False
        ).checker.pairs
        == ()
    )


def test_self_collision_at_the_start_leaves_out_pairs_that_may_touch() -> None:
    arm = tm.load_robot("ur5", limits="urdf")
    folded, goal = [2.4, -0.8, 2.9, -3.0, 0.4, 2.5], tm.JointGoal(np.zeros(6))
    pairs = [("upper_arm_link", "wrist_1_link")]
    overlap = r"'shoulder_link' and 'wrist_1_link' overlap .* their meshes do not"
    with pytest.raises(tm.ProblemError, match=overlap):
        tm.Problem(arm, folded, goal, may_touch=pairs)


@pytest.mark.parametrize("value", ("yes", 1, np.zeros(3)))
def test_self_collision_must_be_a_boolean(value: object) -> None:
    with pytest.raises(tm.ProblemError, match=r"^self_collision is "):
        through_itself(self_collision=value)


def arm_of_boxes(tmp_path: Path, size: str) -> tm.Robot:
    """Three links in a row; the last has the given size, and reaches the first."""
    shape = "<collision><geometry><box size='{0}'/></geometry></collision>"
    return load(
        tmp_path,
        robot(
            link("base", ""),
            link("l1", INERTIAL + shape.format("0.5 0.1 0.1")),
            link("l2", INERTIAL + shape.format("0.1 0.1 0.1")),
            link("l3", INERTIAL + shape.format(size)),
            joint("j1", "base", "l1"),
            joint("j2", "l1", "l2"),
            joint("j3", "l2", "l3"),
        ),
    )


def test_only_pairs_that_always_overlap_are_dropped(tmp_path: Path) -> None:
    # Links that overlap at two thirds of the configurations remain a pair.
    always = arm_of_boxes(tmp_path, "9 9 9")
    assert not CollisionChecker(always, tm.Scene(), self_collision=True).pairs
    mostly = arm_of_boxes(tmp_path, "3 3 0.1")
    checker = CollisionChecker(mostly, tm.Scene(), self_collision=True)
    q = np.random.default_rng(0).uniform(-1.0, 2.0, size=(400, 3))
    share = np.mean(np.any(checker.distances(q) < 0.0, axis=1))
    assert 0.5 < share < 0.95
    assert {frozenset(pair) for pair in checker.pairs} == {frozenset(("l1", "l3"))}


def test_descents_beside_links_that_overlap_everywhere_end_early() -> None:
    """All motions like the straight one overlap; coarse grids lead round the base."""
    ur3 = tm.load_robot("ur3", limits="urdf")
    fast = ur3.with_changes(velocity=4.0 * ur3.limits.velocity)
    start = [-2.7157, 2.7765, 0.8027, 1.9723, -2.6815, 1.5464]
    goal = tm.JointGoal([1.4104, -0.8272, 2.5932, -2.5983, 2.6347, -1.2143])
    solution = tm.plan(tm.Problem(fast, start, goal), max_planning_time=np.inf)
    assert solution.success, solution.message
    assert solution.T < 0.5
    assert len(solution.history) < 60
