"""Constraints of a caller along a motion: tool speed and upright orientation."""

from __future__ import annotations

import math
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import Link, make_arm
from tominpmp.constraints.base import States
from tominpmp.exceptions import FrameNotFound, ProblemError, ScenarioError

# Other tests cover the search for the best motion.
plan_quickly = partial(tm.plan, effort="quick", refine=None)

METHODS = ("inverse", "collocation", "adjoint")
SPLINES = ("linear", "spline")
# A link of 1 m that turns in a horizontal plane.
RADIUS, INERTIA, EFFORT = 1.0, 0.5, 5.0
DOWN = (0.0, 0.0, -1.0)


def turning() -> tm.Robot:
    return make_arm(
        Link(mass=1.0, length=RADIUS, inertia=INERTIA), effort=np.array([EFFORT])
    )


def turn(speed: float, angle: float = 2.0, **more) -> tm.Problem:
    limit = tm.ToolSpeed("tip", speed)
    return tm.Problem(
        turning(), [0.0], tm.JointGoal([angle]), constraints=(limit,), **more
    )


def fastest(speed: float, angle: float = 2.0) -> float:
    """Time of a turn: it speeds up, keeps the speed of the tool, and slows down."""
    acceleration = EFFORT / INERTIA
    return RADIUS * angle / speed + speed / (RADIUS * acceleration)


def panda(goal: tm.Goal, *constraints, **more) -> tm.Problem:
    robot = tm.load_robot("panda", limits="urdf")
    start = robot.group_state("default")
    return tm.Problem(robot, start, goal, constraints=constraints, **more)


def beside(distance: float = 0.4) -> tm.Goal:
    """The hand at a distance beside its start, upside down as at the start."""
    return tm.AxisGoal(
        "panda_hand_tcp",
        axis=DOWN,
        direction=(0.0, 0.0, 1.0),
        position=(0.4, -distance, 0.5),
        angle_tolerance=0.05,
    )


def level(tolerance: float = 0.1) -> tm.KeepUpright:
    return tm.KeepUpright("panda_hand_tcp", axis=DOWN, tolerance=tolerance)


def largest(solution: tm.Solution, item) -> float:
    """Largest value along the motion, sampled ten times as densely as in its replay."""
    motion = solution.trajectory
    assert motion is not None
    ready = item.on(solution.problem.robot)
    times = np.arange(0.0, motion.duration, 1e-4)
    state = motion(times)
    return float(ready.measures(States(times, state.q, state.v, state.a)).max())


@pytest.mark.parametrize("speed", [0.5, 1.5, 3.0])
@pytest.mark.parametrize("method", METHODS)
def test_a_turn_with_a_tool_speed_takes_the_time_of_the_closed_form(method, speed):
    solution = plan_quickly(turn(speed), method=method)
    assert solution.success, solution.message
    expected = fastest(speed)
    # The replay tolerates a share beyond a limit; a grid cannot switch at any time.
    assert 1.0 - 5e-3 < solution.T / expected < 1.02
    assert largest(solution, solution.problem.constraints[0]) < 1.01 * speed


@pytest.mark.parametrize("control", SPLINES)
def test_splines_keep_a_tool_speed(control):
    solution = plan_quickly(turn(1.5), control=control)
    assert solution.success, solution.message
    assert 1.0 - 5e-3 < solution.T / fastest(1.5) < 1.08
    assert largest(solution, solution.problem.constraints[0]) < 1.01 * 1.5


@pytest.mark.parametrize("method", METHODS)
def test_an_arm_of_three_joints_keeps_its_tool_speed(method):
    robot = tm.load_robot("planar3r", velocity=20.0, gravity=(0, 0, 0))
    limit = tm.ToolSpeed("tip", 4.0)
    goal = tm.JointGoal((0.5, 1, 1))
    free = tm.Problem(robot, (0.5, 1.7, -1.7), goal)
    held = tm.Problem(robot, (0.5, 1.7, -1.7), goal, constraints=(limit,))
    solution = plan_quickly(held, method=method)
    assert solution.success, solution.message
    assert largest(solution, limit) < 1.01 * 4.0
    assert largest(plan_quickly(free, method=method), limit) > 1.1 * 4.0
    assert "speed of frame tip" in solution.verification.worst


class NozzleSpeed(tm.ToolSpeed):
    name = "speed of a nozzle"


def test_certificate_distinguishes_constraints_of_the_same_name():
    robot = tm.load_robot("planar3r", velocity=20.0, gravity=(0, 0, 0))
    limits = NozzleSpeed("link3", 50.0), NozzleSpeed("tip", 4.0)
    goal = tm.JointGoal((0.5, 1, 1))
    held = tm.Problem(robot, (0.5, 1.7, -1.7), goal, constraints=limits)
    active = plan_quickly(held, starts=1).certificate.active
    assert [a.name for a in active if a.kind == NozzleSpeed.name] == ["frame tip"]


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"method": "collocation"}])
def test_a_cup_is_kept_upright_on_its_way(options):
    free = plan_quickly(panda(beside()), starts=1, **options)
    cone = level(0.07)
    solution = plan_quickly(panda(beside(), cone), starts=1, **options)
    assert free.success and solution.success, solution.message
    assert largest(free, cone) > 1.05 * cone.tolerance
    assert largest(solution, cone) < 1.01 * cone.tolerance
    assert solution.T > 0.995 * free.T
    assert solution.verification.worst["tilt of frame panda_hand_tcp"].share < 0.01


