"""Where the command line writes to, checked before anything takes long."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from tominpmp.cli.request import OutputRequest
from tominpmp.exceptions import MissingDependency, OptionsError, ScenarioError
from tominpmp.solution import Solution

if TYPE_CHECKING:
    from tominpmp.output.export_check import ExportCheck

DEFAULT_MOTION = "motion.csv"
STDOUT = "-"
MOTION_ENDINGS = (".csv", ".npz", ".yaml", ".yml", ".json", ".mcap")
SCENARIO_ENDINGS = (".toml",)
PLOT_ENDINGS = (".png", ".pdf", ".svg")
PAGE_ENDINGS = (".html", ".htm")


@dataclass(frozen=True)
class Targets:
    """Files to write.

    Attributes:
        motion: File for the motion; None for none or standard output.
        to_stdout: Whether the motion goes to standard output.
        dt: Time between its rows [s]; None for the period of the plan, or the nodes.
        plot: File for the plot.
        page: File for the page.
        certificate: File for the plot of the certificate.
        with_effort: Whether a ROS message has the torques.
        message: Which ROS message the motion is written as.
    """

    motion: Path | None
    to_stdout: bool
    dt: float | None
    plot: Path | None
    page: Path | None
    certificate: Path | None = None
    with_effort: bool = False
    message: str | None = None

    @classmethod
    def of(cls, request: OutputRequest) -> Targets:
        """Choose and check the files.

        Raises:
            OptionsError: If options contradict each other.
            ScenarioError: If a file cannot be written.
            MissingDependency: If a package for the plot or the page is missing.
        """
        to_stdout = request.write and request.motion == STDOUT
        if to_stdout and request.json:
            raise OptionsError(
                "--json and --output - both write to standard output", "output"
            )
        if request.motion is not None and not request.write:
            raise OptionsError("--output and --no-output contradict", "output")
        if request.dt is not None and not 0.0 < request.dt < float("inf"):
            raise OptionsError(
                f"--dt is {request.dt}, expected a positive time [s]", "dt"
            )
        motion = None
        if request.write and not to_stdout:
            motion = _free_name() if request.motion is None else Path(request.motion)
            check_target(motion, "--output", MOTION_ENDINGS)
            if motion.suffix.lower() == ".mcap":
                need_package("rosbags", "ros", "--output with .mcap")
        _check_message(request, motion)
        if request.scenario is not None:
            check_target(request.scenario, "--save-scenario", SCENARIO_ENDINGS)
        if request.plot is not None:
            check_target(request.plot, "--plot", PLOT_ENDINGS)
            need_package("matplotlib", "plots", "--plot")
        if request.page is not None:
            check_target(request.page, "--html", PAGE_ENDINGS)
            need_package("meshcat", "viz", "--html")
        if request.certificate is not None:
            check_target(request.certificate, "--certificate", PLOT_ENDINGS)
            need_package("matplotlib", "plots", "--certificate")
        return cls(
            motion,
            to_stdout,
            request.dt,
            request.plot,
            request.page,
            request.certificate,
            request.with_effort,
            request.message,
        )

    def write(self, solution: Solution) -> tuple[dict[str, str], ExportCheck | None]:
        """Write the files, and judge the motion as written.

        Returns:
            What was written, by what it holds; and what the file of the motion was
            found to do, None if there is none.
        """
        files: dict[str, str] = {}
        found = None
        if self.motion is not None:
            with self._rescued(solution, self.motion):
                found = self._export(solution, self.motion)
            files["motion"] = str(self.motion)
        if self.to_stdout:
            with self._rescued(solution, Path(DEFAULT_MOTION)):
                found = self._stream(solution)
        if self.plot is not None:
            solution.plot(self.plot)
            files["plot"] = str(self.plot)
        if self.page is not None:
            solution.play(self.page)
            files["page"] = str(self.page)
        if self.certificate is not None:
            solution.plot_certificate(self.certificate)
            files["certificate plot"] = str(self.certificate)
        return files, found

    @contextmanager
    def _rescued(self, solution: Solution, path: Path) -> Iterator[None]:
        """Where a motion cannot be written, keep it elsewhere, and say where.

        Raises:
            ScenarioError: If it cannot be written to its place.
        """
        try:
            yield
        except BrokenPipeError:
            raise  # whoever was to read it has gone
        except (ScenarioError, OSError) as error:
            reason = error.strerror if isinstance(error, OSError) else str(error)
            kept = self._kept(solution, path)
            where = "nowhere else either" if kept is None else f"kept in {kept}"
            raise ScenarioError(f"{reason}; the motion is {where}", path) from error

    def _kept(self, solution: Solution, path: Path) -> Path | None:
        """Write a motion to a folder that takes it; None if there is none."""
        tried = path.absolute().parent
        for folder in (Path.cwd(), Path(tempfile.gettempdir())):
            if folder == tried and self.motion is not None:
                continue
            try:
                place = Path(tempfile.mkdtemp(prefix="tominpmp-", dir=folder))
            except OSError:
                continue
            with suppress(ScenarioError, OSError):
                return solution.export(
                    place / path.name,
                    dt=self.dt,
                    with_effort=self.with_effort,
                    message=self.message,
                    verify=False,
                )
            with suppress(OSError):
                place.rmdir()
        return None

    def _export(self, solution: Solution, path: Path) -> ExportCheck:
        """Write the motion and judge the file."""
        from tominpmp.output.export_check import check_export

        solution.export(
            path,
            dt=self.dt,
            with_effort=self.with_effort,
            message=self.message,
            verify=False,
        )
        dt = solution.options.control_period if self.dt is None else self.dt
        return check_export(solution, path, dt=dt)

    def _stream(self, solution: Solution) -> ExportCheck:
        """Write the motion to standard output, as CSV."""
        with tempfile.TemporaryDirectory(prefix="tominpmp-") as folder:
            path = Path(folder) / DEFAULT_MOTION
            found = self._export(solution, path)
            with path.open(encoding="utf-8", newline="") as file:
                typer.echo(file.read(), nl=False)
        return replace(found, path=Path("standard output"))


def _free_name() -> Path:
    """Name for the motion in the current folder that no file has."""
    first = Path(DEFAULT_MOTION)
    if not os.path.lexists(first):
        return first
    names = (first.with_stem(f"{first.stem}-{i}") for i in count(2))
    return next(name for name in names if not os.path.lexists(name))


def check_target(path: Path, option: str, endings: Sequence[str]) -> None:
    """Check ending and folder of a file to write.

    Raises:
        ScenarioError: If it cannot be written.
    """
    if path.suffix.lower() not in endings:
        raise ScenarioError(
            f"{option}: {str(path)!r} must end in {' or '.join(endings)}", path
        )
    if not path.parent.is_dir():
        raise ScenarioError(f"{option}: there is no folder {str(path.parent)!r}", path)
    if path.is_dir():
        raise ScenarioError(f"{option}: {str(path)!r} is a folder", path)
    if not os.access(path.parent, os.W_OK):
        raise ScenarioError(
            f"{option}: the folder {str(path.parent)!r} cannot be written to", path
        )


def need_package(package: str, extra: str, purpose: str) -> None:
    """Check that an optional package is installed.

    Raises:
        MissingDependency: If it is not.
    """
    if find_spec(package) is None:
        raise MissingDependency(package, extra, purpose)


def _check_message(request: OutputRequest, motion: Path | None) -> None:
    """Check the options of ROS messages before anything takes long.

    Raises:
        ProblemError: If there is no such message.
        OptionsError: If nothing is written that they are about.
    """
    from tominpmp.output.export import check_options
    from tominpmp.output.ros import check_message

    if request.message is not None:
        check_message(request.message)
    if not request.with_effort and request.message is None:
        return
    if motion is None:
        raise OptionsError(
            "--with-effort and --ros-message are for files of ROS messages "
            "(--output FILE.yaml)",
            "output",
        )
    check_options(motion, request.with_effort, request.message)
