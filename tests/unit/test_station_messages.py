"""Messages about wrong stations and tasks have their number and their name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import invoke

import tests.sample_arms as arms
import tominpmp as tm
from tominpmp.exceptions import naming

HOME = np.array([0.3, 0.9])
LIMITS = tm.MotionLimits(acceleration=6.0)
BALLS = tm.Scene(
    [
        tm.Sphere("low", radius=0.3, position=(1.0, 0.2, 0.0)),
        tm.Sphere("ball", radius=0.1, position=(3.0, 2.2, 0.0)),
    ]
)
READY = (0.5, 1.7, -1.7)
PART = tm.Sphere("part", radius=0.2)

TIP = "tip"


@pytest.fixture(scope="module")
def arm() -> tm.Robot:
    return arms.two_link_arm(1.0)


@pytest.fixture(scope="module")
def planar() -> tm.Robot:
    return tm.load_robot("planar3r", gravity=(0, 0, 0))


def at(x: float, y: float, frame: str = TIP) -> tm.Goal:
    return tm.PositionGoal(frame, (x, y, 0.0))


FAR, NOWHERE = at(50.0, 0.0), at(1.0, 0.5, "nose")
WRONG: dict[str, tuple[Any, type[Exception], str]] = {
    "frame": (NOWHERE, tm.FrameNotFound, "no frame 'nose'"),
    "one of several frames": (tm.AnyGoal([FAR, NOWHERE]), tm.FrameNotFound, "nose"),
    "type": (3, tm.ProblemError, "goal is 3, expected a JointGoal"),
    "far away": (FAR, tm.ProblemError, "outside reach"),
    "blocked": (tm.JointGoal((0.2, 0.2, 0.2)), tm.ProblemError, "'low' overlap"),
    "limits": (tm.JointGoal((99.0, 0.2, 0.2)), tm.ProblemError, "position limits"),
    "few": (tm.JointGoal((0.2,)), tm.ProblemError, "1 number,"),
    "joint": (tm.JointGoal({"elbow": 1.0}), tm.ProblemError, "a value for 'elbow'"),
    "load": (
        tm.Station("b", at(3, 1), payload=tm.Payload(0.1, "nose")),
        tm.FrameNotFound,
        "no frame 'nose'",
    ),
    "touching": (
        tm.Station("b", at(3, 1), may_touch=[("ball", "shelf")]),
        tm.ProblemError,
        "may_touch: 'shelf' is neither",
    ),
    "after": (
        tm.Station("b", at(3, 1), after="z"),
        tm.ProblemError,
        "station 'z'; there",
    ),
    "loaded": (
        tm.Station("b", at(3, 2), payload=tm.Payload(0.1, TIP, geometry=[PART])),
        tm.ProblemError,
        "link 'payload' and obstacle 'ball' lack",
    ),
}


# A configuration where the arm can hold a load, and one where it cannot.
UPRIGHT, LYING = np.array([1.5, 0.2, -0.2]), np.array([0.5, 1.7, -1.7])
HEAVY = tm.Payload(1.5, TIP)


@pytest.mark.parametrize(
    ("first", "second", "named"),
    [
        (
            LYING,
            UPRIGHT,
            r"station 1 \('pick'\) cannot be reached with its payload: the arm cannot",
        ),
        (UPRIGHT, LYING, r"from station 1 \('pick'\) to station 2 \('place'\): goal: "),
    ],
)
def test_station_where_a_payload_exceeds_the_torques_is_named(
    first: np.ndarray, second: np.ndarray, named: str
) -> None:
    with pytest.raises(tm.TominpmpError, match=named + r".*joint 'joint1' cannot hold"):
        carry(UPRIGHT + 0.1, first, second).raise_if_failed()


def test_payload_is_not_checked_where_it_is_not_carried() -> None:
    tour = carry(LYING, UPRIGHT, UPRIGHT + np.array([0.05, 0.0, 0.0]))
    assert tour.order == ("pick", "place")


def test_payload_is_not_blamed_for_another_violated_constraint() -> None:
    robot = tm.load_robot("planar3r", gravity=(0.0, -9.81, 0.0))
    upright = tm.KeepUpright(TIP, axis=(1, 0, 0), direction=(0, 1, 0), tolerance=0.5)
    for stop in (False, True):
        # The arm is stretched nearly to its full length of 6 m.
        station = tm.Station("pick", at(5.5, 2.3), payload=HEAVY, stop=stop)
        with pytest.raises(tm.ProblemError, match=r"keeps the tilt of frame tip"):
            tm.plan_tour(robot, UPRIGHT, [station], constraints=[upright])


def carry(start: np.ndarray, first: np.ndarray, second: np.ndarray) -> tm.Tour:
    """Carry the load from one configuration to another, below gravity."""
    stations = [
        tm.Station("pick", tm.JointGoal(first), payload=HEAVY, then="place"),
        tm.Station("place", tm.JointGoal(second)),
    ]
    robot = tm.load_robot("planar3r", gravity=(0.0, -9.81, 0.0))
    return tm.plan_tour(robot, start, stations, max_planning_time=20.0)


@pytest.mark.parametrize("case", WRONG)
def test_message_about_a_wrong_station_has_its_number_and_name(
    planar: tm.Robot, case: str
) -> None:
    given, kind, text = WRONG[case]
    with pytest.raises(tm.TominpmpError) as error:
        tm.plan_tour(planar, READY, {"a": at(4, 1), "b": given}, scene=BALLS)
    assert type(error.value) is kind
    assert "station 2 ('b')" in str(error.value) and text in str(error.value)
    if isinstance(error.value, tm.FrameNotFound):
        assert error.value.name == "nose" and TIP in error.value.available


def test_joint_goals_of_stations_may_be_given_by_joint_name(
    arm: tm.Robot,
) -> None:
    first, second = arm.joint_names
    goal = tm.JointGoal({second: 1.1, first: 0.5})
    end = {second: 0.7, first: 0.4}
    tour = tm.plan_tour(arm, HOME, [goal], q_end=end, motion_limits=LIMITS)
    assert np.allclose(tour.visits[0].q, [0.5, 1.1])
    assert np.allclose(tour.motions[-1].trajectory.q[-1], [0.4, 0.7])
    problem = tm.Problem(arm, HOME, tm.JointGoal(HOME))
    assert np.allclose(problem.with_ends(HOME, goal).goal.configuration, [0.5, 1.1])


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"constraints": None}, "constraints"),
        ({"constraints": 3}, "constraints"),
        ({"q_end": {"elbow": 1.0}}, "q_end"),
        ({"stations": [3]}, "stations[0]"),
    ],
)
def test_wrong_argument_of_plan_tour_is_named(
    arm: tm.Robot, arguments: dict[str, Any], field: str
) -> None:
    given = {"stations": [tm.JointGoal(HOME + 0.1)]} | arguments
    with pytest.raises(tm.ProblemError, match=r"expected") as error:
        tm.plan_tour(arm, HOME, **given)
    assert error.value.field == field


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"moves": [[3]]}, "moves is [[3]], expected"),
        ({"moves": np.zeros(3)}, "moves is array([0., 0., 0.]), expected"),
        ({"base": "x"}, "base: the base of 'planar3r' is 'x', expected"),
        ({"base": (9, 9, 0)}, "tasks: number 1 of 1: goal"),
        ({"robot": "ur5"}, "robot is 'ur5', expected a Robot"),
        ({"tasks": [3]}, "tasks[0] is 3, expected"),
    ],
)
def test_wrong_argument_of_improve_placement_is_named(
    planar: tm.Robot, change: dict[str, Any], text: str
) -> None:
    task = tm.Problem(planar, READY, at(4, 1))
    given = {"robot": planar, "tasks": [task], "bounds": {"x": (-0.1, 0.1)}} | change
    with pytest.raises(tm.ProblemError) as error:
        tm.improve_placement(given.pop("robot"), given.pop("tasks"), **given)
    assert text in str(error.value)


@pytest.mark.parametrize("name", ["q_start", "q_end"])
def test_start_or_end_of_a_tour_in_collision_is_named(
    planar: tm.Robot, name: str
) -> None:
    given = {"q_start": READY, "q_end": READY, name: (0.2, 0.2, 0.2)}
    with pytest.raises(
        tm.ProblemError, match=r"in collision: .*'low' overlap"
    ) as error:
        tm.plan_tour(planar, stations=[at(4, 1)], scene=BALLS, **given)
    assert error.value.field == name


def test_plan_many_names_its_problems_and_rejects_wrong_arguments(
    tmp_path: Path,
) -> None:
    (outcome,) = tm.plan_many({"mine": 3}, workers=1, seed=np.int64(3))
    assert outcome.name == "mine" and "the problem is 3" in outcome.message
    under = tmp_path / "file"
    under.write_text("")
    with pytest.raises(tm.ScenarioError, match=r"file.*: .*to write results"):
        tm.plan_many([], results=under / "inside")
    with pytest.raises(tm.ProblemError) as error:
        tm.plan_many([], progress=3)  # type: ignore[arg-type]
    assert error.value.field == "progress"


HEAD = '[robot]\nname = "planar3r"\n[start]\nq = [0.5, 1.2, -0.7]\n'
STATION = '[[stations]]\nname = "a"\ngoal = {type = "joint", q = [0.6, 1.0, -0.3]}\n'
NOSE = 'goal = {type = "position", frame = "nose", position = [3, 1, 0]}\n'


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (f'[[stations]]\nname = "b"\n{NOSE}', "station 2 ('b'): there is no frame"),
        (
            STATION.replace('"a"', '"b"') + 'payload = {mass = 1.0, frame = "nose"}\n',
            "station 2 ('b'): there is no frame",
        ),
        (
            '[tour]\nprecedence = [["a"]]\n',
            "tour.toml: tour.precedence: precedence holds ['a'], expected pairs",
        ),
        ('[tour]\nprecedence = [["a", "b"]]\n', "tour.precedence: there is no station"),
        (
            STATION.replace('"a"', '"b"\nthen = ["c"]'),
            "tour.toml: stations: station 2 ('b'): then: there is no other station",
        ),
        (
            STATION.replace('"a"', '"b"\nthen = ["d"]')
            + STATION.replace('"a"', '"d"\nthen = ["b"]'),
            "tour.toml: stations: precedence has a cycle: 'b before d before b'",
        ),
        (
            STATION.replace('"a"', '"b"\nafter = ["a"]')
            + '[tour]\nprecedence = [["b", "a"]]\n',
            "tour.toml: tour.precedence: precedence has a cycle: 'a before b before a'",
        ),
    ],
)
def test_message_about_a_wrong_tour_file_names_the_station(
    tmp_path: Path, text: str, expected: str
) -> None:
    path = tmp_path / "tour.toml"
    path.write_text(HEAD + STATION + text)
    assert expected in _output(path)


@pytest.mark.parametrize(
    ("option", "value"), [("--dt", "-1"), ("--dt", "nan"), ("--max-time", "0")]
)
def test_tour_command_checks_its_options_before_planning(
    tmp_path: Path, option: str, value: str
) -> None:
    path = tmp_path / "tour.toml"
    path.write_text(HEAD + STATION)
    output = _output(path, option, value)
    assert "expected a positive" in output and "tour.toml" not in output


def _output(path: Path, *arguments: str) -> str:
    done = invoke(["tour", str(path), *arguments])
    assert done.exit_code == 2
    return " ".join(done.output.split())


@pytest.mark.parametrize(
    "make",
    [
        lambda: tm.JointNotFound("x", ["y"], "q"),
        lambda: tm.OptionsError("is wrong", "seed"),
        lambda: tm.ProblemError("is wrong", "q"),
    ],
)
def test_naming_an_error_keeps_its_type_and_attributes(
    make: Callable[[], tm.TominpmpError],
) -> None:
    error = make()
    with pytest.raises(type(error)) as caught, naming("station 1", "stations[0]"):
        raise error
    assert str(caught.value) == f"station 1: {error}"
    known = dict(vars(error))
    if "field" in known:
        known["field"] = "stations[0].q"
    assert vars(caught.value) == known and caught.value.__cause__ is error
