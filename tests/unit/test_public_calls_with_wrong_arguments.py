"""Public methods with wrong arguments raise errors of the library, and no others.

The tests walk all public classes, so that they cover a new method at once.
"""

from __future__ import annotations

import enum
import inspect
import math
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.exceptions import brief
from tominpmp.kinematics import RobotKinematics
from tominpmp.scene.motion import Placement
from tools.fuzz.arguments import RARE, World, make_cases, scene_cases

WRONG = (
    None, "a", math.nan, -1, 10**400, 1j, [], ["a"], {1: 2}, np.zeros((2, 5)),
    np.zeros(0), np.array([None, "x"]), object(), [[1.0], [2.0, 3.0]],
)  # fmt: skip
# Without lists and dicts of one item, which may be names that the error calls unknown.
ANY = [item for item in WRONG if not (isinstance(item, list | dict) and len(item) == 1)]
# Classes that only the library instantiates, and whose methods have no arguments.
RESULTS = {
    "Certificate", "ClearanceProof", "ExportCheck", "ImprovedPlacement", "Outcome",
    "IterationRecord", "Refusal", "Scenario", "State", "Tour", "Verification", "Visit",
    "Dataset", "Status",
}  # fmt: skip
BASES = {"Goal", "Motion", "Obstacle", "PathConstraint"}
# Ends of the names of methods that take several states at once.
SEVERAL = ("_rows", "sizes")
# Methods that draw, write or plan take time; tools/fuzz and other tests cover them.
SLOW = {
    "plot", "play", "export", "plot_certificate", "replay", "prove_clearance",
    "with_payload", "with_changes", "with_locked",
}  # fmt: skip


@cache
def world() -> World:
    return World()


@cache
def samples() -> dict[str, Any]:
    """A valid object of each class that has methods."""
    robot, tip = world().robot, "tip"
    pose = np.eye(4)
    goals = [
        tm.JointGoal([2.0, -1.0, 0.5]),
        tm.JointRegionGoal([2.0], joints=["joint1"], tolerance=0.1),
        tm.PositionGoal(tip, (4, 1, 0)),
        tm.PoseGoal(tip, pose),
        tm.RegionGoal(tip, (-1, -1, -1), (1, 1, 1)),
        tm.AxisGoal(tip, (0, 0, 1), (0, 0, 1)),
        tm.AnyGoal((tm.PositionGoal(tip, (4, 1, 0)),)),
        tm.AllGoals((tm.PositionGoal(tip, (4, 1, 0)),)),
    ]
    constraints = [
        tm.ToolSpeed(tip, 1.0),
        tm.ToolAcceleration(tip, 9.0),
        tm.KeepUpright(tip, tolerance=0.3),
        tm.KeepOrientation(tip, np.eye(3), tolerance=0.3),
        tm.AxisFixed(tip, (0, 0, 1), (0, 0, 1), tolerance=0.1),
        tm.KeepAway(tip, (0, 0, 0), 0.1),
        tm.WithinRegion(tip, (-9, -9, -9), (9, 9, 9)),
        tm.ToolLine(tip, (4, 1, 0), (3, 1, 0)),
        tm.ToolArc(tip, (4, 1, 0), (3, 1, 0)),
        tm.ToolPolyline(tip, [(4, 1, 0), (3, 2, 0)]),
        tm.JointCoupling(["joint1"], [1.0], 9.0),
    ]
    payload = tm.Payload(0.1, tip)
    others = [
        tm.EffortCurve([0.0, 1.0], [9.0, 5.0]),
        tm.MotionLimits(acceleration=10.0),
        tm.MoveItLimits(Path("limits.yaml"), {}, {}, {}),
        tm.LowerBound(1.0, "nothing"),
        tm.Segment(goals[0]),
        tm.Station("a", goals[0]),
        tm.Tolerances(),
        payload,
    ]
    found = [getattr(world(), name) for name in KINDS]
    for name, (make, given) in scene_cases(world()).items():
        if name != "Mesh":
            takes = inspect.signature(make).parameters
            found.append(make(**{k: v for k, v in given.items() if k in takes}))
    every = [*found, *goals, *(item.on(robot) for item in constraints), *others]
    every.append(robot.limits)
    return {type(item).__name__: item for item in every}


KINDS = ("robot", "problem", "options", "solution", "trajectory", "samples", "workcell")


@cache
def valid_arguments() -> dict[str, Any]:
    """Valid arguments, by their names, which are the same in the whole library."""
    robot, rest = world().robot, np.zeros(3)
    start = Placement(np.eye(3), np.zeros(3))
    return {
        **{name: getattr(world(), name) for name in (*KINDS, "goal", "scene")},
        **dict.fromkeys(("q", "v", "a", "u", "by", "point", "first", "last"), rest),
        "kinematics": RobotKinematics(robot), "t": np.zeros(1), "time": 0.1, "n": 3,
        "times": np.array([0.0, 0.1]), "begin": np.zeros(2), "end": np.ones(2),
        "points": np.zeros((2, 3)), "rotation": np.eye(3), "name": "a", "count": 3,
        "instants": 2, "joint_names": robot.joint_names, "prefix": "a/", "slack": 0.1,
        "start": start, "given": start, "changes": {}, "q_start": [0.5, 1.7, -1.7],
        "values": {"a": rest, "b": rest}, "speed": 1.0, "effort": 2.0, "power": 3.0,
    }  # fmt: skip


