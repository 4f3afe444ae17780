"""Output files of the command line, checked before the long computations."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from itertools import chain, count
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tominpmp.cli.options import PlanOptions
from tominpmp.cli.terminal import OUTPUT, say
from tominpmp.description.paths import why_unwritable
from tominpmp.exceptions import (
    MissingDependency,
    OptionsError,
    ProblemError,
    ScenarioError,
)
from tominpmp.files.export import FORMATS, check_options
from tominpmp.files.ros import MIN_STEP
from tominpmp.motion.samples import BILLION
from tominpmp.solution import Solution

if TYPE_CHECKING:
    from tominpmp.files.export_check import ExportCheck

DEFAULT_MOTION = "motion.csv"
STDOUT = "-"
MOTION_ENDINGS = tuple(FORMATS)
PLOT_ENDINGS = (".png", ".pdf", ".svg")
PAGE_ENDINGS = (".html", ".htm")
# Options that name a further file: its label in reports, its allowed endings, and the
# method of a solution that writes it.
FILES = {
    "plot": ("plot", PLOT_ENDINGS, "plot"),
    "html": ("page", PAGE_ENDINGS, "play"),
    "certificate": ("certificate plot", PLOT_ENDINGS, "plot_certificate"),
    "sensitivities": ("sensitivities plot", PLOT_ENDINGS, "sensitivities.plot"),
}


def motion_file(options: PlanOptions) -> Path | None:
    """Choose the file for the motion, and check all files to write.

    Returns:
        The file; None for no file or standard output.

    Raises:
        OptionsError: If options contradict each other, or the period of the rows is
            infinite, or less than the least one of messages.
        ProblemError: If the ROS message is unknown or does not suit the file.
        ScenarioError: If a file cannot be written.
        MissingDependency: If a package for a plot or a bag is missing.
    """
    name = options.output
    if name == STDOUT and options.json:
        raise OptionsError(
            "--json and --output - both write to standard output", "output"
        )
    if name is not None and options.no_output:
        raise OptionsError("--output and --no-output contradict", "output")
    least, dt = MIN_STEP / BILLION, options.dt
    if dt is not None and not least <= dt < float("inf"):
        raise OptionsError(
            f"--dt is {dt}, expected a positive time, {least:g} s at least", "dt"
        )
    motion = None
    if not options.no_output and name != STDOUT:
        motion = _free_name() if name is None else Path(name)
    check_target(motion, "--output", MOTION_ENDINGS)
    target = motion or (OUTPUT if name == STDOUT else "--no-output")
    check_options(target, options.with_effort, options.ros_message)
    check_target(options.save_scenario, "--save-scenario", (".toml",))
    paths = [getattr(options, field) for field in FILES]
    for path, (field, (_, endings, _)) in zip(paths, FILES.items(), strict=True):
        check_target(path, f"--{field}", endings)
        if path is not None and paths.count(path) > 1:
            raise OptionsError(f"two options write {str(path)!r}", field)
    return motion


def write_files(
    solution: Solution, options: PlanOptions, motion: Path | None, drawn: Any = None
) -> tuple[dict[str, str], ExportCheck | None]:
    """Write the files of a plan, and judge the motion as it was written.

    Args:
        solution: The plan.
        options: The options of the command.
        motion: File for the motion, from :func:`motion_file`.
        drawn: The object whose methods draw the plots; None for the solution.

    Returns:
        Paths of the files by their labels; and the judgement of the motion as written,
        None if it was not to be written.

    Raises:
        ScenarioError: If the motion cannot be written, with the place where it was
            saved instead.
        OSError: If standard output cannot be written, with that place, too.
    """
    judgement = None
    if motion is not None and options.output is None:
        motion = _free_name()  # another process may have used the name since
    written = {} if motion is None else {"motion": str(motion)}
    try:
        if motion is not None:
            judgement = _export(solution, options, motion)
        elif options.output == STDOUT:
            judgement = _stream(solution, options)
    except BrokenPipeError:
        raise  # the reader of the pipe has ended, so the motion is not wanted
    except (ScenarioError, ProblemError, OSError) as error:
        if isinstance(error, ProblemError):
            options = replace(options, dt=None)  # dt gives too many rows
        saved = _saved(solution, options, motion)
        where = "not saved elsewhere" if saved is None else f"kept in {saved}"
        if isinstance(error, OSError):
            reason = f"{error.strerror}; the motion is {where}"
            raise OSError(error.errno, reason, error.filename) from error
        path = motion or DEFAULT_MOTION
        raise ScenarioError(f"{error}; the motion is {where}", path) from error
    for field, (kind, _, method) in FILES.items():
        path = getattr(options, field)
        if path is not None:
            attrgetter(method)(drawn or solution)(path)
            written[kind] = str(path)
    return written, judgement


def _export(solution: Solution, options: PlanOptions, path: Path) -> ExportCheck:
    """Write the motion to a file, and judge the file."""
    from tominpmp.files.export_check import check_export

    _write_motion(solution, options, path)
    return check_export(solution, path, dt=options.dt)


def _write_motion(solution: Solution, options: PlanOptions, path: Path) -> Path:
    return solution.export(
        path,
        dt=options.dt,
        with_effort=options.with_effort,
        message=options.ros_message,
        verify=False,
    )


def _stream(solution: Solution, options: PlanOptions) -> ExportCheck:
    """Write the motion to standard output, as CSV."""
    with tempfile.TemporaryDirectory(prefix="tominpmp-") as folder:
        path = Path(folder) / DEFAULT_MOTION
        judgement = _export(solution, options, path)
        say(path.read_text(encoding="utf-8"), end="")
    return replace(judgement, path=Path(OUTPUT))


def _saved(
    solution: Solution, options: PlanOptions, motion: Path | None
) -> Path | None:
    """Write the motion to another folder; None if no folder is writable."""
    name = DEFAULT_MOTION if motion is None else motion.name
    for folder in (Path.cwd(), Path(tempfile.gettempdir())):
        if motion is not None and folder == motion.absolute().parent:
            continue
        with suppress(ScenarioError, OSError):
            place = Path(tempfile.mkdtemp(prefix="tominpmp-", dir=folder))
            try:
                return _write_motion(solution, options, place / name)
            except (ScenarioError, OSError):
                place.rmdir()
    return None


def _free_name() -> Path:
    """Unused file name for the motion in the current folder."""
    first = Path(DEFAULT_MOTION)
    names = chain([first], (first.with_stem(f"{first.stem}-{i}") for i in count(2)))
    return next(name for name in names if not os.path.lexists(name))


def check_target(path: Path | None, option: str, endings: Sequence[str]) -> None:
    """Check ending, folder and required package of a file to write; None passes.

    Raises:
        ScenarioError: If the file cannot be written.
        MissingDependency: If a package that writes the file is not installed.
    """
    if path is None:
        return
    ending, reason = path.suffix.lower(), why_unwritable(path)
    if ending not in endings:
        reason = f"{str(path)!r} must end in {' or '.join(endings)}"
    if reason:
        raise ScenarioError(f"{option}: {reason}", path)
    if ending == ".mcap" and find_spec("rosbags") is None:
        raise MissingDependency("rosbags", "ros", f"{option} with .mcap")
    if endings == PLOT_ENDINGS and find_spec("matplotlib") is None:
        raise MissingDependency("matplotlib", "plots", option)
