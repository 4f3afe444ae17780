"""Goals and joint positions of a scenario, as tables of a file."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.description.fields import Field
from tominpmp.exceptions import JointNotFound, ScenarioError, TominpmpError
from tominpmp.goals import Goal, JointGoal
from tominpmp.robot import Robot
from tominpmp.scenario.records import classes, from_table


def read_goal(table: Field, robot: Robot, before: Array | None) -> Goal:
    """Read a goal.

    Args:
        table: Its table: ``type`` and the fields of its class. That of a configuration
            may give the joints by name, or a ``state``.
        robot: The robot.
        before: Where the joints that are not named are, shape (n,) [rad or m]; None if
            that is not known.

    Raises:
        ScenarioError: If the table is wrong.
    """
    kinds = classes(Goal)
    if table.get("type").value != "joint":
        goal: Goal = from_table(table, kinds, "goal")
        return goal
    table.only("type", "q", "v", "state")
    q = positions(table, robot, before)
    v = table.get("v")
    try:
        return JointGoal(q, None if v.value is None else vector(v, robot))
    except TominpmpError as error:
        table.fail(str(error))


def positions(table: Field, robot: Robot, base: Array | None) -> Array:
    """Read positions of all joints: numbers, a group state, some by name, or both.

    Args:
        table: The table that has them as ``q``, ``state``, or both.
        robot: The robot.
        base: Positions of the joints that are not named, shape (n,); None if all have
            to be.

    Raises:
        ScenarioError: If the table is wrong.
    """
    state, q = table.get("state"), table.get("q")
    if not state.given and q.value is None:
        table.fail("says nothing of joint positions: expected q or state")
    if isinstance(q.value, str):
        state, q = q, Field(None, q.path, q.key)
    if state.given:
        if isinstance(q.value, list):
            q.fail("expected joints by name beside a state")
        base = _group_state(state, robot)
    if q.value is None:
        return np.array(base)
    return vector(q, robot, base)


def _group_state(state: Field, robot: Robot) -> Array:
    try:
        return robot.group_state(state.text())
    except ScenarioError:
        raise
    except TominpmpError as error:
        state.fail(str(error))


def vector(value: Field, robot: Robot, base: Array | None = None) -> Array:
    """Read values of all joints: numbers in joint order, or by name.

    Positions that are not named are those of the base, velocities are zero.

    Raises:
        ScenarioError: If there are too many or too few, or a joint is unknown.
    """
    if not isinstance(value.value, dict):
        numbers = value.numbers()
        if len(numbers) != robot.n:
            value.fail(
                f"holds {len(numbers)} numbers, expected {robot.n}, one for each of: "
                f"{', '.join(robot.joint_names)}"
            )
        return np.array(numbers)
    given = value.table()
    for name, item in given.items():
        if name not in robot.joint_names:
            item.fail(str(JointNotFound(name, robot.joint_names)))
    lacking = [name for name in robot.joint_names if name not in given]
    if lacking and base is None and value.key.endswith("q"):
        value.fail(f"says nothing about {', '.join(lacking)}")
    rest = np.zeros(robot.n) if base is None else base
    return np.array(
        [
            given[name].number() if name in given else rest[i]
            for i, name in enumerate(robot.joint_names)
        ]
    )