def calls(name: str) -> Iterator[tuple[str, Callable[..., Any]]]:
    """The class itself, and methods of a sample of it."""
    kind = getattr(tm, name)
    if name not in RESULTS | BASES | {"Options", "OcTree", "Mesh"}:
        yield name, kind
    for key in dir(kind) if name in samples() else ():
        item = inspect.getattr_static(kind, key)
        found = callable(item) or isinstance(item, classmethod | staticmethod)
        named = not key.startswith("_") or key in ("__call__", "__contains__")
        if found and named and key not in SLOW and not inspect.isclass(item):
            yield f"{name}.{key}", getattr(samples()[name], key)


def public_classes() -> list[str]:
    found = {name: getattr(tm, name) for name in tm.__all__}
    return [
        name
        for name, kind in found.items()
        if inspect.isclass(kind)
        and not issubclass(kind, BaseException | enum.Enum)
        and name not in BASES
    ]


@pytest.mark.parametrize("name", public_classes())
def test_wrong_arguments_raise_only_errors_of_the_library(
    name: str, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    leaks = []
    for where, function in calls(name):
        known = inspect.signature(function).parameters
        keys = [k for k, p in known.items() if p.kind not in (p.VAR_POSITIONAL,)]
        keys = [k for k in keys if known[k].kind is not known[k].VAR_KEYWORD]
        several = where.endswith(SEVERAL)
        base = {
            k: valid_arguments().get(k)
            for k in keys
            if known[k].default is inspect._empty
        }
        if several:
            base |= {k: base[k][None] for k in ("q", "v", "a")}
        for key in keys:
            for value in WRONG:
                if error := leak(function, {**base, key: value}):
                    leaks.append(f"{where}({key}={value!r:.40}): {error!r:.80}")
    assert not leaks, "\n".join(leaks)


def leak(function: Callable[..., Any], given: dict[str, Any]) -> Exception | None:
    """The exception of a call that is no error of the library, or None."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            function(**given)
    except tm.TominpmpError as error:
        assert len(str(error)) < 3100
    except NotImplementedError:
        pass  # a method that this kind of constraint does not have
    except Exception as error:
        return error
    return None


def test_every_class_with_methods_is_covered() -> None:
    tried = samples().keys() | RESULTS | BASES
    # Classes that need a mesh or a held load belong to families that are covered.
    assert set(public_classes()) - tried <= {"FirmGrasp", "Mesh", "StableContact"}


@cache
def valid_calls() -> dict[str, Any]:
    return make_cases(world())


# These calls read a file first, which does not exist, or load a robot each time.
UNTRIED = RARE | {"Options", "load_robot", "load_moveit"}


@pytest.mark.parametrize("name", sorted(valid_calls().keys() - UNTRIED))
def test_error_names_the_wrong_argument(
    name: str, tmp_path: Path, monkeypatch: Any
) -> None:
    """All arguments of a call are valid except for one argument."""
    monkeypatch.chdir(tmp_path)
    function, given = valid_calls()[name]
    unnamed = []
    for key in given:
        for value in ANY:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    function(**{**given, key: value})
            except tm.TominpmpError as error:
                text = f"{error} {getattr(error, 'field', '')}"
                # An object that is not found is called by name, as "no frame 'a'".
                known = (key, brief(value)[:60], "there is no", "robots")
                if not any(part in text for part in known):
                    unnamed.append(f"{key}={value!r:.40}: {text:.120}")
    assert not unnamed, "\n".join(unnamed)


# -- messages --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda r: r.expand("a"), r"q is 'a', expected 3 numbers, one for each joint"),
        (
            lambda r: r.expand([[0.0, 0.0]]),
            r"q has shape \(1, 2\), expected \(..., 3\)",
        ),
        (lambda r: r.expand_tangent(None), "v is None, expected 3 numbers"),
        (lambda r: r.reduce_tangent(5.0), r"rows has shape \(\), expected \(..., 3\)"),
        (
            lambda _: tm.PositionGoal("tip", (1, 0, 0)).validate("a"),
            "robot is 'a', expected a Robot",
        ),
        (
            lambda _: tm.ToolSpeed("tip", 1.0).excess_at_rest(np.zeros(3)),
            "the constraint has no robot, expected the result of",
        ),
        (
            lambda r: (
                tm.ToolSpeed("tip", 1.0).on(r).lack(np.zeros(2), np.zeros(3), 0.0)
            ),
            r"q has shape \(1, 2\), expected",
        ),
        (lambda r: tm.MotionLimits().by_joint("speed", ["a"]), "name is 'speed'"),
        (
            lambda _: tm.EffortCurve.power("a", 1.0, 1.0),
            "effort is 'a', expected a positive num",
        ),
    ],
)
def test_messages_name_value_and_expectation(
    call: Callable[[Any], Any], message: str
) -> None:
    with pytest.raises(tm.ProblemError, match=message):
        call(world().robot)


@pytest.mark.parametrize("integrator", ["a", 5, ["DOP853"], np.zeros(2)])
def test_unknown_integrators_are_refused(integrator: Any) -> None:
    with pytest.raises(tm.TominpmpError, match="integrator"):
        tm.verify(world().problem, world().trajectory, integrator=integrator)


def test_warnings_name_the_line_that_calls_the_library() -> None:
    robot = world().robot
    with pytest.warns(tm.TominpmpWarning) as caught:
        robot.with_locked({"joint1": 3.1})
        high = robot.limits.position_upper[0] + 1e-8
        tm.Problem(robot, [high, 1.0, -1.0], tm.JointGoal([0.5, 1.0, -1.0]))
    assert len(caught) == 2
    assert {item.filename for item in caught} == {__file__}