def test_tool_speed_and_upright_hand_hold_among_obstacles():
    ball = tm.Sphere("ball", radius=0.07, position=(0.45, -0.2, 0.55))
    limit = tm.ToolSpeed("panda_hand_tcp", 1.0)
    problem = panda(beside(), level(), limit, scene=tm.Scene([ball]), margin=0.01)
    solution = plan_quickly(problem, starts=1)
    assert solution.success, solution.message
    assert largest(solution, level()) < 0.101
    assert largest(solution, limit) < 1.01
    assert solution.verification.min_clearance >= 0.01


def test_tool_speed_is_active_in_the_certificate():
    solution = plan_quickly(turn(0.5))
    found = solution.certificate
    assert found.ok, found.message
    given = tm.certify(turn(5.0), solution.trajectory)
    # Without that limit the same motion is far from time-optimal.
    assert given.stationarity > 20 * found.stationarity


def test_replay_refuses_a_motion_beyond_a_tool_speed():
    free = tm.Problem(turning(), [0.0], tm.JointGoal([2.0]))
    motion = plan_quickly(free).trajectory
    verdict = tm.verify(turn(0.5), motion)
    assert not verdict.ok
    assert "speed of frame tip is" in verdict.message
    assert "beyond its limit" in verdict.message


@pytest.mark.parametrize("item", [tm.ToolSpeed("tip", 0.7), tm.KeepUpright("tip")])
def test_derivatives_match_finite_differences(item):
    robot = tm.load_robot("ur5", limits="urdf")
    rng = np.random.default_rng(4)
    item = type(item)(**{**vars(item), "frame": "tool0"}).on(robot)
    step = 1e-6
    for _ in range(5):
        q, v = rng.uniform(-2, 2, 6), rng.uniform(-2, 2, 6)
        _, *parts = item.terms(q, v, np.zeros(6))
        for part, place in zip(parts, range(3), strict=True):
            for j in range(part.size // item.count):
                ends = []
                for sign in (1.0, -1.0):
                    state = [q.copy(), v.copy(), np.zeros(6)]
                    state[place][j] += sign * step
                    ends.append(item.terms(*state)[0])
                slope = (ends[0] - ends[1]) / (2 * step)
                assert part[:, j] == pytest.approx(slope, abs=1e-6)


def test_smooth_constraint_value_has_the_sign_of_the_excess():
    robot = tm.load_robot("ur5", limits="urdf")
    rng = np.random.default_rng(5)
    speed = tm.ToolSpeed("tool0", 0.7).on(robot)
    tilt = tm.KeepUpright("tool0", tolerance=1.5).on(robot)
    for _ in range(50):
        q, v = rng.uniform(-3, 3, 6), rng.uniform(-1, 1, 6)
        for item in (speed, tilt):
            over = item.measure(q, v, v) - item.largest
            assert np.sign(item.terms(q, v, v)[0][0]) == np.sign(over)


def test_scenario_files_keep_constraints(tmp_path):
    path = tmp_path / "cup.toml"
    problem = panda(beside(), level(), tm.ToolSpeed("panda_hand_tcp", 0.5))
    tm.save_scenario(path, problem)
    assert tm.load_scenario(path).problem.constraints == problem.constraints
    text = path.read_text()
    assert 'type = "tool_speed"' in text and 'type = "keep_upright"' in text
    path.write_text(text.replace("limit = 0.5", "limit = -0.5"))
    with pytest.raises(ScenarioError, match=r"\.limit: is -0\.5, expected a positive"):
        tm.load_scenario(path)
    path.write_text(text.replace('"tool_speed"', '"tool_sped"'))
    words = r"no constraint 'tool_sped' \(did you mean tool_speed.*; there are"
    with pytest.raises(ScenarioError, match=words):
        tm.load_scenario(path)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: tm.ToolSpeed("tip", 0.0), r"^constraint\.limit is 0.0, expected"),
        (lambda: tm.ToolSpeed("tip", 800.0), r"limit is 800.0, .* \[m/s\], 100 at m"),
        (lambda: tm.ToolSpeed("tip", math.nan), "limit is nan, expected a positive"),
        (lambda: tm.ToolSpeed("tip", "fast"), "limit is 'fast', expected a positive"),
        (lambda: tm.ToolSpeed(5, 1.0), "frame is 5, expected the name of a frame"),
        (lambda: tm.KeepUpright("tip", axis=(0, 0, 0)), "axis is"),
        (lambda: tm.KeepUpright("tip", axis=(0, 1)), r"axis is \(0, 1\), exp"),
        (lambda: tm.KeepUpright("tip", tolerance=4.0), "tolerance is 4.0"),
    ],
)
def test_wrong_constraints_are_refused(make, words):
    with pytest.raises(ProblemError, match=words):
        make()


