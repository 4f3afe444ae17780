"""States that are beyond a limit by rounding are set to the limit, with a warning.

Files round: pi is 3.1415926 in one file and 3.14159 in another. Beyond 1e-4 rad or m,
or a hundredth of the room between the limits, a state is refused.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from command_line import invoke
from scenario_samples import JOINTS, REQUEST, SCENE

import tominpmp as tm
from tominpmp.goals.sets import passed

QUICK = tm.Options(effort="quick", intervals=16, refine=None)
# Upper position limit of joint2 of the planar arm [rad].
LIMIT = 3.0
JUST, BEYOND = LIMIT + 9e-5, LIMIT + 1.1e-4
START, END = (0.5, LIMIT, -1.7), (1.0, 2.0, 0.5)
MESSAGE = r"joint 'joint2' is 3.00009 rad, outside its position limits \[-3, 3\] rad"


@pytest.fixture(scope="module")
def robot() -> tm.Robot:
    return tm.load_robot("planar3r", gravity=(0, 0, 0), velocity=2.0)


def at(q2: float) -> tuple[float, float, float]:
    return (1.0, q2, 0.5)


GOALS = {
    "joints": lambda q2: tm.JointGoal(at(q2)),
    "by name": lambda q2: tm.JointGoal({"joint2": q2}),
    "range": lambda q2: tm.JointRegionGoal(at(q2 + 0.1), 0.1),
    "range of one": lambda q2: tm.JointRegionGoal([q2], 0.0, ["joint2"]),
    "all": lambda q2: tm.AllGoals(
        [
            tm.JointRegionGoal({"joint2": q2}, 0.0),
            tm.JointRegionGoal({"joint1": 1.0}, 0.1),
        ]
    ),
}


@pytest.mark.parametrize("kind", GOALS)
def test_goals_are_set_to_the_limit(kind: str, robot: tm.Robot) -> None:
    goal = GOALS[kind]
    with pytest.warns(
        tm.TominpmpWarning, match=f"^goal.q.*: {MESSAGE}.*set to"
    ) as warned:
        problem = tm.Problem(robot, END, goal(JUST))
    assert len(warned) == 1 and warned[0].filename == __file__
    if kind.startswith("range"):
        assert problem.goal.joint_ranges(robot)[1][1] == LIMIT
    solution = tm.plan(problem, QUICK)
    assert solution.success and solution.verification.ok
    assert solution.trajectory.q[-1][1] == pytest.approx(LIMIT, abs=1e-6)
    with pytest.raises(tm.ProblemError, match="outside its position limits") as caught:
        tm.Problem(robot, END, goal(BEYOND))
    assert caught.value.field == "goal.q"


def test_joints_not_in_the_goal_give_no_second_warning(robot: tm.Robot) -> None:
    """The joints stay at the start, which has a warning of its own."""
    with pytest.warns(tm.TominpmpWarning, match=f"^q_start: {MESSAGE}") as warned:
        problem = tm.Problem(robot, at(JUST), tm.JointGoal({"joint1": 0.8}))
    assert len(warned) == 1
    assert problem.goal.configuration.tolist() == [0.8, LIMIT, 0.5]


def test_alternatives_are_set_to_the_limit_or_left_out(robot: tm.Robot) -> None:
    goal = tm.AnyGoal([tm.JointGoal(at(JUST)), tm.JointGoal(at(BEYOND))])
    with pytest.warns(tm.TominpmpWarning) as warned:
        problem = tm.Problem(robot, END, goal)
    assert [one.configuration.tolist() for one in problem.goal.goals] == [[*at(LIMIT)]]
    assert "set to the limit" in str(warned[0].message)
    assert "left out" in str(warned[1].message)


def test_goal_that_is_passed_is_set_to_the_limit(robot: tm.Robot) -> None:
    goal = passed(tm.JointGoal(at(JUST)))
    with pytest.warns(tm.TominpmpWarning, match=f"^goal.q: {MESSAGE}"):
        problem = tm.Problem(robot, END, goal)
    assert problem.goal == passed(tm.JointGoal(at(LIMIT)))


@pytest.mark.parametrize("stop", [False, True])
def test_segment_goals_are_set_to_the_limit(robot: tm.Robot, stop: bool) -> None:
    """Also the goal of the last segment, which is the goal of the whole problem."""
    goals = [tm.JointGoal((2.0, -JUST, 0.5)), tm.JointGoal(at(JUST))]
    segments = [tm.Segment(goals[0], stop=stop), tm.Segment(goals[1])]
    with pytest.warns(tm.TominpmpWarning) as warned:
        problem = tm.Problem(robot, (0.5, JUST, -1.7), segments=segments)
    begins = [str(item.message).partition(" joint ")[0] for item in warned]
    assert begins == ["q_start:", "segment 1: goal.q:", "segment 2: goal.q:"]
    assert problem.q_start[1] == LIMIT
    assert [part.goal.q[1] for part in problem.segments] == [-LIMIT, LIMIT]
    assert problem.goal is problem.segments[-1].goal
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solution = tm.plan(problem, QUICK)
        assert solution.success and solution.verification.ok


def test_plan_between_limits_passes_replay_files_and_warm_start(
    robot: tm.Robot, tmp_path: Path
) -> None:
    """Start and goal are on limits, also in motion files and their check."""
    with pytest.warns(tm.TominpmpWarning, match="set to the limit"):
        problem = tm.Problem(robot, (0.5, JUST, -1.7), tm.JointGoal((2.0, -JUST, 0.5)))
    assert problem.q_start.tolist() == [*START]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solution = tm.plan(problem, QUICK)
        assert solution.success and solution.verification.ok
        path = solution.export(tmp_path / "motion.csv")
        samples = tm.load_motion(path)
        assert samples.q[0].tolist() == [*START]
        assert tm.verify(problem, samples).ok
    narrow = robot.with_changes(
        position_lower={"joint2": -LIMIT + 5e-5},
        position_upper={"joint2": LIMIT - 5e-5},
    )
    with pytest.warns(tm.TominpmpWarning, match="set to the limit"):
        problem = tm.Problem(narrow, START, tm.JointGoal((2.0, -LIMIT, 0.5)))
    again = tm.plan(problem, QUICK, start=samples)
    assert again.success and again.verification.ok
    assert np.abs(again.trajectory.q[:, 1]).max() <= LIMIT - 5e-5 + 1e-9


def test_stations_are_set_to_the_limit(robot: tm.Robot) -> None:
    stations = {
        "low": tm.JointGoal((2.0, -JUST, 0.5)),
        "range": tm.JointRegionGoal((1.5, JUST, 0.3), 0.0),
    }
    with pytest.warns(tm.TominpmpWarning) as warned:
        tour = tm.plan_tour(
            robot,
            (0.5, JUST, -1.7),
            stations,
            q_end="start",
            intervals=16,
            effort="quick",
            refine=None,
        )
    begins = [str(item.message).partition(" joint ")[0] for item in warned]
    assert begins == [
        "q_start:",
        "station 1 ('low'): goal.q:",
        "station 2 ('range'): goal.q with its tolerance:",
    ]
    assert {visit.station: visit.q[1] for visit in tour.visits} == {
        "low": pytest.approx(-LIMIT, abs=1e-12),
        "range": pytest.approx(LIMIT, abs=1e-7),
    }
    with pytest.raises(tm.ProblemError, match=r"station 1 \('a'\).*outside its pos"):
        tm.plan_tour(robot, END, {"a": tm.JointGoal(at(BEYOND))})


# Files and the command line


def moveit(folder: Path, start: float, goal: float) -> tuple[Path, Path]:
    request: Any = dict(REQUEST)
    request["start_state"] = {
        "joint_state": {"name": JOINTS, "position": [0.5, start, -1.7]}
    }
    request["goal_constraints"] = [
        {
            "joint_constraints": [
                {"joint_name": name, "position": q, "tolerance_above": 1e-3}
                for name, q in zip(JOINTS, at(goal), strict=True)
            ]
        }
    ]
    files = folder / "scene.yaml", folder / "request.yaml"
    for file, message in zip(files, ({**SCENE, "world": {}}, request), strict=True):
        file.write_text(yaml.safe_dump(message), encoding="utf-8")
    return files


def test_moveit_requests_are_set_to_the_limit(robot: tm.Robot, tmp_path: Path) -> None:
    files = moveit(tmp_path, LIMIT + 1e-5, LIMIT + 3e-6)
    with pytest.warns(tm.TominpmpWarning, match="set to the limit") as warned:
        problem = tm.load_moveit(robot, *files)
    assert problem.q_start[1] == LIMIT == problem.goal.configuration[1]
    named = [str(item.message) for item in warned if "set to" in str(item.message)]
    assert "q_start: joint 'joint2' is 3.00001 rad" in named[0]
    assert "goal.q: joint 'joint2' is 3.000003 rad" in named[1]
    for start, goal, key in ((BEYOND, 1.0, "start_state"), (1.0, BEYOND, "goal_cons")):
        with pytest.raises(tm.ScenarioError, match=f"{key}.*outside its position"):
            tm.load_moveit(robot, *moveit(tmp_path, start, goal))


def test_scenario_files_and_flags_are_set_to_the_limit(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(
        f'goal = {{type = "joint", q = [1.0, {JUST}, 0.5]}}\n'
        f'robot = {{name = "planar3r"}}\nstart = {{q = [0.5, {JUST}, -1.7]}}\n',
        encoding="utf-8",
    )
    with pytest.warns(tm.TominpmpWarning, match="set to the limit") as warned:
        problem = tm.load_scenario(path).problem
    assert len(warned) == 2
    assert problem.q_start[1] == LIMIT == problem.goal.configuration[1]
    saved = tm.save_scenario(tmp_path / "again.toml", problem)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert tm.load_scenario(saved).problem == problem
    words = f"plan planar3r --start 0.5 {JUST} -1.7 --goal 1 {JUST} 0.5"
    options = ["-o", str(tmp_path / "motion.csv"), "--intervals", "16"]
    done = invoke([*words.split(), *options])
    assert done.exit_code == 0, done.stderr
    assert done.stderr.count("was set to the limit") == 2
    assert "as read        passes" in done.stdout


# The size of rounding


@pytest.mark.parametrize("travel", [1e-3, 5e-5])
def test_rounding_is_a_share_of_the_travel_of_tiny_axes(travel: float) -> None:
    """Otherwise a stage that travels a tenth of a millimetre could start anywhere."""
    stage = tm.load_robot(
        '<robot name="stage"><link name="base"/><link name="table"><inertial>'
        '<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        '</inertial></link><joint name="x" type="prismatic"><parent link="base"/>'
        f'<child link="table"/><limit lower="{-travel}" upper="{travel}" '
        'velocity="0.01" effort="9"/></joint></robot>',
        gravity=(0, 0, 0),
    )
    room = 0.02 * travel
    with pytest.warns(tm.TominpmpWarning, match="set to the limit"):
        problem = tm.Problem(stage, [travel + 0.9 * room], tm.JointGoal([0.0]))
    assert problem.q_start[0] == travel
    with pytest.raises(tm.ProblemError, match="outside its position limits"):
        tm.Problem(stage, [travel + 1.1 * room], tm.JointGoal([0.0]))


def test_velocities_are_set_to_the_limit(robot: tm.Robot) -> None:
    goal = tm.JointGoal(END, (0.0, -2.00009, 0.0))
    with pytest.warns(
        tm.TominpmpWarning, match="outside its velocity limits"
    ) as warned:
        problem = tm.Problem(robot, END, goal, v_start=(0, 2.00009, 0))
    assert len(warned) == 2
    assert problem.v_start[1] == 2.0 == -problem.goal.final_velocity(3)[1]
    with pytest.raises(tm.ProblemError, match="outside its velocity limits"):
        tm.Problem(robot, END, goal, v_start=(0, 2.00011, 0))


def test_small_overlap_at_the_start_is_refused(robot: tm.Robot) -> None:
    """A start 5e-5 m deep in an obstacle is not taken for rounding."""
    scene = [tm.Sphere("ball", radius=0.5, position=(5, 5, 0))]
    problem = tm.Problem(robot, END, tm.JointGoal(at(1.0)), scene=scene)
    room = float(problem.checker.distances(problem.q_start[None], np.inf).min())
    grown = [tm.Sphere("ball", radius=0.5 + room + 5e-5, position=(5, 5, 0))]
    with pytest.raises(tm.ProblemError, match="start in collision"):
        tm.Problem(robot, END, tm.JointGoal(at(1.0)), scene=grown)
