"""The examples of moving obstacles, payloads and several arms, on coarse grids."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from robot_samples import placement

import tominpmp as tm

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
COARSE = tm.Options(intervals=10, starts=1, seed=0)


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_conveyor_example_keeps_clear_of_moving_obstacles():
    module = example("conveyor")
    without, among = (tm.plan(module.problem(v), COARSE) for v in (None, module.SPEED))
    assert without.success
    assert among.success
    assert among.T > 1.1 * without.T
    assert among.verification.min_clearance > 0.01 - 1e-4


def test_payload_example_refuses_a_motion_planned_without_the_box():
    module = example("payload")
    empty = tm.load_robot(
        "panda", limits="urdf", locked_joints={"panda_finger_joint1": 0.04}
    )
    loaded = empty.with_payload(module.box())
    solution = tm.plan(module.problem(empty), COARSE)
    assert solution.success
    # The motion is planned without the box, and replayed with it.
    refused = tm.verify(module.problem(loaded), solution.trajectory)
    assert not refused.ok
    assert {"effort", "clearance"} & {item.kind for item in refused.violations}


def test_two_ur5_example_swaps_crates_that_collide_on_lines():
    module = example("two_ur5")
    cell = module.workcell()
    task = module.problem(cell)
    # Each crate goes to the place where the other crate was, in the world.
    before, after = (
        [
            placement(task.robot, q.tolist(), f"{name}/tool0").translation
            for name in ("near", "far")
        ]
        for q in (task.q_start, task.goal.q)
    )
    np.testing.assert_allclose(before, after[::-1], atol=2e-3)
    # If both go straight ahead, they meet in the middle.
    contact = task.checker.closest(0.5 * (task.q_start + task.goal.q))
    assert contact.distance < 0.0
    assert {contact.link[:4], contact.obstacle[:4]} == {"near", "far/"}


def test_baxter_example_checks_collisions_between_its_arms():
    task = example("baxter").problem()
    assert task.robot.n == 14
    sides = {name.partition("_")[0] for name in task.robot.joint_names}
    assert sides == {"left", "right"}
    both = [{a[:5], b[:5]} == {"left_", "right"} for a, b in task.checker.pairs]
    assert any(both)
    with pytest.raises(tm.ProblemError, match="outside reach"):
        far = tm.AllGoals([tm.PositionGoal("left_gripper", (9.0, 0.0, 0.0))])
        tm.Problem(task.robot, task.q_start, far)
