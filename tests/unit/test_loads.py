"""Loads on trays, suction cups and between fingers, against closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from constraint_samples import check_terms_against_differences

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tominpmp.constraints.base import States
from tominpmp.exceptions import ProblemError

G = 9.81
DOWN, SIDE = (0.0, 0.0, -G), (0.0, -G, 0.0)
TENSOR = np.diag([2e-3, 3e-3, 4e-3])
# A pentagram, whose edges all turn to the left.
STAR = [(np.cos(angle), np.sin(angle)) for angle in 0.8 * np.pi * np.arange(5)]
SQUARE = [(-0.03, -0.02), (0.05, -0.02), (0.05, 0.04), (-0.03, 0.04)]
ITEMS = (
    tm.StableContact("tool0", (0.01, 0.0, 0.1), 0.4),
    tm.StableContact("tool0", (0.01, 0.0, 0.1), 0.4, SQUARE, 0.7, TENSOR),
    tm.StableContact("tool0", (0.0, 0.02, 0.1), 0.4, 0.05, 0.7, None, 30.0),
    tm.FirmGrasp("tool0", 40.0, 0.6, 0.8, (0.0, 0.01, 0.05), inertia=TENSOR),
)


def rail(gravity=DOWN) -> tm.Robot:
    return make_arm(slide(1.0), effort=np.array([100.0]), gravity=gravity)


def largest(solution: tm.Solution, item) -> float:
    motion = solution.trajectory
    ready = item.on(solution.problem.robot)
    times = np.linspace(0.0, motion.duration, 4001)[:-1]
    state = motion(times)
    return float(
        ready.measures(States(times, state.q, state.v, state.a)).max() - item.largest
    )


def planned(item, distance=1.0, robot=None, **options) -> tm.Solution:
    problem = tm.Problem(
        robot or rail(), [0.0], tm.JointGoal([distance]), constraints=(item,)
    )
    solution = tm.plan(problem, **options)
    assert solution.success, solution.message
    assert largest(solution, item) < 5e-3 * max(item.scale, 1.0)
    return solution


@pytest.fixture(scope="module")
def ur5():
    return tm.load_robot("ur5", limits="urdf")


@pytest.mark.parametrize("item", ITEMS)
def test_derivatives_match_finite_differences(item, ur5):
    check_terms_against_differences(item.on(ur5), 5, 3e-6)


def test_derivatives_of_a_load_in_the_first_of_two_hands():
    """The joints of the other arm come between those of this arm and the load."""
    robot = tm.load_robot("baxter", limits="urdf")
    item = tm.FirmGrasp("left_gripper", 40.0, 0.6, 0.8, inertia=TENSOR).on(robot)
    q, v, a = states = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 2, robot.n))
    _, found = item.wrench_slopes(q, v, a)
    step = 1e-6
    for place, by in enumerate(found):
        for joint in range(robot.n):
            change = np.zeros_like(states)
            change[place, :, joint] = step
            later, earlier = states + change, states - change
            slope = (item.wrenches(*later) - item.wrenches(*earlier)) / (2 * step)
            np.testing.assert_allclose(by[:, :, joint], slope, atol=1e-7)


@pytest.mark.parametrize("item", ITEMS)
def test_wrench_equals_the_torques_that_the_load_adds(item, ur5):
    ready = item.on(ur5)
    loaded = ur5.model.copy()
    frame = loaded.frames[loaded.getFrameId("tool0")]
    tensor = np.zeros((3, 3)) if item.inertia is None else item.inertia
    body = pin.Inertia(item.mass, np.array(item.center), tensor)
    loaded.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    rng = np.random.default_rng(6)
    for _ in range(5):
        q, v, a = (rng.uniform(-2, 2, 6) for _ in range(3))
        more = pin.rnea(loaded, loaded.createData(), q, v, a)
        more = more - pin.rnea(ur5.model, ur5.model.createData(), q, v, a)
        jacobian = ready.kinematics.jacobian(q, "tool0", local=True)
        w = ready.wrenches(q[None], v[None], a[None])[0]
        assert jacobian.T @ w == pytest.approx(more, abs=1e-9)


@pytest.mark.parametrize("item", ITEMS)
def test_rows_have_the_sign_of_the_excess(item, ur5):
    item = item.on(ur5)
    rng = np.random.default_rng(5)
    for _ in range(60):
        q, v, a = (rng.uniform(-2, 2, 6) for _ in range(3))
        row = item.evaluate(States(np.zeros(1), q[None], v[None], a[None]))
        assert bool(np.any(row > 0.0)) == (item.measure(q, v, a) > item.largest)


@pytest.mark.parametrize("method", ["inverse", "collocation"])
def test_load_on_a_level_tray_moves_at_the_friction_limit(method):
    solution = planned(tm.StableContact("tip", (0, 0, 0.05), 0.2), method=method)
    assert pytest.approx(1.427843, rel=1e-3) == solution.T


def test_a_tall_load_tips_before_it_slips():
    half, height = 0.03, 0.2
    square = [(-half, -half), (half, -half), (half, half), (-half, half)]
    contact = tm.StableContact("tip", (0, 0, height), 0.9, square)
    solution = planned(contact, control="constant")  # switches in the middle
    expected = 2.0 * np.sqrt(1.0 / (G * half / height))
    assert pytest.approx(expected, rel=1e-3) == solution.T


def test_load_on_a_round_foot_tips_at_its_radius():
    solution = planned(tm.StableContact("tip", (0, 0, 0.2), 0.9, 0.03))
    expected = 2.0 * np.sqrt(1.0 / (G * 0.03 / 0.2))
    assert pytest.approx(expected, rel=2e-3) == solution.T


def test_suction_cup_holds_by_its_pull_less_the_weight():
    mass, pull, mu = 2.0, 60.0, 0.5
    cup = tm.StableContact("tip", (0, 0, 0.1), mu, mass=mass, adhesion=pull)
    hanging = rail((0.0, 0.0, G))  # the load is below the cup
    solution = planned(cup, robot=hanging)
    expected = 2.0 * np.sqrt(1.0 / (mu * (pull / mass - G)))
    assert pytest.approx(expected, rel=5e-3) == solution.T


def test_grasped_load_is_lifted_at_the_friction_limit():
    lift = make_arm(slide(1.0, (0.0, 1.0, 0.0)), effort=np.array([200.0]), gravity=SIDE)
    grasp = tm.FirmGrasp("tip", 20.0, 0.5, 1.0, axis=(0, 0, 1))
    solution = planned(grasp, robot=lift)
    holds = 2.0 * 0.5 * 20.0
    expected = np.sqrt(2.0 * (1.0 / (holds - G) + 1.0 / (holds + G)))
    assert pytest.approx(expected, rel=1e-2) == solution.T


def waiter(folder: Path) -> tm.Robot:
    """A rail along x that carries a tray that tilts about y."""
    link = (
        '<link name="{0}"><inertial><mass value="{1}"/><inertia ixx="{2}" iyy="{2}" '
        'izz="{2}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    joint = (
        '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>'
        '<axis xyz="{4}"/><limit lower="-2" upper="2" effort="{5}" velocity="50"/>'
        "</joint>"
    )
    path = folder / "waiter.urdf"
    path.write_text(
        '<robot name="waiter"><link name="base"/>'
        + link.format("cart", 1.0, 0.01)
        + link.format("tray", 0.2, 0.002)
        + joint.format("move", "prismatic", "base", "cart", "1 0 0", 40)
        + joint.format("tilt", "revolute", "cart", "tray", "0 1 0", 2)
        + "</robot>"
    )
    return tm.load_robot(path)


def test_tilting_the_tray_is_faster_than_keeping_it_level(tmp_path):
    robot = waiter(tmp_path)
    glass = tm.StableContact("tray", (0, 0, 0.03), 0.2)
    level = tm.JointCoupling(("tilt",), (1.0,), upper=0.0, lower=0.0)
    times = []
    quick = {"control": "constant", "refine": None, "effort": "quick", "starts": 1}
    for constraints in ((glass, level), (glass,)):
        problem = tm.Problem(
            robot, [0.0, 0.0], tm.JointGoal([1.0, 0.0]), constraints=constraints
        )
        solution = tm.plan(problem, intervals=20, **quick)
        assert solution.success, solution.message
        assert largest(solution, glass) < 5e-3
        times.append(solution.T)
    assert pytest.approx(1.427843, rel=1e-2) == times[0]
    assert times[1] < 0.95 * times[0]


@pytest.mark.parametrize(
    ("item", "words"),
    [
        (tm.FirmGrasp("tip", 4.0, 0.5, 1.0, axis=(1, 0, 0)), "slips out of the fing"),
        (tm.StableContact("tip", (0.1, 0, 0.1), 0.5, 0.05), "slips or tips, as it"),
    ],
)
def test_load_that_slips_or_tips_at_rest_is_refused(item, words):
    with pytest.raises(ProblemError, match=words):
        tm.Problem(rail(), [0.0], tm.JointGoal([1.0]), constraints=(item,))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: tm.StableContact("a", (0, 0), 0.5), "center"),
        (lambda: tm.StableContact("a", (0, 0, 1), 0.0), "friction is 0.0"),
        (lambda: tm.StableContact("a", (0, 0, 1), 0.5, -1.0), "support is -1.0"),
        (lambda: tm.StableContact("a", (0, 0, 1), 0.5, [(0, 0), (1, 0)]), "support"),
        (
            lambda: tm.StableContact(
                "a", (0, 0, 1), 0.5, [(0, 0), (2, 0), (0.5, 0.5), (0, 2)]
            ),
            "convex polygon",
        ),
        (lambda: tm.StableContact("a", (0, 0, 1), 0.5, STAR), "convex polygon"),
        (lambda: tm.StableContact("a", (0, 0, 1), 0.5, mass=-1), "mass is -1"),
        (
            lambda: tm.StableContact("a", (0, 0, 1), 0.5, inertia=-np.eye(3)),
            "inertia has the principal moments",
        ),
        (lambda: tm.StableContact("a", (0, 0, 1), 0.5, adhesion=-2), "adhesion is -2"),
        (lambda: tm.FirmGrasp("a", 0.0, 0.5, 1.0), "force is 0.0"),
        (lambda: tm.FirmGrasp("a", 5.0, 0.5, 1.0, axis=(0, 0, 0)), "axis is"),
    ],
)
def test_wrong_values_are_named_in_the_error(make, words):
    with pytest.raises(ProblemError, match=words):
        make()


def test_scenario_file_keeps_a_stable_contact(tmp_path):
    item = tm.StableContact("tip", (0, 0, 0.1), 0.4, SQUARE, 0.7, TENSOR, 5.0)
    robot = tm.load_robot("planar3r", gravity=DOWN)
    goal = tm.JointGoal([0.6, 0.5, 0.4])
    problem = tm.Problem(robot, [0.5, 0.5, 0.5], goal, constraints=(item,))
    path = tmp_path / "task.toml"
    tm.save_scenario(path, problem)
    assert tm.load_scenario(path).problem.constraints == (item,)
