"""Numbers, joint values and obstacles as they are typed on a command line."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from types import MappingProxyType
from typing import Any, cast

import numpy as np

from tominpmp.arrays import Array, field_type
from tominpmp.constraints import PathConstraint
from tominpmp.exceptions import JointNotFound, OptionsError, ProblemError, SceneError
from tominpmp.files.records import classes
from tominpmp.robot import Robot
from tominpmp.scene import HeightField, Obstacle, OcTree

CONSTRAINT_FORM = "KIND:KEY=VALUE:..., for example tool_speed:frame=tip:limit=0.5"
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
    found = [(word, number(word)) for word in words(text)]
    for word, value in found:
        if value is None:
            raise OptionsError(f"{name}: {word!r} is not a number", name)
    return [value for _, value in found if value is not None]


def joint_pairs(items: Sequence[str], name: str) -> dict[str, float]:
    """Read ``JOINT=VALUE`` of several joints.

    Raises:
        OptionsError: If one is not of that form, or a joint is named twice.
    """
    result: dict[str, float] = {}
    for item in items:
        joint, _, word = item.partition("=")
        value = number(word)
        if not joint or value is None:
            raise OptionsError(
                f"{name}: got {item!r}, expected JOINT=VALUE with a number", name
            )
        if joint in result:
            raise OptionsError(f"{name}: joint {joint!r} is named twice", name)
        result[joint] = value
    return result


def joint_values(text: str, name: str) -> float | list[float] | dict[str, float]:
    """Read one number for all joints, one for each, or some by joint name.

    Raises:
        OptionsError: If a word is no number or a joint is named twice.
    """
    if "=" in text:
        return joint_pairs(words(text), name)
    numbers = vector(text, name)
    return numbers[0] if len(numbers) == 1 else numbers


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
        known = _by_joint(vector(text, name), name, robot, degrees)
        return np.array([known[joint] for joint in robot.joint_names])
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
    known = {} if base is None else dict(zip(robot.joint_names, base, strict=True))
    known |= {} if state is None else states[state]
    known |= _by_joint(joint_pairs(items, name), name, robot, degrees)
    lacking = [joint for joint in robot.joint_names if joint not in known]
    if lacking:
        raise ProblemError(
            f"{name} says nothing about {', '.join(lacking)}: name them, or begin with "
            "a group state",
            name,
        )
    return np.array([known[joint] for joint in robot.joint_names])


def velocities(text: str, name: str, robot: Robot, *, degrees: bool = False) -> Array:
    """Read joint velocities: numbers in joint order, or pairs; other joints rest.

    Raises:
        OptionsError: If a number or pair cannot be read.
        JointNotFound: If a joint is unknown.
        ProblemError: If there are too few or too many numbers.
    """
    values = joint_pairs(words(text), name) if "=" in text else vector(text, name)
    known = _by_joint(values, name, robot, degrees)
    return np.array([known.get(joint, 0.0) for joint in robot.joint_names])


def _by_joint(
    values: Sequence[float] | Mapping[str, float],
    name: str,
    robot: Robot,
    degrees: bool,
) -> dict[str, float]:
    """Values by joint name in SI units, of one for each joint or of some by name."""
    if not isinstance(values, Mapping):
        if len(values) != robot.n:
            raise ProblemError(
                f"{name} has {len(values)} number{'' if len(values) == 1 else 's'}, "
                f"expected {robot.n}, one for each of: {', '.join(robot.joint_names)}",
                name,
            )
        values = dict(zip(robot.joint_names, values, strict=True))
    for joint in values:
        if joint not in robot.joint_names:
            raise JointNotFound(joint, robot.joint_names)
    turn = {j.name for j in robot.description.joints if j.kind != "prismatic"}
    return {
        joint: np.pi / 180 * value if degrees and joint in turn else value
        for joint, value in values.items()
    }


# Short words for fields; the others are typed as they are.
SHORT = {"radius": "r", "position": "at", "rotation": "quat"}
FULL = {**{short: key for key, short in SHORT.items()}, "l": "length"}
# How many numbers some of them have.
COUNTS = {"radius": 1, "length": 1, "size": 3, "position": 3, "rotation": 4}
# Motions and tables of numbers are for files.
UNTYPED = ("motion", "vertices", "triangles")


def obstacle(text: str) -> Obstacle:
    """Read an obstacle: ``KIND:NAME:KEY=VALUE:...``, with its fields as keys.

    Raises:
        SceneError: If anything in it is wrong.
    """
    found = classes(Obstacle).items()
    kinds = {k: v for k, v in found if not issubclass(v, HeightField | OcTree)}
    kind, _, rest = text.partition(":")
    name, *items = rest.split(":")
    try:
        if kind in kinds and (not name or "=" in name):
            raise OptionsError(f"it has no name (expected {OBSTACLE_FORM})")
        made = _record(kind, items, kinds, OBSTACLE_FORM, {"name": name}, ["position"])
    except OptionsError as error:
        raise SceneError(f"--obstacle {text!r}: {error}", name or None) from error
    return cast("Obstacle", made)


def constraint(text: str) -> PathConstraint:
    """Read a constraint: ``KIND:KEY=VALUE:...``, with its fields as keys.

    Raises:
        ProblemError: If anything in it is wrong.
    """
    kind, *items = text.split(":")
    kinds = classes(PathConstraint, "")
    try:
        return cast("PathConstraint", _record(kind, items, kinds, CONSTRAINT_FORM))
    except (OptionsError, ProblemError) as error:
        raise ProblemError(f"--constraint {text!r}: {error}", "constraints") from error


def _record(
    kind: str,
    items: Sequence[str],
    kinds: Mapping[str, type[Any]],
    form: str,
    values: Mapping[str, Any] = MappingProxyType({}),
    needed: Sequence[str] = (),
) -> Any:
    """Make a record from ``KEY=VALUE`` with its fields as keys, or raise OptionsError.

    Fields that are needed must be given although they have a default; ``form`` says in
    messages what was expected.
    """
    if kind not in kinds:
        raise OptionsError(
            f"there is no kind {kind!r}; there are: {', '.join(kinds)} "
            f"(expected {form})"
        )
    values, hidden = dict(values), (*values, *UNTYPED)
    known = {item.name: item for item in fields(kinds[kind]) if item.name not in hidden}
    # Those of all obstacles come last.
    known |= {key: known.pop(key) for key in ("position", "rotation") if key in known}
    for item in items:
        word, _, value = item.partition("=")
        key = FULL.get(word, word)
        if key not in known:
            keys = ", ".join(SHORT.get(key, key) for key in known)
            raise OptionsError(f"{item!r}: the keys of a {kind} are {keys}")
        if key in values:
            raise OptionsError(f"{SHORT.get(key, key)} is given twice")
        declared = field_type(kinds[kind], key)
        plain = getattr(declared, "__origin__", declared) in (str, "str")
        values[key] = value if plain else _entry(value, key)
    bare = [k for k, f in known.items() if f.default is f.default_factory is MISSING]
    lacking = [SHORT.get(k, k) for k in (*bare, *needed) if k not in values]
    if lacking:
        raise OptionsError(f"it lacks {' and '.join(lacking)}")
    return kinds[kind](**values)


def _entry(value: str, key: str) -> Any:
    """Read a number, a list of them, or, where numbers need not be, a word."""
    found = [number(word) for word in words(value)]
    count = COUNTS.get(key)
    if None in found and count is None:
        return value
    if None in found or count not in (None, len(found)):
        expected = "a number" if count == 1 else f"{count} numbers"
        raise OptionsError(f"{SHORT.get(key, key)} is {value!r}, expected {expected}")
    return found[0] if len(found) == 1 else found
