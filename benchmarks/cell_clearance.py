"""Exact distances in a cell: arms, their loads, and obstacles that may move."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from benchmarks.cell_arms import Member, configuration
from benchmarks.exact_geometry import Array, Body, Surroundings

# Links that overlap at more than this share of random configurations may always touch.
MOSTLY = 0.3
SAMPLES = 30


class Cell(Surroundings):
    """Clearance beyond the margin between arms, within arms and to obstacles."""

    def __init__(
        self,
        members: Sequence[Member],
        obstacles: Sequence[tuple[Body, Array]],
        margin: float,
    ) -> None:
        self.members = members
        self._velocities = [velocity for _, velocity in obstacles]
        self._owner: list[int] = []
        bodies: list[Body] = []
        for number, member in enumerate(members):
            for body in member.arm.links:
                bodies.append(body)
                self._owner.append(number)
        for body, _ in obstacles:
            bodies.append(body)
            self._owner.append(-1)
        self._bodies = bodies
        self._scratch = [member.arm.model.createData() for member in members]
        self._times = np.zeros(0)
        self._always = [self._always_touching(k) for k in range(len(members))]
        self._pairs = [
            (i, j)
            for i, j in itertools.combinations(range(len(bodies)), 2)
            if self._matters(i, j)
        ]
        self._margins = np.array(
            [margin * (self._owner[i] != self._owner[j]) for i, j in self._pairs]
        )
        self._measure_boxes()

    def _distance(self, pair: int, rotation: Array, position: Array) -> float:
        """Distance minus the margin, which does not apply to links of the same arm."""
        return super()._distance(pair, rotation, position) - self._margins[pair]

    def _lower_bounds(self, rotations: Array, positions: Array) -> Array:
        return super()._lower_bounds(rotations, positions) - self._margins

    def _measure_boxes(self) -> None:
        boxes = []
        for body in self._bodies:
            body.shape.computeLocalAABB()
            box = body.shape.aabb_local
            boxes.append((np.array(box.min_), np.array(box.max_)))
        self._centres = np.array([0.5 * (low + high) for low, high in boxes])
        self._halves = np.array([0.5 * (high - low) for low, high in boxes])
        self._radii = np.linalg.norm(self._halves, axis=1)
        self._first, self._second = np.array(self._pairs, dtype=int).reshape(-1, 2).T
        self._signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))

    def _matters(self, i: int, j: int) -> bool:
        one, other = self._bodies[i], self._bodies[j]
        a, b = self._owner[i], self._owner[j]
        if a == b == -1:
            return False
        if a != b:
            # Fixed obstacles do not move.
            fixed = [
                owner != -1 and body.joint == 0
                for owner, body in ((a, one), (b, other))
            ]
            return not (all(fixed) or (any(fixed) and -1 in (a, b)))
        if one.joint == other.joint:
            return False
        names = frozenset((one.name, other.name))
        return names not in self._always[a]

    def _always_touching(self, number: int) -> frozenset[frozenset[str]]:
        """Pairs that may touch: by the SRDF, neighbours, mostly overlapping links."""
        arm = self.members[number].arm
        allowed = set(arm.disabled)
        if not any("payload" not in names for names in arm.disabled):
            allowed |= self._neighbours(number)
        low, high = np.clip(self.members[number].position_limits(), -np.pi, np.pi)
        rng = np.random.default_rng(1)
        pairs = [
            (one, other)
            for one, other in itertools.combinations(arm.links, 2)
            if one.joint != other.joint
            and frozenset((one.name, other.name)) not in allowed
        ]
        counts = np.zeros(len(pairs))
        for q in rng.uniform(low, high, (SAMPLES, arm.model.nv)):
            place = configuration(arm.model, q)
            pin.forwardKinematics(arm.model, self._scratch[number], place)
            counts += [self._touch(number, *pair) for pair in pairs]
        for count, (one, other) in zip(counts, pairs, strict=True):
            if count > MOSTLY * SAMPLES:
                allowed.add(frozenset((one.name, other.name)))
        return frozenset(allowed)

    def _neighbours(self, number: int) -> set[frozenset[str]]:
        """Pairs of links between which there is no other link with a shape."""
        arm, found = self.members[number].arm, set()
        carriers = {body.joint for body in arm.links}
        for low, high in itertools.permutations(arm.links, 2):
            parent = int(arm.model.parents[high.joint]) if high.joint else -1
            while parent > 0 and parent not in carriers:
                parent = int(arm.model.parents[parent])
            if parent == low.joint:
                found.add(frozenset((low.name, high.name)))
        return found

    def _touch(self, number: int, one: Body, other: Body) -> bool:
        data = self._scratch[number]
        places = []
        for body in (one, other):
            place = data.oMi[body.joint] * body.placement
            places.append(coal.Transform3s(place.rotation, place.translation))
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        found = coal.collide(
            one.shape, places[0], other.shape, places[1], request, result
        )
        return bool(found)

    def at(self, times: Array) -> Cell:
        """Set the times of the configurations of the next query."""
        self._times = times
        return self

    def _place(self, q: Array) -> tuple[Array, Array]:
        rotations = np.empty((len(q), len(self._bodies), 3, 3))
        positions = np.empty((len(q), len(self._bodies), 3))
        for k, row in enumerate(q):
            begin = 0
            for member, data in zip(self.members, self._scratch, strict=True):
                part = row[begin : begin + member.n]
                pin.forwardKinematics(
                    member.arm.model, data, member.configuration(part)
                )
                begin += member.n
            moved = 0
            for b, (body, owner) in enumerate(
                zip(self._bodies, self._owner, strict=True)
            ):
                if owner < 0:
                    velocity = self._velocities[moved]
                    moved += 1
                    rotations[k, b] = body.placement.rotation
                    positions[k, b] = (
                        body.placement.translation + velocity * self._times[k]
                    )
                    continue
                place = self.members[owner].base * (
                    self._scratch[owner].oMi[body.joint] * body.placement
                )
                rotations[k, b], positions[k, b] = place.rotation, place.translation
        return rotations, positions


def read_obstacle(item: Mapping[str, Any]) -> tuple[Body, Array]:
    """Shape and velocity of an obstacle."""
    sizes = item["size"]
    shape = {
        "sphere": lambda: coal.Sphere(sizes[0]),
        "box": lambda: coal.Box(*sizes),
        "cylinder": lambda: coal.Cylinder(sizes[0], sizes[1]),
        "capsule": lambda: coal.Capsule(sizes[0], sizes[1]),
    }[item["shape"]]()
    x, y, z, w = item["rotation"]
    turn = pin.Quaternion(w, x, y, z).normalized().toRotationMatrix()
    place = pin.SE3(turn, np.array(item["position"], dtype=float))
    return Body(item["name"], 0, shape, place), np.array(item["velocity"], dtype=float)
