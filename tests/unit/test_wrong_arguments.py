"""Arguments of a wrong type or value raise errors of the library with short
messages.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.exceptions import BRIEF, LONGEST, brief
from tominpmp.files.export import export
from tools.fuzz.arguments import World, Wrong
from tools.fuzz.nonsense import NONSENSE

# Values that are no problem, no motion and no other expected object.
WRONG_VALUES = (None, 5, "x", [1.0], {}, np.zeros(3), object(), "x" * 10**6, 10**5000)


@pytest.fixture(scope="module")
def world() -> World:
    return World()


@pytest.mark.parametrize("wrong", WRONG_VALUES, ids=lambda x: type(x).__name__)
def test_wrong_objects_are_rejected_with_the_name_of_the_argument(
    wrong: object, world: World, tmp_path: Path
) -> None:
    problem, motion = world.problem, world.trajectory
    calls: dict[str, Callable[[], Any]] = {
        "problem": lambda: tm.plan(wrong),
        "problem ": lambda: tm.verify(wrong, motion),
        "problem  ": lambda: tm.certify(wrong, motion),
        "problem   ": lambda: tm.lower_bound(wrong),
        "problem    ": lambda: tm.save_scenario(tmp_path / "a.toml", wrong),
        "trajectory": lambda: tm.verify(problem, wrong),
        "trajectory ": lambda: tm.certify(problem, wrong),
        "trajectory  ": lambda: tm.prove_clearance(problem.checker, wrong),
        "trajectory   ": lambda: export(wrong, tmp_path / "a.csv"),
        "checker": lambda: tm.prove_clearance(wrong, motion),
        "solution": lambda: tm.smooth(wrong),
    }
    if wrong is not None:
        calls |= {
            "options": lambda: tm.plan(problem, wrong),
            "options ": lambda: tm.save_scenario(tmp_path / "a.toml", problem, wrong),
            "tolerances": lambda: tm.verify(problem, motion, wrong),
            "start": lambda: tm.plan(problem, world.options, start=wrong),
        }
    for name, call in calls.items():
        with pytest.raises(tm.ProblemError) as error:
            call()
        message = str(error.value)
        assert message.startswith(f"{name.strip()} is ")
        assert "expected" in message
        assert len(message) < 2 * BRIEF + 100
        assert error.value.field == name.strip()


@pytest.mark.parametrize(
    "path",
    [
        5, None, b"a.csv", [], "", "a\0.csv", "n" * 300 + ".csv", "n/" * 3000 + "a.csv",
        Path("n" * 300 + ".csv"), "\ud800.csv", 10**5000, math.nan,
    ],
    ids=range(12),
)  # fmt: skip
def test_wrong_paths_are_rejected(path: object, world: World) -> None:
    problem, solution = world.problem, world.solution
    for call in (
        lambda: tm.load_motion(path),
        lambda: tm.load_scenario(path),
        lambda: tm.load_joint_limits(path),
        lambda: tm.load_motion_limits(path, world.robot),
        lambda: tm.load_moveit_scene(path),
        lambda: tm.load_moveit(world.robot, path, "request.yaml"),
        lambda: tm.load_robot(path),
        lambda: tm.load_robot("planar3r", srdf=path if path is not None else 5),
        lambda: tm.load_robot("planar3r", package_dirs=[path]),
        lambda: tm.Mesh("a", path=path),
        lambda: tm.save_scenario(path, problem),
        lambda: solution.export(path),
        lambda: solution.plot(path if path is not None else 5),
        lambda: solution.play(path if path is not None else 5),
    ):
        with pytest.raises(tm.TominpmpError) as error:
            call()
        assert len(str(error.value)) < 3 * BRIEF


@pytest.mark.parametrize("name", ["~nouser-at-all/x", "/nowhere/at/all"])
def test_paths_in_unknown_home_folders_are_rejected(
    name: str, world: World, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    for call in (
        lambda: tm.load_motion(name + ".csv"),
        lambda: tm.load_scenario(name + ".toml"),
        lambda: tm.load_robot(name + ".urdf"),
        lambda: tm.load_robot("planar3r", package_dirs=name),
        lambda: tm.load_robot("planar3r", srdf=name),
        lambda: tm.Mesh("a", path=name + ".stl"),
        lambda: world.solution.export(name + ".csv"),
        lambda: tm.save_scenario(name + ".toml", world.problem),
    ):
        with pytest.raises(tm.TominpmpError):
            call()
    assert not list(tmp_path.iterdir())


def test_cache_in_an_unknown_home_folder_is_taken_literally(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from tominpmp.collision.decomposition_cache import cache_folder

    monkeypatch.setenv("TOMINPMP_CACHE", "~nouser-at-all/x")
    assert cache_folder() == Path("~nouser-at-all/x")


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: tm.MotionLimits(effort_curves="x"), "effort_curves is 'x'"),
        (lambda: tm.MotionLimits(effort_curves=5), "effort_curves is 5"),
        (lambda: tm.MotionLimits().renamed({"a": [1]}, ["a"]), r"names is \[\[1\]\]"),
        (
            lambda: tm.MotionLimits().renamed({"a": "c", "b": "c"}, ["a", "b"]),
            "names is .'c', 'c'., expected names of joints, all of them different",
        ),
        (lambda: tm.JointRegionGoal([0.0], joints=5), "goal.joints is 5"),
        (lambda: tm.Trajectory(5, [0, 1], 0, 0, 0), "joint_names is 5"),
        (lambda: tm.load_robot("planar3r", armature=10**400), "armature: got 10000"),
        (lambda: tm.load_robot("planar3r", damping="0.1"), "damping: got '0.1'"),
        (lambda: tm.load_robot("planar3r", gravity=10**400), "gravity is 10000"),
        (
            lambda: tm.load_robot("planar3r", locked_joints={"joint1": 10**400}),
            "joint joint1 is 10000",
        ),
        (lambda: tm.load_robot("planar3r", locked_joints=[]), "locked_joints"),
        (lambda: tm.Options(slack=1e300), "slack is 1e.300, expected .* at most 10"),
        (lambda: tm.Options(intervals=10**6), "intervals is 1000000, .* at most 10000"),
        (lambda: tm.Options(processes=10**4), "processes is 10000, .* at most 256"),
        (lambda: tm.Options(max_planning_time=1e300), "at most 1e.09"),
        (lambda: tm.Options(seed=10**5000), "seed is .*, at most 9223"),
        (lambda: tm.Tolerances(goal="x"), "goal is 'x', expected a tolerance"),
        (lambda: tm.Tolerances(goal=math.nan), "goal is nan, expected a tolerance"),
        (lambda: tm.JointLimits(*["x"] * 5), "position_lower is 'x'"),
        (lambda: tm.JointLimits([1], [1, 2], [1], [1], [1]), "lengths differ"),
        (lambda: tm.Scene(range(10**12)), "a scene holds obstacles"),
        (lambda: tm.Sphere("x" * 256, radius=1.0), "name of at most 255"),
        (lambda: tm.JointGoal(range(10**12)), "goal.q is range"),
        # Squares and reciprocals of the values must be finite, too.
        (lambda: tm.Payload(1e308, "tip"), "payload.mass is 1e.308"),
        (lambda: tm.Payload(1.0, "tip", com=(1e308, 0, 0)), "payload.com is .1e.308"),
        (lambda: tm.Payload(1.0, "tip", inertia=1e308 * np.eye(3)), "payload.inertia"),
        (lambda: tm.Box("x", size=(1e308, 1, 1)), "size along x is 1e.308"),
        (lambda: tm.Cylinder("x", radius=1, length=1e308), "length is 1e.308"),
        (lambda: tm.load_robot("planar3r", velocity=1e-308), "joint1 got 1e-308"),
        (lambda: tm.MotionLimits(acceleration=1e-308), "acceleration is 1e-308"),
        (lambda: tm.MotionLimits(jerk=1e308), "jerk is 1e.308"),
    ],
)
def test_wrong_values_are_named(make: Callable[[], Any], word: str) -> None:
    with pytest.raises(tm.TominpmpError, match=word) as error:
        make()
    assert len(str(error.value)) < 3 * BRIEF


def test_swapped_moveit_arguments_are_rejected(world: World) -> None:
    for call in (
        lambda: tm.load_moveit("scene.yaml", world.robot, "request.yaml"),
        lambda: tm.load_moveit("scene.yaml", "request.yaml", world.robot),
        lambda: tm.load_moveit_scene(world.robot, "scene.yaml"),
    ):
        with pytest.raises(tm.TominpmpError, match=r"expected|no file"):
            call()


def test_wrong_names_of_frames_and_states_are_rejected(world: World) -> None:
    for name in (5, None, [], {}, b"tip", "\ud800", np.zeros(3), "x" * 10**6):
        with pytest.raises(tm.FrameNotFound):
            world.robot.frame_id(name)
        with pytest.raises(tm.ProblemError):
            world.robot.group_state(name)


def test_brief_shows_any_value_on_one_line() -> None:
    for make in NONSENSE.values():
        text = brief(make())
        assert text
        assert len(text) <= BRIEF
        assert "\n" not in text
    assert brief("tip") == "'tip'"
    assert brief(0.5) == "0.5"
    numbers = [np.float64(0.5), (np.int32(2), np.bool_(True))]
    assert brief(numbers) == "[0.5, (2, True)]"
    assert brief(np.str_("tip")) == "'tip'"


def test_messages_have_a_largest_length() -> None:
    assert len(str(tm.ProblemError("x" * 10**7))) == LONGEST


def test_random_wrong_calls_raise_only_errors_of_the_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The short version of the fuzzing campaign: a call raises errors of the library or
    succeeds.
    """
    monkeypatch.chdir(tmp_path)
    wrong = Wrong()
    for number in range(300):
        name, call = wrong.run(np.random.default_rng([1, number]))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                call()
        except tm.TominpmpError as error:
            assert len(str(error)) <= LONGEST
        except Exception as error:
            pytest.fail(f"{name} raised {error!r}")


def test_sampling_time_longer_than_the_motion_gives_two_rows(
    world: World, tmp_path: Path
) -> None:
    for dt in (1e100, 1e9, 99.0):
        path = tmp_path / "a.csv"
        export(world.trajectory, path, dt=dt)
        assert tm.load_motion(path).t.size == 2


@pytest.mark.parametrize(
    "call",
    [
        lambda: tm.JointRegionGoal([0.0], [1.0], joints=range(10**15)),
        lambda: tm.JointRegionGoal([0.0], range(10**15)),
        lambda: tm.RegionGoal(
            "tip", (0, 0, 0), (1, 1, 1), angle_tolerance=range(10**15)
        ),
        lambda: tm.Samples(np.array("one"), [0.0], [[0.0]], [[0.0]], [[0.0]], [[0.0]]),
    ],
)
def test_endless_ranges_and_scalar_arrays_are_rejected(call):
    with pytest.raises((tm.TominpmpError, TypeError)) as caught:
        call()
    assert isinstance(caught.value, tm.TominpmpError), caught.value
