"""Numbers, joint values and obstacles as they are typed on a command line."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Any, NoReturn, cast

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exceptions import JointNotFound, OptionsError, ProblemError, SceneError
from tominpmp.robot import Robot
from tominpmp.scenario.records import classes
from tominpmp.scene import HeightField, Obstacle, OcTree

OBSTACLE_FORM = "KIND:NAME:KEY=VALUE:..., for example sphere:ball:r=0.1:at=0.5,0,0.3"


def words(text: str) -> list[str]:
    """Split at commas and spaces; brackets around the whole are dropped."""
    return re.split(r"\s*,\s*|\s+", text.strip().strip("[]()").strip())


def number(word: str) -> float | None:
    """Read a number; None if it is none."""
    try:
        return float(word)
    except ValueError:
        return None


def vector(text: str, name: str) -> list[float]:
    """Read numbers.

    Raises:
        OptionsError: If a word is no number.
    """
    result = []
    for word in words(text):
        value = number(word)
        if value is None:
            raise OptionsError(f"{name}: {word!r} is not a number", name)
        result.append(value)
    return result


def joint_pair(text: str, name: str) -> tuple[str, float]:
    """Read ``JOINT=VALUE``.

    Raises:
        OptionsError: If it is not of that form.
    """
    joint, _, word = text.partition("=")
    value = number(word)
    if not joint or value is None:
        raise OptionsError(
            f"{name}: got {text!r}, expected JOINT=VALUE with a number", name
        )
    return joint, value


def joint_values(text: str, name: str) -> float | list[float] | dict[str, float]:
    """Read one number for all joints, one for each, or some by joint name.

    Raises:
        OptionsError: If a word is no number or a joint is named twice.
    """
    if "=" in text:
        return _pairs(words(text), name)
    numbers = vector(text, name)
    return numbers[0] if len(numbers) == 1 else numbers


def _pairs(items: list[str], name: str) -> dict[str, float]:
    result: dict[str, float] = {}
    for item in items:
        joint, value = joint_pair(item, name)
        if joint in result:
            raise OptionsError(f"{name}: joint {joint!r} is named twice", name)
        result[joint] = value
    return result


def positions(
    text: str,
    name: str,
    robot: Robot,
    *,
    base: Array | None = None,
    degrees: bool = False,
) -> Array:
    """Read joint positions.

    Numbers in joint order; or the name of a group state; or ``JOINT=VALUE`` pairs,
    which may follow the name of a group state.

    Args:
        text: The text.
        name: The option, for messages.
        robot: The robot.
        base: Positions of joints of which nothing is said, shape (n,).
        degrees: Whether numbers for joints that turn are in degrees.

    Returns:
        Shape (n,) [rad or m].

    Raises:
        OptionsError: If a pair cannot be read.
        JointNotFound: If a joint is unknown.
        ProblemError: If there are too few or too many numbers, the word is not a group
            state, or nothing is said about a joint.
    """
    items = words(text)
    if number(items[0]) is not None:
        return _vector(vector(text, name), name, robot, degrees=degrees)
    states = {} if robot.srdf is None else robot.srdf.group_states
    state, items = (text.strip(), []) if text.strip() in states else (None, items)
    if items and "=" not in items[0]:
        state = items.pop(0)
    if state is not None and state not in states:
        has = ", ".join(states) or "none"
        raise ProblemError(
            f"{name}: {state!r} is neither a number nor a group state of "
            f"{robot.name!r} (group states: {has})",
            name,
        )
    known = {} if state is None else states[state]
    rest = [known.get(j, np.nan) for j in robot.joint_names]
    start = np.array(rest) if base is None else np.where(np.isnan(rest), base, rest)
    given = _pairs(items, name)
    lacking = [
        joint
        for joint, value in zip(robot.joint_names, start, strict=True)
        if np.isnan(value) and joint not in given
    ]
    if lacking:
        raise ProblemError(
            f"{name} says nothing about {', '.join(lacking)}: name them, or begin with "
            "a group state",
            name,
        )
    return _vector(given, name, robot, base=start, degrees=degrees)


def velocities(text: str, name: str, robot: Robot, *, degrees: bool = False) -> Array:
    """Read joint velocities: numbers in joint order, or pairs; other joints rest.

    Raises:
        OptionsError: If a number or pair cannot be read.
        JointNotFound: If a joint is unknown.
        ProblemError: If there are too few or too many numbers.
    """
    values = joint_values(text, name)
    if isinstance(values, float):
        values = [values]
    return _vector(values, name, robot, base=np.zeros(robot.n), degrees=degrees)


def _vector(
    values: Sequence[float] | Mapping[str, float],
    name: str,
    robot: Robot,
    *,
    base: Array | None = None,
    degrees: bool = False,
) -> Array:
    """Put values in joint order, those of a base where none is given; shape (n,)."""
    sliding = {j.name for j in robot.description.joints if j.kind == "prismatic"}
    radian = np.pi / 180 if degrees else 1.0
    scale = np.array([1.0 if j in sliding else radian for j in robot.joint_names])
    if isinstance(values, Mapping):
        for joint in values:
            if joint not in robot.joint_names:
                raise JointNotFound(joint, robot.joint_names)
        given = np.array([values.get(joint, np.nan) for joint in robot.joint_names])
        named = np.array([joint in values for joint in robot.joint_names])
        return np.asarray(np.where(named, given * scale, base))
    if len(values) != robot.n:
        raise ProblemError(
            f"{name} has {len(values)} number{'' if len(values) == 1 else 's'}, "
            f"expected {robot.n}, one for each of: {', '.join(robot.joint_names)}",
            name,
        )
    return np.asarray(np.array(values) * scale)


# Short words for fields of obstacles; what else is typed for them has no short one.
SHORT = {"radius": "r", "position": "at", "rotation": "quat"}
FULL = {**{short: key for key, short in SHORT.items()}, "l": "length"}
# How many numbers some of them have.
COUNTS = {"radius": 1, "length": 1, "size": 3, "position": 3, "rotation": 4}
# The name comes first, and motions and tables of numbers are for files.
UNTYPED = ("name", "motion", "vertices", "triangles")


def obstacle(text: str) -> Obstacle:
    """Read an obstacle: ``KIND:NAME:KEY=VALUE:...``, with its fields as keys.

    Raises:
        SceneError: If anything in it is wrong.
    """
    kind, _, rest = text.partition(":")
    name, *items = rest.split(":")

    def fail(message: str) -> NoReturn:
        raise SceneError(f"--obstacle {text!r}: {message}", name or None)

    found = classes(Obstacle).items()
    kinds = {k: v for k, v in found if not issubclass(v, HeightField | OcTree)}
    if kind not in kinds:
        fail(
            f"there is no kind {kind!r}; there are: {', '.join(kinds)} "
            f"(expected {OBSTACLE_FORM})"
        )
    if not name or "=" in name:
        fail(f"it has no name (expected {OBSTACLE_FORM})")
    # Those that all have come last.
    known = {f.name: f for f in fields(kinds[kind]) if f.name not in UNTYPED}
    known |= {key: known.pop(key) for key in ("position", "rotation")}
    values: dict[str, Any] = {}
    for item in items:
        word, _, value = item.partition("=")
        key = FULL.get(word, word)
        if key not in known:
            keys = ", ".join(SHORT.get(key, key) for key in known)
            fail(f"{item!r}: the keys of a {kind} are {keys}")
        if key in values:
            fail(f"{SHORT.get(key, key)} is given twice")
        values[key] = _entry(value, key, fail)
    needed = [k for k, f in known.items() if f.default is f.default_factory is MISSING]
    lacking = [k for k in (*needed, "position") if k not in values]
    if lacking:
        fail(f"it lacks {' and '.join(SHORT.get(key, key) for key in lacking)}")
    return cast("Obstacle", kinds[kind](name, **values))


def _entry(value: str, key: str, fail: Callable[[str], NoReturn]) -> Any:
    """Read a number, a list of them, or, where numbers need not be, a word."""
    found = [number(word) for word in words(value)]
    count = COUNTS.get(key)
    if None in found and count is None:
        return value
    if None in found or count not in (None, len(found)):
        expected = "a number" if count == 1 else f"{count} numbers"
        fail(f"{SHORT.get(key, key)} is {value!r}, expected {expected}")
    return found[0] if len(found) == 1 else found
