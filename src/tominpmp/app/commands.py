"""The command ``app``: a page on which motions are planned while one drags."""

from __future__ import annotations

import webbrowser
from dataclasses import dataclass, replace
from pathlib import Path

from tominpmp.cli.commands import RobotName
from tominpmp.cli.option_fields import GeneralOptions, options
from tominpmp.cli.terminal import say


@options("Page")
@dataclass(frozen=True, kw_only=True)
class AppOptions(GeneralOptions):
    """Where the live page is served.

    Attributes:
        port (N): Port to serve the page at. Default: 8080.
        host (ADDRESS): Address to serve it at; 0.0.0.0 lets others on the network open
            it. Default: 127.0.0.1.
        no_browser: Do not open the page in the browser.
        kinematic: Leave out torques, of which the robot's file need say nothing then.
    """

    port: int = 8080
    host: str = "127.0.0.1"
    no_browser: bool = False
    kinematic: bool = False


def app(robot: RobotName = "panda", /, *, args: AppOptions = AppOptions()) -> None:
    """Open a page on which a motion is planned while its goal is dragged.

    Start, goal, points on the way and obstacles have handles, limits have sliders;
    the page shows the duration, how near it is to what is possible, and what holds
    the motion back, and gives it out as a file and as lines of Python.
    """
    from tominpmp.app.first_request import first_request, known
    from tominpmp.app.page import Page, import_viser

    import_viser()
    path = Path(robot)
    choice = known(str(path.resolve()) if path.is_file() else robot)
    choice = replace(choice, kinematic=args.kinematic)
    page = Page(first_request(choice), args.host, args.port)
    say(f"page  {page.address}  (Ctrl-C ends it)")
    if not args.no_browser:
        webbrowser.open(page.address)
    page.wait()
