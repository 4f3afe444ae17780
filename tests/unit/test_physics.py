"""MuJoCo as second physics: torques, replays, reserves against disturbances."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robot_samples import chain

import tominpmp as tm
from tominpmp.dynamics import RobotDynamics

pytest.importorskip("mujoco")

from tominpmp.physics.mujoco_arm import MujocoArm
from tominpmp.physics.replay import replay
from tominpmp.physics.robustness import Disturbances, Robustness, robustness


def mixed() -> tm.Robot:
    """Joints that turn and slide about any axis, with rotors and friction."""
    pin.seed(3)
    model = pin.Model()
    axis = np.array([0.0, 0.6, 0.8])
    kinds = (
        pin.JointModelRX(),
        pin.JointModelPrismaticUnaligned(axis),
        pin.JointModelRevoluteUnaligned(axis),
        pin.JointModelRZ(),
    )
    for number, (kind, parent) in enumerate(zip(kinds, (0, 1, 1, 0), strict=True)):
        joint = model.addJoint(parent, kind, pin.SE3.Random(), f"j{9 - number}")
        body = pin.Inertia.FromEllipsoid(1.0 + number, 0.1, 0.2, 0.3)
        model.appendBodyToJoint(joint, body, pin.SE3.Random())
    model.effortLimit = np.full(4, 100.0)
    return tm.load_robot(
        model,
        velocity=10.0,
        damping=[0.1, 0.2, 0.3, 0.4],
        armature=[0.01, 0.02, 0.03, 0.04],
        gravity=(1.0, 2.0, -9.0),
    )


@pytest.mark.parametrize("name", ["mixed", "planar3r", "ur5", "xarm7"])
def test_inverse_dynamics_match_mujoco(name: str) -> None:
    robot = mixed() if name == "mixed" else tm.load_robot(name)
    robot = robot.with_changes(friction=0.0)
    arm, dynamics = MujocoArm(robot), RobotDynamics(robot)
    for q, v, a in np.random.default_rng(0).uniform(-2.0, 2.0, (10, 3, robot.n)):
        expected = dynamics.inverse(q[None], v[None], a[None])[0]
        scale = max(1.0, float(np.abs(expected).max()))
        np.testing.assert_allclose(arm.inverse(q, v, a), expected, atol=1e-8 * scale)


def test_torques_of_a_load_match_mujoco() -> None:
    robot = tm.load_robot("planar3r")
    loaded = robot.with_payload(tm.Payload(2.0, "tip"))
    frame = robot.model.frames[robot.frame_id("tip")]
    arm = MujocoArm(robot)
    arm.load(2.0, frame.parentJoint, frame.placement.translation)
    q, v, a = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 3))
    expected = RobotDynamics(loaded).inverse(q[None], v[None], a[None])[0]
    np.testing.assert_allclose(arm.inverse(q, v, a), expected, rtol=1e-8)


@pytest.fixture(scope="module")
def solution() -> tm.Solution:
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, [0.5, 1.7, -1.7], tm.JointGoal([0.9, 1.2, -1.0]))
    return tm.plan(problem, intervals=10, effort="quick", starts=1)


def test_torques_of_a_plan_reach_the_goal_in_mujoco(solution: tm.Solution) -> None:
    found = solution.replay(step=1e-3)
    assert found.ok
    assert found.torque_difference < 1e-8
    assert found.open_loop.goal_error < 1e-4
    assert found.with_feedback.tracking_error < 1e-4
    assert "MuJoCo" in found.message
    np.testing.assert_allclose(found.open_loop.t[-1], solution.T)
    assert len(repr(found)) < 320


def test_replay_in_mujoco_detects_wrong_torques(solution: tm.Solution) -> None:
    motion = solution.trajectory

    def less(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        return 0.9 * motion.inverse_dynamics(q, v, a)

    weak = replace(motion, inverse_dynamics=less)
    found = replay(solution.problem, weak, step=1e-3)
    assert found.torque_difference > 0.05
    assert found.open_loop.goal_error > 1e-2
    # The feedback corrects most of the error.
    assert found.with_feedback.goal_error < 0.5 * found.open_loop.goal_error


def test_stiff_friction_is_integrated_implicitly() -> None:
    robot = tm.load_robot(chain("", ""), damping=1e4)
    arm = MujocoArm(robot)
    assert arm.choose_integrator(1e-3, np.zeros(2)) == "implicit"
    robot = tm.load_robot(chain("", ""), damping=1.0)
    assert MujocoArm(robot).choose_integrator(1e-3, np.zeros(2)) == "Runge-Kutta 4"


def test_mujoco_warnings_are_logged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Regression: warnings went to the file MUJOCO_LOG.TXT in the working folder."""
    monkeypatch.chdir(tmp_path)
    arm = MujocoArm(tm.load_robot("planar3r"))
    arm.data.qvel[0] = np.nan
    arm.mujoco.mj_step(arm.model, arm.data)
    assert "Nan" in caplog.text
    assert not list(tmp_path.iterdir())


