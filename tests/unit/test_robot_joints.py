"""Special joints of robots, and values by joint that are given or missing."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robot_samples import (
    chain,
    joint,
    link,
    load,
    mass_matrix,
    one_joint,
    placement,
    robot,
    write,
)

from tominpmp.exceptions import (
    JointNotFound,
    OptionsError,
    ProblemError,
    RobotLoadError,
    TominpmpWarning,
)
from tominpmp.goals.joints import JointGoal
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import load_robot

FINGER = {"panda_finger_joint1": 0.03}


# Special joints


def test_continuous_joint_is_one_angle(tmp_path: Path) -> None:
    arm = load(tmp_path, one_joint(kind="continuous"))
    assert arm.n == arm.model.nq == arm.model.nv == 1
    assert arm.limits.position_lower == -math.inf
    assert arm.limits.position_upper == math.inf
    there = placement(arm, [0.3], "l1")
    assert placement(arm, [0.3 + 2 * math.pi], "l1").isApprox(there, 1e-12)
    np.testing.assert_allclose(there.rotation, pin.utils.rotate("z", 0.3), atol=1e-15)


def test_prismatic_joint_slides_along_its_axis(tmp_path: Path) -> None:
    arm = load(tmp_path, one_joint(kind="prismatic", axis="0 -2 0"))
    assert arm.n == 1
    moved = placement(arm, [0.5], "l1").translation
    np.testing.assert_allclose(moved, [1, -0.5, 0], atol=1e-15)
    np.testing.assert_allclose(mass_matrix(arm, np.zeros(1)), [[2.0]])


FOLLOW = '<mimic joint="j1" multiplier="-2" offset="0.5"/><dynamics damping="3"/>'


def test_mimic_joint_moves_with_its_leader(tmp_path: Path) -> None:
    arm = load(tmp_path, chain("", FOLLOW, ""))
    assert arm.joint_names == ("j1", "j3")
    assert arm.n == 2
    assert arm.model.nv == 3
    np.testing.assert_array_equal(arm.expansion_matrix, [[1, 0], [-2, 0], [0, 1]])
    np.testing.assert_array_equal(arm.expansion_offset, [0, 0.5, 0])
    q = np.array([[0.2, 0.7], [0, 0]])
    np.testing.assert_allclose(arm.expand(q), [[0.2, 0.1, 0.7], [0, 0.5, 0]])
    np.testing.assert_allclose(arm.expand_tangent([1.0, 5.0]), [1, -2, 5])
    np.testing.assert_allclose(arm.reduce_tangent([1.0, 10.0, 100.0]), [-19, 100])
    # Friction, position limits and speed of the mimic joint apply to its leader:
    # q2 = 0.5 - 2 q1 in [-1, 2] and |2 v1| <= 3.
    np.testing.assert_allclose(arm.damping, [12, 0])
    np.testing.assert_allclose(arm.limits.position_lower, [-0.75, -1])
    np.testing.assert_allclose(arm.limits.position_upper, [0.75, 2])
    np.testing.assert_allclose(arm.limits.velocity, [1.5, 3])
    np.testing.assert_allclose(arm.limits.effort_upper, [10, 10])
    np.testing.assert_allclose(arm.model.lowerPositionLimit, [-0.75, -1, -1])
    np.testing.assert_allclose(arm.model.upperPositionLimit, [0.75, 2, 2])
    # Without mimic joints the full and the reduced vectors are the same.
    plain = load_robot("planar3r")
    np.testing.assert_array_equal(plain.expand([1, 2, 3]), [1, 2, 3])
    np.testing.assert_array_equal(plain.reduce_tangent([1, 2, 3]), [1, 2, 3])


def test_mimic_joint_has_the_dynamics_of_a_gear(tmp_path: Path) -> None:
    arm = load(tmp_path, chain("", FOLLOW, ""), armature=[0.5, 0])
    rng = np.random.default_rng(3)
    q, v, a = rng.uniform(-0.5, 0.5, (3, 2))
    model, data = arm.model, arm.model.createData()
    tau = arm.reduce_tangent(
        pin.rnea(model, data, arm.expand(q), *map(arm.expand_tangent, (v, a)))
    )

    # Lagrange's equation d/dt dL/dv - dL/dq = tau, with differences of the energies.
    def lagrangian(q: np.ndarray, v: np.ndarray) -> float:
        potential = pin.computePotentialEnergy(model, data, arm.expand(q))
        return float(0.5 * v @ mass_matrix(arm, q) @ v - potential)

    step = 1e-4
    for i in range(2):
        e = step * np.eye(2)[i]

        def momentum(t: float, e: np.ndarray = e) -> float:
            q_t, v_t = q + v * t + a * t**2 / 2, v + a * t
            return (lagrangian(q_t, v_t + e) - lagrangian(q_t, v_t - e)) / (2 * step)

        rate = (momentum(step) - momentum(-step)) / (2 * step)
        force = (lagrangian(q + e, v) - lagrangian(q - e, v)) / (2 * step)
        assert tau[i] == pytest.approx(rate - force, rel=1e-5)


def test_mimic_joint_agrees_with_pinocchio(tmp_path: Path) -> None:
    text = chain("", FOLLOW, "")
    arm = load(tmp_path, text)
    try:
        other = pin.buildModelFromXML(text, mimic=True)
    except TypeError:
        pytest.skip("this Pinocchio has no mimic joints")
    assert other.nv == arm.n == 2
    q = np.array([0.3, -0.4])
    upper = np.triu(pin.crba(other, other.createData(), q))
    expected = upper + np.triu(upper, 1).T
    np.testing.assert_allclose(mass_matrix(arm, q), expected, rtol=1e-12)


def test_mimic_limits_that_leave_the_leader_no_room_are_ignored(tmp_path: Path) -> None:
    wrong = '<mimic joint="j1" multiplier="-1"/>'
    text = chain(
        "", wrong, limit='<limit lower="0" upper="1" effort="1" velocity="1"/>'
    )
    with pytest.warns(
        TominpmpWarning, match=r"joint j2 leave joint j1.* no range"
    ) as caught:
        arm = load_robot(write(tmp_path, text))
    assert caught[0].filename == __file__
    assert (arm.limits.position_lower, arm.limits.position_upper) == (0, 1)


def test_locked_joint_becomes_part_of_the_link(tmp_path: Path) -> None:
    text = chain("", "", "")
    free = load(tmp_path, text)
    arm = load(tmp_path, text, locked_joints={"j2": 0.75})
    assert arm.joint_names == ("j1", "j3")
    assert dict(arm.locked_joints) == {"j2": 0.75}
    same = placement(free, [0.1, 0.75, 0.2], "l3")
    assert placement(arm, [0.1, 0.2], "l3").isApprox(same, 1e-12)
    assert "j2" in arm.frame_names


def test_lock_outside_the_limits_warns(tmp_path: Path) -> None:
    with pytest.warns(
        TominpmpWarning, match=r"j1 is locked at 5 rad, .*\[-1, 2\]"
    ) as caught:
        arm = load_robot(write(tmp_path, chain("", "")), locked_joints={"j1": 5})
    assert caught[0].filename == __file__
    assert dict(arm.locked_joints) == {"j1": 5.0}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load(tmp_path, chain("", ""), locked_joints={"j1": 2})


def test_wrong_locked_joints_are_refused(tmp_path: Path) -> None:
    with pytest.raises(JointNotFound, match="'j9'"):
        load(tmp_path, chain("", ""), locked_joints={"j9": 0})
    with pytest.raises(OptionsError, match="positions by joint name"):
        load(tmp_path, chain("", ""), locked_joints=[1, 2])
    with pytest.raises(RobotLoadError, match="no joint is left that moves"):
        load(tmp_path, one_joint(), locked_joints={"j1": 0})


# Overrides


def test_overrides_take_numbers_arrays_and_names(tmp_path: Path) -> None:
    arm = load(
        tmp_path,
        chain("", ""),
        effort=5,
        velocity=[1, math.inf],
        damping={"j2": 0.5},
        armature=np.array([0.1, 0.2]),
        position_lower={"j1": -math.inf},
        position_upper=7,
        gravity=[0, 0, 0],
    )
    np.testing.assert_array_equal(arm.limits.effort_upper, [5, 5])
    np.testing.assert_array_equal(arm.limits.effort_lower, [-5, -5])
    np.testing.assert_array_equal(arm.limits.velocity, [1, math.inf])
    np.testing.assert_array_equal(arm.damping, [0, 0.5])
    np.testing.assert_array_equal(arm.armature, [0.1, 0.2])
    np.testing.assert_array_equal(arm.limits.position_lower, [-math.inf, -1])
    np.testing.assert_array_equal(arm.limits.position_upper, [7, 7])
    np.testing.assert_array_equal(arm.gravity, [0, 0, 0])
    # The model says the same.
    np.testing.assert_array_equal(arm.model.armature, [0.1, 0.2])
    np.testing.assert_array_equal(arm.model.gravity.linear, [0, 0, 0])
    np.testing.assert_array_equal(arm.model.lowerPositionLimit, [-math.inf, -1])
    np.testing.assert_array_equal(arm.model.velocityLimit, [1, math.inf])
    np.testing.assert_array_equal(arm.model.effortLimit, [5, 5])


def test_effort_may_differ_by_direction(tmp_path: Path) -> None:
    pairs = load(tmp_path, chain("", ""), effort=[[-1, 2], [-3, 4]])
    np.testing.assert_array_equal(pairs.limits.effort_lower, [-1, -3])
    np.testing.assert_array_equal(pairs.limits.effort_upper, [2, 4])
    named = load(tmp_path, chain("", ""), effort={"j1": (-1, 2), "j2": 6})
    np.testing.assert_array_equal(named.limits.effort_lower, [-1, -6])
    np.testing.assert_array_equal(named.limits.effort_upper, [2, 6])


def test_effort_of_zero_makes_a_joint_passive(tmp_path: Path) -> None:
    arm = load(tmp_path, chain("", ""), effort={"j2": 0})
    assert arm.passive_joints == ("j2",)


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("effort", math.nan, "got nan, expected one number, or 2 numbers"),
        ("effort", [1, math.nan], "joint j2 got nan, expected a number from 0"),
        ("effort", -1, "joint j1 got -1.*expected a number from 0"),
        ("effort", {"j2": -1}, "joint j2 got -1"),
        ("effort", math.inf, "joint j1 got inf, expected a finite number"),
        ("effort", {"j1": (3, 1)}, "j1 has the lower limit 3 and the upper limit 1"),
        (
            "effort",
            [1, 2, 3],
            r"got \[1, 2, 3\], expected .*2 numbers.*pairs.*j1, j2",
        ),
        ("effort", "strong", "got 'strong', expected one number, or 2 numbers"),
        ("effort", {"j1": "strong"}, "joint j1 got 'strong', expected a number from 0"),
        ("effort", {"j1": (1, 2, 3)}, "joint j1 got .*expected a number from 0, or"),
        ("velocity", 0, "joint j1 got 0, expected a number greater than zero"),
        ("velocity", [1, -2], "joint j2 got -2"),
        ("velocity", {"j1": (1, 2)}, "joint j1 got"),
        ("velocity", [[1, 2], [3, 4]], r"got \[\[1, 2\], \[3, 4\]\]"),
        ("velocity", math.nan, "got nan, expected one number, or 2 numbers"),
        ("damping", -0.1, "joint j1 got -0.1, expected a finite number from 0"),
        ("damping", math.inf, "joint j1 got inf"),
        ("armature", {"j2": -1}, "joint j2 got -1"),
        ("position_lower", 3, "j1 has the lower limit 3 and the upper limit 2"),
        ("position_upper", [1, -1], "j2 has the lower limit -1 and the upper limit -1"),
        ("position_upper", math.nan, "got nan, expected one number"),
        ("gravity", 9.81, "gravity is 9.81, expected three numbers"),
        ("gravity", (0, 0, math.nan), "three numbers .*, all finite"),
        ("gravity", "down", "gravity is 'down', expected three numbers"),
    ],
)
def test_wrong_overrides_are_refused(
    tmp_path: Path, option: str, value: object, message: str
) -> None:
    with pytest.raises(OptionsError, match=message) as caught:
        load(tmp_path, chain("", ""), **{option: value})
    assert caught.value.option == option
    arm = load(tmp_path, chain("", ""))
    with pytest.raises(OptionsError, match=message):
        arm.with_changes(**{option: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("option", ["effort", "velocity", "damping", "position_upper"])
def test_overrides_of_joints_that_are_not_free_are_refused(
    tmp_path: Path, option: str
) -> None:
    text = chain("", '<mimic joint="j1"/>', "")
    options: dict[str, object] = {"locked_joints": {"j3": 0.0}}
    with pytest.raises(JointNotFound, match="'j9'; the robot has: j1"):
        load(tmp_path, text, **options, **{option: {"j9": 1}})
    with pytest.raises(OptionsError, match=f"{option}: joint j2 follows j1"):
        load(tmp_path, text, **options, **{option: {"j2": 1}})
    with pytest.raises(OptionsError, match=f"{option}: joint j3 is locked"):
        load(tmp_path, text, **options, **{option: {"j3": 1}})


# Missing values


def test_missing_limits_are_named_in_one_error(tmp_path: Path) -> None:
    text = robot(
        *map(link, ("base", "l1", "l2", "l3")),
        joint("j1", "base", "l1", limit=""),
        joint("j2", "l1", "l2", limit='<limit lower="0" upper="1" velocity="1"/>'),
        joint(
            "j3",
            "l2",
            "l3",
            kind="continuous",
            limit='<limit effort="1" velocity="0"/>',
        ),
    )
    with pytest.raises(RobotLoadError) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert "no effort limit for j1, j2: give effort={'j1': ..., 'j2': ...}" in message
    assert "no velocity limit for j1, j3: give velocity={'j1': ..." in message
    assert "no position limits for j1: give position_lower=" in message
    arm = load(
        tmp_path,
        text,
        effort={"j1": 1, "j2": 2},
        velocity={"j1": 3, "j3": 4},
        position_lower={"j1": -1},
        position_upper={"j1": 1},
    )
    np.testing.assert_array_equal(arm.limits.effort_upper, [1, 2, 1])
    np.testing.assert_array_equal(arm.limits.velocity, [3, 1, 4])


def test_swapped_position_limits_are_named_with_their_values(tmp_path: Path) -> None:
    swapped = '<limit lower="2" upper="-1.5" effort="1" velocity="1"/>'
    chain = (link("base"), link("l1"), joint("j1", "base", "l1", limit=swapped))
    with pytest.raises(RobotLoadError) as caught:
        load(tmp_path, robot(*chain))
    assert (
        "no range between the position limits [2, -1.5] of j1: give position_lower="
        in (str(caught.value))
    )


def test_limits_of_joints_that_are_not_free_may_be_missing(tmp_path: Path) -> None:
    text = robot(
        *map(link, ("base", "l1", "l2", "l3")),
        joint("j1", "base", "l1"),
        joint("j2", "l1", "l2", limit=""),
        joint("j3", "l2", "l3", limit="", inside='<mimic joint="j1"/>'),
    )
    arm = load(tmp_path, text, locked_joints={"j2": 0.1})
    assert arm.joint_names == ("j1",)
    np.testing.assert_array_equal(arm.limits.velocity, [3])


def test_error_on_links_without_inertia_names_the_joint(tmp_path: Path) -> None:
    text = robot(
        link("base"),
        link("l1"),
        link("l2", ""),
        joint("j1", "base", "l1"),
        joint("j2", "l1", "l2"),
    )
    with pytest.raises(
        RobotLoadError, match=r"j2 can move without any inertia.*armature={'j2': ...}"
    ):
        load(tmp_path, text)
    with pytest.warns(TominpmpWarning, match="link l2 behind joint j2 has no mass"):
        arm = load(tmp_path, text, armature={"j2": 0.01})
    assert np.linalg.eigvalsh(mass_matrix(arm, np.zeros(2))).min() > 1e-3
    with pytest.raises(RobotLoadError, match="j2 can move without any inertia"):
        arm.with_changes(armature=0)


def test_error_names_both_joints_that_share_an_inertia(tmp_path: Path) -> None:
    # Two coaxial joints with nothing between them: only their sum has inertia.
    text = robot(
        link("base"),
        link("l1"),
        link("l2", ""),
        link("l3"),
        joint("j1", "base", "l1"),
        joint("j2", "l1", "l2").replace("1 0 0", "0 0 0"),
        joint("j3", "l2", "l3").replace("1 0 0", "0 0 0"),
    )
    with pytest.raises(RobotLoadError, match="j2 and j3 can move without any inertia"):
        load(tmp_path, text)


def test_joints_that_share_an_inertia_at_start_or_goal_are_refused(
    tmp_path: Path,
) -> None:
    # A wrist without inertia but at its end, whose outer joints are in line at q2 = 0.
    text = robot(
        link("base"),
        link("l1", ""),
        link("l2", ""),
        link("l3"),
        joint("j1", "base", "l1"),
        joint("j2", "l1", "l2", axis="1 0 0").replace("1 0 0", "0 0 0", 1),
        joint("j3", "l2", "l3").replace("1 0 0", "0 0 0"),
    )
    arm = load(tmp_path, text)
    bent, straight = np.array([0.1, 0.8, 0.2]), np.array([0.1, 0.0, 0.2])
    away = JointGoal(np.array([0.3, 0.9, 0.1]))
    words = r"j1 and j3 can move without any inertia there.*armature={'j1'"
    with pytest.raises(ProblemError, match="start: " + words) as start:
        Problem(arm, straight, away)
    with pytest.raises(ProblemError, match="goal: " + words) as goal:
        Problem(arm, bent, JointGoal(straight))
    assert (start.value.field, goal.value.field) == ("q_start", "goal")
    heavier = arm.with_changes(armature=0.01)
    assert Problem(heavier, straight, away).robot.n == 3
    assert Problem(arm, bent, away).robot.n == 3


def test_armature_adds_to_the_mass_matrix(tmp_path: Path) -> None:
    arm = load(tmp_path, one_joint())
    heavier = arm.with_changes(armature=0.5)
    # 0.3 about the centre, 2 kg at half a metre.
    np.testing.assert_allclose(mass_matrix(arm, np.zeros(1)), [[0.8]])
    np.testing.assert_allclose(mass_matrix(heavier, np.zeros(1)), [[1.3]])
