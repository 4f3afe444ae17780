"""The command ``app``: a page on which motions are planned while one drags."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import typer

from tominpmp.app.choice import RobotChoice
from tominpmp.app.first_request import first_request, known
from tominpmp.app.page import Page, import_viser
from tominpmp.cli.options import AppOptions


def run_app(robot: str, args: AppOptions) -> None:
    """Serve the page until Ctrl-C.

    Args:
        robot: Name of a robot, or path of a URDF file.
        args: Where to serve it.

    Raises:
        TominpmpError: If the robot cannot be loaded, viser is not installed or the port
            is taken.
    """
    import_viser()
    path = Path(robot)
    choice = RobotChoice(str(path.resolve())) if path.is_file() else known(robot)
    page = Page(first_request(choice), args.host, args.port)
    typer.echo(f"page  {page.address}  (Ctrl-C ends it)")
    if not args.no_browser:
        webbrowser.open(page.address)
    page.wait()
