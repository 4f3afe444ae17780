"""Which joints a MoveIt motion plan request moves, and where it holds the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tominpmp.description.fields import Field
from tominpmp.description.groups import (
    JointGroup,
    rest_position,
    warn_of_group,
)
from tominpmp.description.srdf import SemanticDescription
from tominpmp.description.tree import JointDescription, UrdfDescription
from tominpmp.exceptions import brief, warn_caller

# A joint that follows may be this far from where its leader puts it [rad or m].
TOGETHER = 1e-9


def start_positions(request: Field) -> dict[str, float]:
    """Joint positions of the start state by name [rad or m].

    Raises:
        ScenarioError: If there are none, or a joint is there twice.
    """
    state = request.get("start_state").get("joint_state")
    return joint_values(state, "name", "position")


def joint_values(state: Field, names: str, values: str) -> dict[str, float]:
    """Values by joint name of a JointState.

    Raises:
        ScenarioError: If there are more or fewer values than names, or a name twice.
    """
    joints = [item.text() for item in state.need(names).items()]
    found = state.need(values)
    numbers = found.numbers()
    if len(numbers) != len(joints):
        found.fail(f"holds {len(numbers)} numbers for {len(joints)} joints")
    if len(set(joints)) != len(joints):
        twice = next(name for name in joints if joints.count(name) > 1)
        state.get(names).fail(f"the joint {brief(twice)} is there twice")
    return dict(zip(joints, numbers, strict=True))


def unmoved(request: Field, start: Mapping[str, float]) -> dict[str, float]:
    """Joints of the start state of which a goal of joint positions says nothing.

    Returns:
        Their positions [rad or m]; none for goals of other kinds.
    """
    moved = goal_joints(request)
    if not moved or goal_links(request):
        return {}  # any joint may move to bring a link to its place
    return {name: value for name, value in start.items() if name not in moved}


def goal_joints(request: Field) -> set[str]:
    """Joints that the goal names."""
    return {
        item.need("joint_name").text()
        for goal in request.get("goal_constraints").items()
        for item in goal.get("joint_constraints").items()
    }


def goal_links(request: Field) -> list[str]:
    """Links that the goal names."""
    found = [
        str(item.get("link_name").value)
        for goal in request.get("goal_constraints").items()
        for kind in ("position", "orientation")
        for item in goal.get(f"{kind}_constraints").items()
    ]
    return list(dict.fromkeys(found))


def group_locks(
    request: Field,
    start: Mapping[str, float],
    description: UrdfDescription,
    semantics: SemanticDescription | None,
) -> dict[str, float]:
    """Find the joints outside the group of a request, and where they are held.

    Where the SRDF file lacks the group, its joints are those that the goal names, or
    that carry the links that it names.

    Args:
        request: A message ``MotionPlanRequest``.
        start: Positions of its start state by joint [rad or m].
        description: The robot.
        semantics: Its SRDF file, if there is one.

    Returns:
        Positions by joint name [rad or m]: of the start state, else of a group state,
        else zero; empty if the request names no group.
    """
    name = request.get("group_name")
    if not name.given:
        return {}
    group = _group(name, semantics)
    moving = set(group.joints)
    if not moving:
        moving = goal_joints(request)
        for link in goal_links(request):
            moving |= description.joints_above(link)
    joints = description.joints
    outside = [j for j in joints if j.name not in moving and not j.mimic]
    if not group.joints and goal_links(request) and outside:
        _warn_of_unknown_group(name, semantics, [j.name for j in outside])
    states = {} if semantics is None else semantics.group_states
    lacking = [joint.name for joint in outside if joint.name not in start]
    if lacking:
        _warn(
            f"{request.path}: start_state says nothing about {', '.join(lacking)}, "
            "outside the group; held where the robot's SRDF file has them, else at 0"
        )
    return {j.name: start.get(j.name, rest_position(j, states)) for j in outside}


def followers(
    start: Mapping[str, float],
    joints: Sequence[JointDescription],
    locks: Mapping[str, float],
) -> dict[str, float]:
    """Positions of joints that follow locked ones, where the start state has them so.

    Others are left out with a warning: where they are follows from their leaders.
    """
    found = {}
    for joint in joints:
        mimic = joint.mimic
        if mimic is None or mimic.leader not in locks or joint.name not in start:
            continue
        there = mimic.multiplier * locks[mimic.leader] + mimic.offset
        if abs(there - start[joint.name]) <= TOGETHER:
            found[joint.name] = start[joint.name]
    return found


def warn_of_unknown_joints(
    state: Field, start: Mapping[str, float], known: Sequence[str]
) -> None:
    """Warn of joints of the start state that the robot lacks, as those of a gripper."""
    unknown = [name for name in start if name not in known]
    if unknown:
        shown = ", ".join(brief(name) for name in unknown[:20])
        _warn(
            f"{state.path}: {state.key}: the robot has no joints {shown}; what they "
            "move is not part of it"
        )


def _group(name: Field, semantics: SemanticDescription | None) -> JointGroup:
    """The group that is asked for; an empty one if it is not known."""
    groups = None if semantics is None else semantics.groups
    found = None if groups is None else groups.find(name.text())
    if groups is None or found is None:
        return JointGroup(())
    if groups.groups[found].joints:
        warn_of_group(found, groups.groups[found])
    return groups.groups[found]


def _warn_of_unknown_group(
    name: Field, semantics: SemanticDescription | None, held: Sequence[str]
) -> None:
    known = [] if semantics is None else list(semantics.groups.groups)
    _warn(
        f"{name.path}: {name.key}: the robot has no group {brief(name.text())} (it "
        f"has: {', '.join(known) or 'none'}); planned are the joints that carry the "
        f"links of the goal, and {', '.join(held)} are held"
    )


def _warn(message: str) -> None:
    warn_caller(message)
