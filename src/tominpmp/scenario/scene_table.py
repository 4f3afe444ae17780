"""What stands around a robot in a scenario, and what else holds, from tables."""

from __future__ import annotations

from tominpmp.constraints import PathConstraint
from tominpmp.description.fields import Field
from tominpmp.exceptions import TominpmpError
from tominpmp.scenario.records import classes, from_table
from tominpmp.scene import Obstacle, Scene


def read_scene(table: Field) -> Scene:
    """Read a scene from its table, whose key ``obstacles`` is a list of tables.

    Raises:
        ScenarioError: If the table is wrong.
    """
    if not table.given:
        return Scene()
    table.only("obstacles")
    kinds = classes(Obstacle)
    items = table.get("obstacles").items()
    obstacles = [from_table(item, kinds, "obstacle") for item in items]
    try:
        return Scene(obstacles)
    except TominpmpError as error:
        table.get("obstacles").fail(str(error))


def read_constraints(table: Field) -> tuple[PathConstraint, ...]:
    """Read a list of constraints; none if it is left out.

    Raises:
        ScenarioError: If one is wrong.
    """
    if not table.given:
        return ()
    kinds = classes(PathConstraint, "")
    return tuple(from_table(item, kinds, "constraint") for item in table.items())
