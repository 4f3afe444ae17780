"""What goes to other processes, with the robots aside.

Thousands of problems share a few robots. A robot is pickled once and told by a digest
of that; a process that has it already neither unpickles it nor reads its meshes again.
Nothing that depends on a problem is kept with it.
"""

from __future__ import annotations

import hashlib
import io
import pickle
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

from tominpmp.robot import Robot

# Robots that a process keeps.
MOST_ROBOTS = 16


@dataclass(frozen=True)
class Packed:
    """An object, pickled.

    Attributes:
        content: The object without the robots in it.
        robots: These, pickled, by their digests.
    """

    content: bytes
    robots: dict[str, bytes]


class Robots:
    """The robots that this process knows, by their digests, both ways."""

    def __init__(self) -> None:
        self._by_digest: OrderedDict[str, tuple[Robot, bytes]] = OrderedDict()
        self._digest_of: dict[int, str] = {}

    def digest(self, robot: Robot) -> str:
        """The digest of a robot, which is known from now on."""
        found = self._digest_of.get(id(robot))
        if found is not None:
            return found
        content = pickle.dumps(robot, protocol=pickle.HIGHEST_PROTOCOL)
        digest = hashlib.sha256(content).hexdigest()
        self._keep(digest, robot, content)
        return digest

    def pickled(self, digest: str) -> bytes:
        """A robot that is known, pickled."""
        return self._by_digest[digest][1]

    def of(self, digest: str, content: bytes) -> Robot:
        """The robot of a digest, unpickled if it is not known."""
        if digest not in self._by_digest:
            self._keep(digest, pickle.loads(content), content)
        self._by_digest.move_to_end(digest)
        return self._by_digest[digest][0]

    def _keep(self, digest: str, robot: Robot, content: bytes) -> None:
        self._by_digest[digest] = robot, content
        # It is kept, so that its number stays its own.
        self._digest_of[id(robot)] = digest
        while len(self._by_digest) > MOST_ROBOTS:
            _, (old, _) = self._by_digest.popitem(last=False)
            self._digest_of.pop(id(old), None)


class _Pickler(pickle.Pickler):
    def __init__(self, file: io.BytesIO, robots: Robots) -> None:
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._robots = robots
        self.used: dict[str, bytes] = {}

    def persistent_id(self, item: Any) -> str | None:
        """The digest of a robot; nothing of anything else."""
        if not isinstance(item, Robot):
            return None
        digest = self._robots.digest(item)
        self.used[digest] = self._robots.pickled(digest)
        return digest


class _Unpickler(pickle.Unpickler):
    def __init__(self, packed: Packed, robots: Robots) -> None:
        super().__init__(io.BytesIO(packed.content))
        self._packed, self._robots = packed, robots

    def persistent_load(self, digest: str) -> Robot:
        """The robot of a digest."""
        return self._robots.of(digest, self._packed.robots[digest])


def pack(item: Any, robots: Robots) -> Packed:
    """Pickle an object.

    Raises:
        Exception: If there is something in it that cannot be pickled.
    """
    file = io.BytesIO()
    pickler = _Pickler(file, robots)
    pickler.dump(item)
    return Packed(file.getvalue(), pickler.used)


def unpack(packed: Packed, robots: Robots) -> Any:
    """The object again."""
    return _Unpickler(packed, robots).load()
