"""Locked joints and mimic joints: those that cannot move freely."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tominpmp.arrays import real_number
from tominpmp.description.tree import JointDescription, Mimic
from tominpmp.exceptions import (
    JointNotFound,
    OptionsError,
    RobotLoadError,
    brief,
    warn_caller,
)


@dataclass(frozen=True)
class Linkage:
    """How the joints of a description depend on those that remain free.

    Attributes:
        locked: Position of every joint that cannot move [rad or m].
        followers: Joints that follow a free joint; chains are resolved.
    """

    locked: Mapping[str, float]
    followers: Mapping[str, Mimic]

    @classmethod
    def resolve(
        cls, joints: Sequence[JointDescription], locked_joints: Mapping[str, float]
    ) -> Linkage:
        """Follow mimic joints to their leaders.

        A leader that is locked, or fixed (which counts as being at zero), locks those
        that follow it.

        Args:
            joints: All joints that can move.
            locked_joints: Positions of the joints to lock [rad or m].

        Raises:
            JointNotFound: If a joint to lock is not there.
            OptionsError: If a position is no finite number, or contradicts a leader.
            RobotLoadError: If mimic joints follow each other in a circle.
        """
        names = [joint.name for joint in joints]
        mimics = {joint.name: joint.mimic for joint in joints if joint.mimic}
        positions = _check_positions(names, locked_joints)
        locked = {k: v for k, v in positions.items() if k not in mimics}
        followers: dict[str, Mimic] = {}
        for name in mimics:
            mimic = _resolve_chain(name, mimics)
            if mimic.leader in names and mimic.leader not in locked:
                followers[name] = mimic
            else:
                at = locked.get(mimic.leader, 0.0)
                locked[name] = mimic.multiplier * at + mimic.offset
        for name, position in positions.items():
            if name in followers:
                raise OptionsError(
                    f"locked_joints: joint {name} follows {followers[name].leader}; "
                    "lock that one",
                    "locked_joints",
                )
            if not math.isclose(locked[name], position, rel_tol=1e-9, abs_tol=1e-9):
                raise OptionsError(
                    f"locked_joints: joint {name} got {position:g}, but it follows "
                    f"{mimics[name].leader}, which puts it at {locked[name]:g}",
                    "locked_joints",
                )
        return cls(locked, followers)

    def reasons(self) -> dict[str, str]:
        """Say of every joint that is not free why."""
        follows = {
            name: f"follows {mimic.leader}; set it there"
            for name, mimic in self.followers.items()
        }
        return {name: "is locked" for name in self.locked} | follows

    def warn_of_limits(self, joints: Sequence[JointDescription]) -> None:
        """Warn of joints that are locked outside their limits, beyond rounding."""
        for joint in joints:
            position = self.locked.get(joint.name)
            # Limits may be left out (NaN) or be nonsense where a joint is not to move.
            if position is None or not joint.lower < joint.upper:
                continue
            if not joint.lower - 1e-9 <= position <= joint.upper + 1e-9:
                warn_caller(
                    f"joint {joint.name} is locked at {position:g}, outside its "
                    f"limits [{joint.lower:g}, {joint.upper:g}]"
                )


def _check_positions(
    names: Sequence[str], locked_joints: Mapping[str, float]
) -> dict[str, float]:
    """Check that positions are numbers and belong to joints."""
    if not isinstance(locked_joints, Mapping):
        raise OptionsError(
            f"locked_joints: got {brief(locked_joints)}, expected positions by joint "
            "name",
            "locked_joints",
        )
    for name, position in locked_joints.items():
        if name not in names:
            raise JointNotFound(name, names)
        try:
            known = math.isfinite(real_number(position))
        except ValueError:
            known = False
        if not known:
            raise OptionsError(
                f"locked_joints: joint {name} got {brief(position)}, expected a finite "
                "number",
                "locked_joints",
            )
    return {name: float(position) for name, position in locked_joints.items()}


def _resolve_chain(name: str, mimics: Mapping[str, Mimic]) -> Mimic:
    """Express a mimic joint by the first joint of its chain, which follows none."""
    multiplier, offset, joint = 1.0, 0.0, name
    for _ in range(len(mimics) + 1):
        if joint not in mimics:
            return Mimic(joint, multiplier, offset)
        mimic = mimics[joint]
        offset += multiplier * mimic.offset
        multiplier *= mimic.multiplier
        joint = mimic.leader
    raise RobotLoadError(f"joint {name} follows itself: mimic joints form a circle")
