"""The command ``app``: a page that plans a motion while its goal is dragged."""

from __future__ import annotations

import webbrowser
from pathlib import Path

from tominpmp.cli.commands import Source
from tominpmp.cli.option_fields import GeneralOptions, options
from tominpmp.cli.terminal import say


@options("Page")
class AppOptions(GeneralOptions):
    """Address and robot of the live page.

    Attributes:
        port (N): Port to serve the page at.
        host (ADDRESS): Address to serve it at; 0.0.0.0 lets others on the network open
            it.
        no_browser: Do not open the page in the browser.
        kinematic: Leave out torques, so that the robot's file needs no inertias and no
            torque limits.
    """

    port: int = 8080
    host: str = "127.0.0.1"
    no_browser: bool = False
    kinematic: bool = False


def app(robot: Source = "panda", /, *, args: AppOptions = AppOptions()) -> None:
    """Open a page on which a motion is planned while its goal is dragged.

    Start, goal, via points and obstacles have handles, limits have sliders; the page
    shows the duration, its distance from the lower bound, and the active limits, and
    exports the motion as a file and the problem as lines of Python.

    Args:
        robot: Name of a robot (tominpmp robots lists them) or path of a URDF file.
        args: Options of the command.
    """
    from tominpmp.app.first_request import first_request, known
    from tominpmp.app.page import Page

    path = Path(robot)
    source = str(path.resolve()) if path.is_file() else robot
    choice = known(source, kinematic=args.kinematic)
    page = Page(first_request(choice), args.host, args.port)
    say(f"page  {page.address}  (Ctrl-C ends it)")
    if not args.no_browser:
        webbrowser.open(page.address)
    page.wait()
