"""The planner with one stage or mechanism switched off at a time, on the golden set.

    python -m benchmarks.ablation --data DIR
    python -m benchmarks.ablation --data DIR --every 3 --variants "no certificate;quick"
    python -m benchmarks.ablation --table out/ablation.csv

Each problem is planned with the unchanged planner and with every variant, in separate
processes (see ``golden.py``, whose options choose problems). A variant consists of
options, and of replacements for parts of the planner; a change of the planner may
require a change of the table :data:`VARIANTS`. The printed table has the ratios of T
and of the number of programs to the unchanged planner, for each group of problems.
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import markdown, one_thread

one_thread()

import argparse
import dataclasses
import statistics
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest import mock

from benchmarks.golden_runner import BASE, Row, Rows, items, read_rows, revision, run
from tominpmp.planner.improvements import IMPROVEMENTS

if TYPE_CHECKING:
    from benchmarks.golden_problems import Task

# Groups of the golden set that show the purpose of a mechanism.
GROUPS = ("goals", "goals x 4", "clutter", "obstacles", "moving", "segments", "rules")
PLANNER, SOLVERS = "tominpmp.planner", "tominpmp.solvers"
FUNCTIONS = "tominpmp.transcription.problem_functions.ProblemFunctions"


@dataclass(frozen=True)
class Variant:
    """Differences of a variant from the unchanged planner.

    Attributes:
        options: Options of the plan.
        parts: Replacements for parts of the planner, by their dotted names.
    """

    options: Mapping[str, Any] = field(default_factory=dict)
    parts: Mapping[str, Any] = field(default_factory=dict)

    def __or__(self, other: Variant) -> Variant:
        """The combination of two variants."""
        options = {**self.options, **other.options}
        return Variant(options, {**self.parts, **other.parts})


def _nothing(*_: Any, **__: Any) -> Iterator[Any]:
    """A stage without work."""
    return iter(())


def _false(*_: Any, **__: Any) -> bool:
    return False


def _none(*_: Any, **__: Any) -> None:
    return None


def _without(*names: str) -> Variant:
    """The planner without the named improvements of the incumbent."""
    left = {name: one for name, one in IMPROVEMENTS.items() if name not in names}
    return Variant(parts={f"{PLANNER}.improvements.IMPROVEMENTS": left})


UNREFINED = Variant({"refine": None})
NEITHER = UNREFINED | _without("certificate")
COARSE = Variant(parts={f"{PLANNER}.starts.coarse_grids_apply": _false})
QUICK = Variant({"effort": "quick"})
ONCE = Variant({"effort": "quick", "refine": None}) | COARSE
CONSTANT = Variant({"control": "constant"})
VARIANTS: dict[str, Variant] = {
    **{f"no {name}": _without(name) for name in IMPROVEMENTS},
    "no finer grid": UNREFINED,
    "no finer grid and no certificate": NEITHER,
    "no coarse grids": COARSE,
    "constant accelerations": CONSTANT,
    "no proximal term": Variant(parts={f"{SOLVERS}.objective.PROXIMAL": 0.0}),
    "no weight of jumps": Variant({"smoothing": 0.0}),
    "rows of links at once": Variant(
        parts={
            f"{FUNCTIONS}.without_self_collision": property(lambda self: self),
        }
    ),
    "no curvature": Variant(
        parts={"tominpmp.linear_programs.piqp.PiqpSolver.curved": False}
    ),
    "no correction": Variant(parts={f"{SOLVERS}.trust_region_step.CORRECTIONS": 0}),
    "starts not judged": Variant(
        parts={f"{PLANNER}.coarse_search.CoarseSearch._drop_early": lambda _: _none}
    ),
    "no exchange of rows": Variant(
        parts={f"{SOLVERS}.exchange.RowExchange.due": _false}
    ),
    "no torque starts": Variant(
        parts={f"{PLANNER}.coarse_search.torque_starts": _nothing}
    ),
    "quick": QUICK,
    "quick, no finer grid and no certificate": QUICK | NEITHER,
    "one descent": ONCE | NEITHER,
    "one descent, certified": ONCE,
    "one descent, constant accelerations": ONCE | CONSTANT | NEITHER,
}


@contextmanager
def switched(name: str, task: Task) -> Iterator[Task]:
    """The task with the options of a variant, while parts of the planner are replaced.

    Args:
        name: Name of the variant; empty for the unchanged planner.
        task: The task.
    """
    if name == BASE:
        yield task
        return
    variant = VARIANTS[name]
    with ExitStack() as stack:
        for part, value in variant.parts.items():
            stack.enter_context(mock.patch(part, value))
        options = {**task.options, **variant.options}
        yield dataclasses.replace(task, options=options)


def table(rows: Sequence[Row]) -> str:
    """T and programs of each variant relative to the unchanged planner, in Markdown.

    Args:
        rows: Rows of all variants.
    """
    known: dict[str, dict[tuple[str, str], Row]] = {}
    for row in rows:
        known.setdefault(row["variant"], {})[row["group"], row["name"]] = row
    base = known.get(BASE, {})
    groups = list(dict.fromkeys(group for group, _ in base))
    lines = []
    for variant in [name for name in VARIANTS if name in known]:
        cells = [variant]
        for group in [*groups, "all"]:
            names = [n for n in base if group in (n[0], "all") and n in known[variant]]
            cells.append(_cell(base, known[variant], names))
        lines.append(cells)
    return markdown(("off", *groups, "all"), lines)


def _cell(
    base: Mapping[tuple[str, str], Row],
    other: Mapping[tuple[str, str], Row],
    names: Sequence[tuple[str, str]],
) -> str:
    """T: mean (largest) in per cent / programs, and the number of lost motions."""
    good = [n for n in names if base[n]["success"] == "True"]
    both = [n for n in good if other[n]["success"] == "True"]
    if not both:
        return "-"
    T = [float(other[n]["T"]) / float(base[n]["T"]) - 1.0 for n in both]
    programs = [sum(int(rows[n]["programs"]) for n in both) for rows in (base, other)]
    share = programs[1] / max(programs[0], 1)
    mean, most = 100.0 * statistics.fmean(T), 100.0 * max(T)
    lost = f", {len(good) - len(both)} lost" if len(both) < len(good) else ""
    return f"{mean:+.2f} ({most:.1f}) / {share:.2f}{lost}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the missing problems and print the table."""
    from benchmarks.golden import add_problems, check, show

    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ablation",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_problems(parser)
    parser.add_argument(
        "--variants", help="names, separated by semicolons; all by default"
    )
    parser.add_argument("--csv", type=Path, default=Path("out/ablation.csv"))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument(
        "--limit", type=float, default=300.0, help="processor time of a problem [s]"
    )
    parser.add_argument("--table", type=Path, help="print the table of this file only")
    given = parser.parse_args(arguments)
    if given.table is not None:
        print(table(list(read_rows(given.table).values())))
        return 0
    if given.groups is None and given.part == "tuned":
        given.groups = list(GROUPS)
    check(parser, given)
    names = list(VARIANTS) if given.variants is None else given.variants.split(";")
    for name in names:
        if name not in VARIANTS:
            parser.error(f"no variant {name!r}; there are {'; '.join(VARIANTS)}")
    version = revision()
    rows = Rows(given.csv, version)
    chosen = list(items(given.part, given.groups, given.data, given.seed, given.every))
    # Variant by variant, so that an interrupted run has complete variants.
    wanted = [
        dataclasses.replace(item, variant=name)
        for name in (BASE, *names)
        for item in chosen
    ]
    try:
        run(
            wanted,
            rows,
            version,
            jobs=given.jobs,
            limit=given.limit,
            judged=False,
            show=show,
        )
    except KeyboardInterrupt:
        print(f"interrupted; {given.csv} has the results so far")
    print(table(list(rows.rows.values())))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