def test_mimic_joints_and_wrong_arguments_of_a_replay_are_refused(
    solution: tm.Solution,
) -> None:
    led = tm.load_robot(chain("", '<mimic joint="j1"/>'))
    with pytest.raises(tm.ProblemError, match=r"follow others \(mimic\)"):
        MujocoArm(led)
    with pytest.raises(tm.ProblemError, match="engine is 'bullet', expected"):
        solution.replay(engine="bullet")
    for name in ("step", "bandwidth", "tolerance"):
        for wrong in (0.0, -1.0, np.nan, "x", None):
            with pytest.raises(tm.ProblemError, match=f"{name} is "):
                solution.replay(**{name: wrong})
    with pytest.raises(tm.ProblemError, match="too small"):
        solution.replay(step=1e-12)


def test_error_without_mujoco_names_the_extra(
    solution: tm.Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(tm.MissingDependency, match=r"tominpmp\[mujoco\]"):
        solution.replay()


@pytest.fixture(scope="module")
def rail() -> tm.Problem:
    text = chain("").replace('type="revolute"', 'type="prismatic"')
    robot = tm.load_robot(text, gravity=(0, 0, 0))
    return tm.Problem(robot, [0.0], tm.JointGoal([1.0]))


OPTIONS = tm.Options(intervals=10, effort="quick", starts=1)


def test_heavier_load_needs_a_torque_reserve(rail: tm.Problem) -> None:
    """A rail of 2 kg with up to 0.2 kg more needs a tenth more force, and a little."""
    world = Disturbances(payload=0.2, friction=0.0, delay=0.0, noise=0.0)
    how = {"disturbances": world, "samples": 10, "tolerance": 2e-3}
    found = robustness(rail, OPTIONS, reserves=(0.0, 0.15), **how)
    assert found.reserve == 0.15
    assert found.kept[0] < 0.99 <= found.kept[1]
    # T is proportional to 1 / sqrt(force), as no speed limit is active.
    assert 0.0 < found.cost < 0.1
    assert "a torque reserve of 15%" in found.message


def test_interrupted_plan_ends_the_search_for_a_reserve(rail: tm.Problem) -> None:
    """Regression: further reserves were tried, as if the first had no motion."""
    options = replace(OPTIONS, callback=lambda record: True)
    with pytest.raises(KeyboardInterrupt):
        robustness(rail, options, samples=1)


def test_no_disturbances_need_no_reserve(rail: tm.Problem) -> None:
    calm = Disturbances(payload=0, friction=0, delay=0, noise=0)
    found = robustness(
        rail, OPTIONS, disturbances=calm, reserves=(0.0,), samples=1, tolerance=1e-3
    )
    assert found.reserve == 0.0
    assert found.cost == 0.0


def test_message_says_if_no_reserve_is_enough() -> None:
    found = Robustness([0.0, 0.1], [1.0, 1.1], [0.1, 0.5], [1.0, 1.0], 0.01, 10)
    assert found.reserve is None
    assert found.cost is None
    assert found.message.startswith("no reserve keeps 99% of 10 trials")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("reserves", ()), ("reserves", 1.0), ("reserves", [1.0]), ("reserves", "x"),
        ("samples", 0), ("samples", 1.5), ("samples", True), ("tolerance", 0),
        ("bandwidth", None), ("period", np.inf),
    ],
)  # fmt: skip
def test_wrong_values_are_named_in_the_error(
    name: str, value: object, rail: tm.Problem
) -> None:
    with pytest.raises(tm.ProblemError, match=f"{name} is") as error:
        robustness(rail, **{name: value})
    assert error.value.field == name
    with pytest.raises(tm.ProblemError, match="payload is -1"):
        Disturbances(payload=-1)


def test_dry_friction_of_light_links_has_its_full_size() -> None:
    """Regression: friction in MuJoCo was too small: a Z1 ended 0.4 rad off its goal."""
    robot = tm.load_robot("z1")
    start = [0.0, 1.2, -1.2, 0.0, 0.0, 0.0, -0.5]
    goal = tm.JointGoal([0.6, 1.5, -1.4, 0.2, 0.1, 0.5, -0.4])
    problem = tm.Problem(
        robot, start, goal, motion_limits=tm.MotionLimits(acceleration=8.0, jerk=200.0)
    )
    found = tm.plan(problem, intervals=20, effort="quick", refine=None).replay()
    assert found.torque_difference < 1e-8
    assert found.open_loop.goal_error < 1e-3
    assert found.with_feedback.tracking_error < 1e-3