def test_constraints_are_checked_against_robot_start_and_goal():
    with pytest.raises(FrameNotFound, match="nothing"):
        tm.Problem(
            turning(),
            [0.0],
            tm.JointGoal([1.0]),
            constraints=[tm.ToolSpeed("nothing", 1.0)],
        )
    with pytest.raises(ProblemError, match=r"constraints\[0\] is 5, expected a con"):
        tm.Problem(turning(), [0.0], tm.JointGoal([1.0]), constraints=[5])
    with pytest.raises(ProblemError, match=r"start: the speed of frame tip is 2 m/s"):
        turn(0.5, v_start=[2.0])
    with pytest.raises(ProblemError, match=r"is 2 m/s, 0\.01 m/s more than its limit"):
        turn(1.99, v_start=[2.0])
    tilted = np.array(panda(beside()).q_start)
    tilted[5] += 0.5
    with pytest.raises(ProblemError, match=r"goal: the tilt of frame panda_hand_tcp"):
        panda(tm.JointGoal(tilted), level())


def test_problems_with_constraints_can_be_copied_and_pickled():
    import copy
    import pickle

    problem = panda(beside(), level())
    for other in (copy.deepcopy(problem), pickle.loads(pickle.dumps(problem))):
        assert other.constraints == problem.constraints
        assert other == problem
    assert tm.Problem(problem.robot, problem.q_start, problem.goal) != problem


def test_the_command_line_takes_constraints(tmp_path):
    path = tmp_path / "motion.csv"
    words = [sys.executable, "-m", "tominpmp", "plan", "planar3r"]
    words += ["--start", "0.5,1.7,-1.7", "--goal", "0.5,1.2,-1.2"]
    words += ["--gravity", "0,0,0", "--output", str(path)]
    words += ["--planning-effort", "quick"]
    words += ["--constraint", "tool_speed:frame=tip:limit=1.5"]
    run = subprocess.run(words, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    motion = tm.load_motion(path)
    robot = tm.load_robot("planar3r", gravity=(0, 0, 0))
    ready = tm.ToolSpeed("tip", 1.5).on(robot)
    assert ready.measures(States(motion.t, motion.q, motion.v, motion.a)).max() < 1.515
    words[-1] = "tool_speed:frame=tip:limit=fast"
    run = subprocess.run(words, capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert "limit: is 'fast', expected a positive number" in " ".join(
        run.stderr.split()
    )


def test_start_slightly_beyond_a_tool_speed_is_slowed_down(ur5):
    """States of planned motions exceed limits between the rows of their programs."""
    limit = tm.ToolSpeed("tool0", 0.5).on(ur5)
    q, goal = np.array([0.0, -1.5, 1.0, 0.0, 0.5, 0.0]), tm.JointGoal([0.5] * 6)
    one = np.array([1.0, 0.2, 0.3, 0.0, 0.0, 0.0])
    v = one * 0.5 / limit.measure(q, one, np.zeros(0))
    with pytest.warns(
        tm.TominpmpWarning, match="slowed down: the speed of frame tool0"
    ):
        problem = tm.Problem(ur5, q, goal, v_start=1.001 * v, constraints=[limit])
    assert problem.v_start == pytest.approx(v, rel=1e-12)
    assert tm.Problem(
        ur5, q, goal, v_start=v, constraints=[limit]
    ).v_start == pytest.approx(v)
    with pytest.raises(ProblemError, match=r"0\.0015 m/s more than its limit 0\.5"):
        tm.Problem(ur5, q, goal, v_start=1.003 * v, constraints=[limit])


def test_start_slightly_beyond_a_cone_or_a_box_is_accepted(ur5):
    """States of planned motions leave both between the rows of their programs."""
    q, goal = np.array([0.0, -1.5, 1.0, 0.0, 0.5, 0.0]), tm.JointGoal([0.5] * 6)
    height = tm.WithinRegion("tool0", [-9.0] * 3, [9.0] * 3).on(ur5)
    point = height.motions.placements(q[None]).origin[0]
    tilt = tm.KeepUpright("tool0").on(ur5).measure(q, 0.0 * q, 0.0 * q)

    def start(excess: float) -> None:
        top, early = point[2] - excess * height.scale, (0.0, 0.1)
        box = tm.WithinRegion("tool0", [-9.0] * 3, [9.0, 9.0, top], during=early)
        share = 1.0 - excess
        cone = tm.KeepUpright("tool0", tolerance=share * tilt, during=early)
        tm.Problem(ur5, q, goal, constraints=[cone])
        tm.Problem(ur5, q, goal, constraints=[box])

    start(0.0015)
    with pytest.raises(ProblemError, match=r"start: the tilt of frame tool0"):
        start(0.0025)
