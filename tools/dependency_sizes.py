"""Installed sizes of the dependencies, alone and with their own dependencies.

Run it in an environment that has the package and its extras:

    python tools/dependency_sizes.py

Every distribution is counted once, with the first of the dependencies that needs it;
sizes are those of the files in its record, on the disk.
"""

from __future__ import annotations

import re
import sys
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "tominpmp"
MEGABYTE = 1e6


def plain(name: str) -> str:
    """Name of a distribution, normalised as in package indices."""
    return re.sub(r"[-_.]+", "-", name).lower()


def own_size(name: str) -> int:
    """Bytes of the files of a distribution; zero if it is not installed."""
    try:
        files = metadata.distribution(name).files or ()
    except metadata.PackageNotFoundError:
        return 0
    total = 0
    for file in files:
        path = Path(str(file.locate()))
        if path.is_file() and path.suffix != ".pyc":
            total += path.stat().st_size
    return total


def needs(name: str, extras: frozenset[str] = frozenset()) -> list[Requirement]:
    """Requirements of a distribution in this environment, with some of its extras."""
    try:
        texts = metadata.requires(name) or []
    except metadata.PackageNotFoundError:
        return []
    found = []
    for requirement in map(Requirement, texts):
        marker = requirement.marker
        worlds = [{"extra": extra} for extra in ("", *extras)]
        if marker is None or any(marker.evaluate(world) for world in worlds):
            found.append(requirement)
    return found


def closure(requirement: Requirement) -> set[str]:
    """A distribution and all its dependencies, by plain names."""
    seen: set[tuple[str, frozenset[str]]] = set()
    waiting = [(plain(requirement.name), frozenset(requirement.extras))]
    while waiting:
        name, extras = waiting.pop()
        if (name, extras) not in seen:
            seen.add((name, extras))
            waiting += [
                (plain(other.name), frozenset(other.extras))
                for other in needs(name, extras)
            ]
    return {name for name, _ in seen}


def requirements(extra: str = "") -> list[Requirement]:
    """Dependencies of the package, or those that one of its extras adds."""
    found = []
    for text in metadata.requires(PACKAGE) or []:
        requirement = Requirement(text)
        marker = requirement.marker
        own = marker is None or marker.evaluate({"extra": ""})
        wanted = own if not extra else not own and marker.evaluate({"extra": extra})
        if wanted:
            found.append(requirement)
    return found


def rows(extra: str, taken: set[str]) -> list[tuple[str, float, float]]:
    """Name, size and size with its own dependencies [MB], the largest first.

    Args:
        extra: Name of the extra; empty for the base.
        taken: Distributions counted before; those counted here are added.
    """
    closures = {plain(item.name): closure(item) for item in requirements(extra)}
    found = []
    for name, every in closures.items():
        others = set().union(*(v for k, v in closures.items() if k != name), taken)
        alone = (every - others) | ({name} - taken)
        sizes = own_size(name), sum(map(own_size, alone))
        found.append((name, sizes[0] / MEGABYTE, sizes[1] / MEGABYTE))
    taken |= set().union(*closures.values()) if closures else set()
    return sorted(found, key=lambda row: -row[2])


def total(names: set[str]) -> float:
    """Size of several distributions [MB]."""
    return sum(map(own_size, names)) / MEGABYTE


def main() -> int:
    """Print the tables."""
    taken: set[str] = set()
    extras = sorted(metadata.metadata(PACKAGE).get_all("Provides-Extra") or [])
    for extra in ("", *(e for e in extras if e != "all")):
        before = total(taken)
        found = rows(extra, taken)
        if not found:
            continue
        title = f"extra {extra}" if extra else "base"
        print(f"\n{title}: {total(taken) - before:.0f} MB")
        for name, own, alone in found:
            print(f"| {name} | {own:.1f} | {alone:.1f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
