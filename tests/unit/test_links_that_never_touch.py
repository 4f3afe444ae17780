"""Links that touch, although the SRDF file disables them as "Never", give a warning."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import invoke
from robot_samples import INERTIAL, joint, link, load, robot

import tominpmp as tm

LIMIT = '<limit lower="-3" upper="3" effort="100" velocity="8"/>'
BALL = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'
# A box at x = 1, which the ball passes.
POST = (
    '<collision><origin xyz="1 0 0"/><geometry><box size="0.1 0.1 0.1"/></geometry>'
    "</collision>"
)
# Two plates, with room for the ball between them; their convex hull has no room.
FORK = '<collision><geometry><mesh filename="fork.obj"/></geometry></collision>'
WHY = '<robot name="sample"><disable_collisions link1="base" link2="ball"{}/></robot>'
FINGERS = {"panda_finger_joint1": 0.03, "panda_finger_joint2": 0.03}
# The last joints bend the hand of a Panda onto its forearm.
STRAIGHT = [0.0, -0.3, 0.0, -1.8, 0.0, 1.5, 0.0]
BENT = [0.5, 0.0, 0.3, -1.5, 0.0, 0.1, 0.0]


def rail(folder: Path, reason: str | None, post: str = POST) -> tm.Robot:
    """A ball that slides along x, at (1 + q, 0, 0), past the shape of its base."""
    semantics = WHY.format("" if reason is None else f' reason="{reason}"')
    parts = (
        link("base", post),
        link("ball", INERTIAL + BALL),
        joint("slide", "base", "ball", "prismatic", limit=LIMIT, axis="1 0 0"),
    )
    return load(folder, robot(*parts), srdf=semantics)


def test_touching_pairs_without_reason_give_a_warning_unless_adjacent() -> None:
    """The SRDF file of the UR5 has no reasons."""
    arm = tm.load_robot("ur5", limits="urdf")
    never = arm.srdf.never_touch
    assert ("forearm_link", "wrist_2_link") in never
    assert ("forearm_link", "wrist_1_link") not in never
    straight = [0.0, -1.2, 1.4, 1.5, 1.5, 0.0]
    folded = [0.0, -1.2, 1.4, 1.5, 0.0, 0.0]
    touches = tm.plan(
        tm.Problem(arm, straight, tm.JointGoal(folded)), effort="quick", refine=None
    ).verification.touches
    assert [touch[:2] for touch in touches] == [("forearm_link", "wrist_2_link")]


def past(arm: tm.Robot, **changes: object) -> tm.Problem:
    return tm.Problem(arm, [-1.0], tm.JointGoal([1.0]), **changes)


def test_touch_of_a_pair_disabled_as_never_gives_a_warning(tmp_path: Path) -> None:
    problem = past(rail(tmp_path, "Never"))
    solution = tm.plan(problem)
    quiet = tm.plan(past(rail(tmp_path, "Adjacent")))
    assert solution.success
    assert solution.status is quiet.status
    assert solution.T == quiet.T
    assert solution.verification.ok
    ((*names, time),) = solution.verification.touches
    assert names == ["ball", "base"]
    # The ball meets the post 0.1 m before its middle.
    assert solution.trajectory(time).q[0] == pytest.approx(-0.1, abs=0.01)
    said = f"Links 'ball' and 'base' touch at {time:.3f} s"
    for message in (
        solution.message,
        solution.verification.message,
        tm.verify(problem, solution.trajectory).message,
    ):
        assert said in message
    assert said not in quiet.message


@pytest.mark.parametrize("reason", ("Adjacent", "Default", "User", "", None))
def test_touch_of_a_pair_with_another_reason_gives_no_warning(
    reason: str | None, tmp_path: Path
) -> None:
    solution = tm.plan(past(rail(tmp_path, reason)))
    assert solution.success
    assert solution.verification.touches == ()
    assert "touch" not in solution.message


def test_links_that_may_touch_give_no_warning(tmp_path: Path) -> None:
    arm = rail(tmp_path, "Never")
    for changes in ({"self_collision": False}, {"may_touch": [("base", "ball")]}):
        assert tm.plan(past(arm, **changes)).verification.touches == ()


def test_links_whose_hulls_overlap_without_a_touch_give_no_warning(
    tmp_path: Path,
) -> None:
    """Touches are those of meshes: the ball passes between two plates."""
    plate = [(x, y, z) for x in (0.5, 1.5) for y in (0.1, 0.2) for z in (-0.1, 0.1)]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5)]
    faces.append((2, 6, 8, 4))
    lines = [f"v {x} {side * y} {z}" for side in (1, -1) for x, y, z in plate]
    for first in (0, 8):
        for a, b, c, d in np.array(faces) + first:
            lines += [f"f {a} {b} {c}", f"f {a} {c} {d}"]
    (tmp_path / "fork.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    arm = rail(tmp_path, "Never", FORK)
    assert tm.plan(past(arm)).verification.touches == ()
    assert len(tm.plan(past(rail(tmp_path, "Never"))).verification.touches) == 1


def test_failed_replay_reports_no_touches(tmp_path: Path) -> None:
    problem = past(rail(tmp_path, "Never"))
    motion = tm.plan(problem).trajectory
    found = tm.verify(replace(problem, goal=tm.JointGoal([2.0])), motion)
    assert not found.ok
    assert found.touches == ()


def test_scenario_files_and_combined_robots_keep_the_reasons(
    tmp_path: Path,
) -> None:
    arm = rail(tmp_path, "Never")
    scenario = tmp_path / "files" / "cell.toml"
    scenario.parent.mkdir()
    tm.save_scenario(scenario, past(arm))
    again = tm.load_scenario(scenario).problem.robot
    assert again.srdf.never_touch == (("ball", "base"),)
    both = tm.combine_robots([("one", arm, (0, 0, 0)), ("two", arm, (0, 3, 0))])
    expected = (("one/ball", "one/base"), ("two/ball", "two/base"))
    assert both.srdf.never_touch == expected
    problem = tm.Problem(both, [-1.0, 1.0], tm.JointGoal([1.0, 1.5]))
    solution = tm.plan(problem, effort="quick", refine=None)
    assert [touch[:2] for touch in solution.verification.touches] == [expected[0]]


def test_plan_and_verify_commands_print_the_warning(tmp_path: Path) -> None:
    rail(tmp_path, "Never")
    (tmp_path / "sample.srdf").write_text(WHY.format(' reason="Never"'))
    here = [str(tmp_path / "sample.urdf"), "--srdf", str(tmp_path / "sample.srdf")]
    task = ["--start", "-1", "--goal", "1"]
    motion = str(tmp_path / "motion.csv")
    ran = invoke(["plan", *here, *task, "-o", motion])
    assert ran.exit_code == 0
    assert "Links 'ball' and 'base' touch at 0." in ran.output
    ran = invoke(["verify", *here, motion, *task])
    assert ran.exit_code == 0
    assert "warning" in ran.output
    assert "Links 'ball' and 'base' touch at 0." in ran.output


def test_touch_of_a_panda_hand_warns_only_with_reason_never() -> None:
    """Hand and forearm touch where all joints are at 0: the SRDF says "Default"."""
    panda = tm.load_robot("panda", limits="urdf", locked_joints=FINGERS)
    solution = tm.plan(tm.Problem(panda, STRAIGHT, tm.JointGoal(BENT)))
    assert solution.success
    assert solution.verification.touches == ()
    pair = 'link1="panda_hand" link2="panda_link5" reason="{}"'
    said = panda.srdf.path.read_text(encoding="utf-8")
    assert pair.format("Default") in said
    said = said.replace(pair.format("Default"), pair.format("Never"))
    panda = tm.load_robot("panda", limits="urdf", locked_joints=FINGERS, srdf=said)
    solution = tm.plan(tm.Problem(panda, STRAIGHT, tm.JointGoal(BENT)))
    assert solution.success
    ((*names, time),) = solution.verification.touches
    assert names == ["panda_hand", "panda_link5"]
    assert 0.0 < time < solution.T
