"""Numbers, joint values and obstacles as they are typed on a command line."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exceptions import JointNotFound, OptionsError, ProblemError, SceneError
from tominpmp.robot import Robot
from tominpmp.scene import Box, Capsule, Cylinder, Obstacle, Sphere

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
    scale = _angle_scale(robot) if degrees else np.ones(robot.n)
    items = words(text)
    if number(items[0]) is not None:
        values = np.array(vector(text, name))
        if values.size != robot.n:
            raise _wrong_count(name, values.size, robot)
        return np.asarray(values * scale)
    known: dict[str, float] = {}
    states = {} if robot.srdf is None else robot.srdf.group_states
    if text.strip() in states:
        known.update(states[text.strip()])
        items = []
    elif "=" not in items[0]:
        if items[0] not in states:
            has = ", ".join(states) or "none"
            raise ProblemError(
                f"{name}: {items[0]!r} is neither a number nor a group state of "
                f"{robot.name!r} (group states: {has})",
                name,
            )
        known.update(states[items.pop(0)])
    for joint, value in _pairs(items, name).items():
        if joint not in robot.joint_names:
            raise JointNotFound(joint, robot.joint_names)
        known[joint] = value * scale[robot.joint_names.index(joint)]
    return _complete(known, name, robot, base)


def _wrong_count(name: str, count: int, robot: Robot) -> ProblemError:
    return ProblemError(
        f"{name} has {count} number{'' if count == 1 else 's'}, expected {robot.n}, "
        f"one for each of: {', '.join(robot.joint_names)}",
        name,
    )


def _complete(
    known: Mapping[str, float], name: str, robot: Robot, base: Array | None
) -> Array:
    """Put positions by joint name in order, the base where there is none."""
    lacking = [joint for joint in robot.joint_names if joint not in known]
    if lacking and base is None:
        raise ProblemError(
            f"{name} says nothing about {', '.join(lacking)}: name them, or begin with "
            "a group state",
            name,
        )
    rest = np.zeros(robot.n) if base is None else base
    return np.array(
        [known.get(j, rest[i]) for i, j in enumerate(robot.joint_names)], dtype=float
    )


def _angle_scale(robot: Robot) -> Array:
    """Factor from degrees for joints that turn, 1 for those that slide, shape (n,)."""
    sliding = {j.name for j in robot.description.joints if j.kind == "prismatic"}
    return np.array([1.0 if j in sliding else np.pi / 180 for j in robot.joint_names])


def velocities(text: str, name: str, robot: Robot, *, degrees: bool = False) -> Array:
    """Read joint velocities: numbers in joint order, or pairs; other joints rest.

    Raises:
        OptionsError: If a number or pair cannot be read.
        JointNotFound: If a joint is unknown.
        ProblemError: If there are too few or too many numbers.
    """
    scale = _angle_scale(robot) if degrees else np.ones(robot.n)
    values = joint_values(text, name)
    if isinstance(values, dict):
        for joint in values:
            if joint not in robot.joint_names:
                raise JointNotFound(joint, robot.joint_names)
        given = np.array([values.get(joint, 0.0) for joint in robot.joint_names])
    else:
        given = np.atleast_1d(np.array(values))
    if given.shape != (robot.n,):
        raise _wrong_count(name, given.size, robot)
    return np.asarray(given * scale)


# Keys of each kind of obstacle with the number of values; all but "quat" are needed.
_PLACE = {"at": 3, "quat": 4}
_KINDS: dict[str, tuple[Callable[..., Obstacle], dict[str, int]]] = {
    "sphere": (Sphere, {"r": 1, **_PLACE}),
    "box": (Box, {"size": 3, **_PLACE}),
    "cylinder": (Cylinder, {"r": 1, "length": 1, **_PLACE}),
    "capsule": (Capsule, {"r": 1, "length": 1, **_PLACE}),
}
_FIELDS = {"r": "radius", "at": "position", "quat": "rotation"}
_SHORT = {"radius": "r", "position": "at", "rotation": "quat", "l": "length"}


def obstacle(text: str) -> Obstacle:
    """Read an obstacle: ``KIND:NAME:KEY=VALUE:...``.

    Raises:
        SceneError: If anything in it is wrong.
    """
    kind, _, rest = text.partition(":")
    name, *fields = rest.split(":")

    def fail(message: str) -> SceneError:
        return SceneError(f"--obstacle {text!r}: {message}", name or None)

    if kind not in _KINDS:
        raise fail(
            f"there is no kind {kind!r}; there are: {', '.join(_KINDS)} "
            f"(expected {OBSTACLE_FORM})"
        )
    if not name or "=" in name:
        raise fail(f"it has no name (expected {OBSTACLE_FORM})")
    make, keys = _KINDS[kind]
    values: dict[str, Any] = {}
    for item in fields:
        key, _, value = item.partition("=")
        key = _SHORT.get(key, key)
        if key not in keys:
            raise fail(f"{item!r}: the keys of a {kind} are {', '.join(keys)}")
        if key in values:
            raise fail(f"{key} is given twice")
        found = [number(word) for word in words(value)]
        if None in found or len(found) != keys[key]:
            count = "a number" if keys[key] == 1 else f"{keys[key]} numbers"
            raise fail(f"{key} is {value!r}, expected {count}")
        values[key] = found if keys[key] > 1 else found[0]
    lacking = [key for key in keys if key not in values and key != "quat"]
    if lacking:
        raise fail(f"it lacks {' and '.join(lacking)}")
    return make(name, **{_FIELDS.get(key, key): v for key, v in values.items()})
