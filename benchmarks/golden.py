"""The golden set: comparison of two commits on problems of every kind.

    python -m benchmarks.golden --data DIR --csv before.csv
    python -m benchmarks.golden --data DIR --csv after.csv       # in the other tree
    python -m benchmarks.golden compare before.csv after.csv --t-median 0.0005 \
        --t-max 0.005 --programs 1.05
    python -m benchmarks.golden --part fresh --seed 20261125 --data DIR --csv fresh.csv
    python -m benchmarks.golden list

The part ``tuned`` always has the same problems (``golden_cases.py``), ``fresh`` has
problems not used for tuning, most of them drawn from ``--seed`` (take another seed
for each comparison, and the same for both commits; ``golden_fresh.py``). Each problem
has a separate process with one thread. A row has the status, T, the gain predicted by
the certificate, the largest excess and the least clearance by a judge that shares no
code with the library's verification (``golden_judge.py``), programs, iterations and
processor time. Rows are written as they come; a second run with the same file plans
only missing problems, unless the library has another revision. Groups without their
data are left out, with a line.

``compare`` prints a table by groups and exits with 1 if the second run exceeds the
given limits. Lost motions count, unless ``--lost`` permits a number of them,
and so do missing or changed problems (with different fingerprints),
unless ``--changed`` permits them; these are named and not compared.

NOISE
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import one_thread

one_thread()

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.golden_compare import Allowed, Comparison
from benchmarks.golden_runner import (
    BASE,
    PARTS,
    Row,
    Rows,
    groups_of,
    items,
    read_rows,
    revision,
    run,
)

VARIABLE = "MOTIONBENCHMAKER"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, compare or list; 1 if a comparison is beyond its limits."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words and words[0] == "compare":
        return _compare(words[1:])
    if words and words[0] == "list":
        return _list(words[1:])
    return _run(words[1:] if words and words[0] == "run" else words)


def _run(words: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.golden",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_problems(parser)
    parser.add_argument("--csv", type=Path, default=Path("out/golden.csv"))
    parser.add_argument("--jobs", type=int, default=1, help="processes at once")
    parser.add_argument(
        "--limit", type=float, default=300.0, help="processor time of a problem [s]"
    )
    parser.add_argument(
        "--no-judge", action="store_true", help="leave motions unjudged"
    )
    given = parser.parse_args(words)
    check(parser, given)
    version = revision()
    rows = Rows(given.csv, version)
    chosen = list(items(given.part, given.groups, given.data, given.seed, given.every))
    print(f"{len(chosen)} problems, {version}", file=sys.stderr)
    judged = not given.no_judge
    how = {"jobs": given.jobs, "limit": given.limit, "judged": judged}
    try:
        run(chosen, rows, version, show=show, **how)
    except KeyboardInterrupt:
        print(f"interrupted; {given.csv} has the results so far", file=sys.stderr)
        return 130
    return 0


def add_problems(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose problems."""
    place = os.environ.get(VARIABLE)
    parser.add_argument("--part", choices=PARTS, default=PARTS[0])
    parser.add_argument("--seed", type=int, default=0, help="of the fresh part")
    parser.add_argument(
        "--groups", type=lambda text: text.split(","), help="A,B; all by default"
    )
    parser.add_argument(
        "--every",
        type=int,
        default=1,
        help="only the first of this many problems of each group",
    )
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(place) if place else None,
        help=f"folder of MotionBenchMaker, by default ${VARIABLE}",
    )


def check(parser: argparse.ArgumentParser, given: argparse.Namespace) -> None:
    """Check the groups, and print those without data."""
    from benchmarks import golden_cases, golden_fresh

    known = groups_of(given.part)
    unknown = sorted(set(given.groups or ()) - set(known))
    if unknown:
        parser.error(f"no group {unknown[0]!r}; there are {', '.join(known)}")
    module = golden_cases if given.part == PARTS[0] else golden_fresh
    source = golden_cases.Source(given.data)
    for group, robot in module.WITH_DATA.items():
        wanted = given.groups is None or group in given.groups
        if wanted and source.folder(robot) is None:
            print(f"{group}: left out, --data has no {robot} scenes", file=sys.stderr)


def show(row: Row) -> None:
    """Print a row."""
    parts = [f"{row['group']}: {row['name']}", row.get("status", "")]
    if row.get("T"):
        parts.append(f"T {float(row['T']):.5f} s")
    if row.get("seconds"):
        parts.append(f"{float(row['seconds']):.2f} s, {row['programs']} programs")
    if row.get("faults"):
        parts.append(f"REFUTED: {row['faults']}")
    if row["variant"]:
        parts.insert(0, row["variant"])
    print(" | ".join(parts), flush=True)


def _compare(words: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.golden compare")
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    for name, text in (
        ("t-median", "median of the ratio of T, minus one"),
        ("t-max", "the largest of them"),
        ("t-group", "the largest median of a group"),
        ("objective-max", "like --t-max, for objectives other than T"),
        ("programs", "ratio of the sums of programs"),
        ("programs-95", "what 95 %% do not pass over the same"),
        ("seconds", "sum of processor time over the same"),
        ("seconds-95", "what 95 %% do not pass over the same"),
        ("promise", "rise of the gain predicted by a certificate, as a share of T"),
    ):
        parser.add_argument(f"--{name}", type=float, help=f"most: {text}")
    parser.add_argument("--lost", type=int, default=0, help="most motions lost")
    parser.add_argument(
        "--changed",
        type=int,
        default=0,
        help="largest number of missing or changed problems",
    )
    parser.add_argument("--largest", type=int, default=10, help="changes of T named")
    given = parser.parse_args(words)
    for path in (given.before, given.after):
        if not path.exists():
            parser.error(f"there is no file {path}")
    comparison = Comparison(named(given.before), named(given.after))
    print(comparison.report(given.largest))
    limits = {k: v for k, v in vars(given).items() if k in Allowed.__annotations__}
    beyond = comparison.beyond(Allowed(**limits))
    for line in beyond:
        print(f"BEYOND ITS LIMIT: {line}")
    return int(bool(beyond))


def named(path: Path, variant: str = BASE) -> dict[tuple[str, str], Row]:
    """Rows of a file by group and name."""
    return {
        (row["group"], row["name"]): row
        for row in read_rows(path).values()
        if row["variant"] == variant
    }


def _list(words: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.golden list")
    add_problems(parser)
    given = parser.parse_args(words)
    check(parser, given)
    for item in items(given.part, given.groups, given.data, given.seed, given.every):
        print(f"{item.group}: {item.name}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
