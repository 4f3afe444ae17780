"""Values of flags: numbers, joint values, lists of words, and obstacles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from cli_samples import Run
from hypothesis import given
from hypothesis import strategies as st

from tominpmp.cli.options import ProblemOptions
from tominpmp.cli.parser import join_lists
from tominpmp.cli.problem import joint_values, obstacle, positions, rates
from tominpmp.exceptions import OptionsError, ProblemError
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.obstacles import Capsule, Cylinder

# Options of plan that take several words.
LISTS = ("--start", "--goal", "--gravity")


def test_positions_are_read_from_names_states_and_lists(planar3r: Robot) -> None:
    base = np.array([1.0, 2.0, 3.0])

    def read(text: str, **options: Any) -> list[float]:
        return positions(
            ProblemOptions(goal=text), "goal", planar3r, **options
        ).tolist()

    assert read("joint2=-1", base=base) == [1.0, -1.0, 3.0]
    assert read("joint3=0.1 joint1=0.2", base=base) == [0.2, 2.0, 0.1]
    assert read("start") == [0.5, 1.7, -1.7]
    assert read("start,joint3=1") == [0.5, 1.7, 1.0]
    assert read("joint1=1,joint2=1,joint3=1") == [1.0, 1.0, 1.0]
    assert read("[0.5, 1.7, -1.7]") == [0.5, 1.7, -1.7]
    with pytest.raises(ProblemError, match="--goal has no value for joint1, joint3"):
        read("joint2=1")


def test_degrees_convert_revolute_joints_only(slider: Robot) -> None:
    given = ProblemOptions(start="1.5, 90", goal="swing=-180", degrees=True)
    read = positions(given, "start", slider)
    np.testing.assert_allclose(read, [1.5, math.pi / 2], rtol=1e-15)
    base = np.array([0.25, 1.0])
    read = positions(given, "goal", slider, base=base)
    np.testing.assert_allclose(read, [0.25, -math.pi], rtol=1e-15)
    given = ProblemOptions(start_velocity="slide=2,swing=180", degrees=True)
    read = rates(given, "start_velocity", slider)
    assert read is not None
    np.testing.assert_allclose(read, [2.0, math.pi], rtol=1e-15)


def test_degrees_do_not_convert_group_states(planar3r: Robot) -> None:
    given = ProblemOptions(start="start,joint1=90", degrees=True)
    read = positions(given, "start", planar3r)
    np.testing.assert_allclose(read, [math.pi / 2, 1.7, -1.7], rtol=1e-15)


def test_joint_values_are_read_from_numbers_and_names() -> None:
    assert joint_values(["3", "inf"], "--velocity") == [3.0, math.inf]
    assert joint_values(["a=3", "b=-1e2"], "--effort") == {"a": 3.0, "b": -100.0}
    with pytest.raises(OptionsError, match="'a' is named twice"):
        joint_values(["a=1", "a=2"], "--effort")
    with pytest.raises(OptionsError, match="got '2', expected JOINT=VALUE"):
        joint_values(["a=1", "2"], "--effort")


@pytest.mark.parametrize(
    ("typed", "joined"),
    [
        ("plan r --start 1 -2 3 --goal 4", "plan r --start=1,-2,3 --goal=4"),
        ("plan --start 1 -2 3 r", "plan --start=1,-2,3 r"),
        ("plan r --start=1 -2 -q", "plan r --start=1,-2 -q"),
        ("plan r --goal a=1 b=-2 -o x", "plan r --goal=a=1,b=-2 -o x"),
        (
            "plan r --gravity 0 0 -1 --margin 1 2",
            "plan r --gravity=0,0,-1 --margin 1 2",
        ),
        ("plan r --goal-position tip 1 2 3", "plan r --goal-position tip 1 2 3"),
        ("plan r --start -1 -2", "plan r --start=-1,-2"),
        ("plan r --start -1, -2,", "plan r --start=-1,-2,"),
        ("plan r --start home --goal .5,1", "plan r --start home --goal=.5,1"),
        ("plan r --start", "plan r --start"),
        ("1 2 3", "1 2 3"),
    ],
)
def test_words_of_a_list_flag_are_joined(typed: str, joined: str) -> None:
    assert join_lists(typed.split(), LISTS) == joined.split()


@given(
    st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=3, max_size=3)
)
def test_numbers_of_a_list_flag_are_read_exactly(numbers: list[float]) -> None:
    robot = load_robot_once()
    for words in (
        ["--start", *map(repr, numbers)],
        ["--start", ", ".join(map(repr, numbers))],
    ):
        (word,) = join_lists(words, LISTS)
        option, _, text = word.partition("=")
        assert option == "--start"
        read = positions(ProblemOptions(start=text), "start", robot)
        assert read.tolist() == numbers


_loaded: list[Robot] = []


def load_robot_once() -> Robot:
    """The bundled arm; generated examples cannot use a fixture."""
    if not _loaded:
        _loaded.append(load_robot("planar3r"))
    return _loaded[0]


def test_obstacle_flag_reads_cylinders_and_capsules() -> None:
    can = obstacle("cylinder:can:radius=0.03:length=.14:at=1 2 3")
    assert isinstance(can, Cylinder)
    assert (can.name, can.radius, can.length) == ("can", 0.03, 0.14)
    np.testing.assert_array_equal(can.position, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(can.rotation, np.eye(3))
    pill = obstacle("capsule:pill:l=1:r=2:at=-1,0,0:quat=1,0,0,0")
    assert isinstance(pill, Capsule)
    assert (pill.radius, pill.length) == (2.0, 1.0)
    np.testing.assert_array_equal(pill.rotation, np.diag([1.0, -1.0, -1.0]))


@given(st.text(alphabet="sphereboxaml:=,.-019 '\"[]\u00e9\n", max_size=40))
def test_any_obstacle_text_is_read_or_raises_a_scene_error(text: str) -> None:
    for form in (text, f"sphere:{text}", f"box:a:{text}", f"sphere:b:r=1:at={text}"):
        try:
            assert obstacle(form).name
        except OptionsError as error:
            assert str(error)


@given(st.text(alphabet="startjoint123=,. -e+inf[]()\u0663\n", max_size=30))
def test_any_positions_text_is_read_or_raises_an_options_error(text: str) -> None:
    try:
        read = positions(ProblemOptions(start=text), "start", load_robot_once())
    except (OptionsError, ProblemError) as error:
        assert str(error)
    else:
        assert read.shape == (3,)


def test_first_number_of_a_list_flag_may_be_negative(run: Run) -> None:
    """Regression: ``--start -0.5 ...`` was read as a flag without a value."""
    ends = "--start -0.5 -1.1 0.6 0 0 0 --goal -0.4 -1 0.8 0.1 0.2 0.3".split()
    result = run("plan", "ur5", *ends, "--planning-effort", "quick")
    assert result.exit_code == 0, result.stderr
