"""A playback as one HTML page that needs no network and no server, and showing it."""

from __future__ import annotations

import base64
import html
import json
import math
import threading
import webbrowser
from collections.abc import Sequence
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.exceptions import MissingDependency
from tominpmp.viz.meshcat_scene import ASPECT, FIELD_OF_VIEW
from tominpmp.viz.shares import AT_LIMIT, SPEED_COLOR, TORQUE_COLOR, Shares
from tominpmp.viz.viewer import Command, import_meshcat

# Meshcat's viewer evaluates no strings and loads nothing; the browser is told to see to
# that, whatever the page contains.
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; media-src blob:; worker-src blob:"
)
# How long a browser may take to start and ask for the page [s].
PATIENCE = 20.0


def build_page(
    commands: Sequence[Command],
    *,
    title: str,
    caption: str,
    rate: float,
    shares: Shares,
) -> str:
    """Build the page.

    Args:
        commands: What is shown, the animation included.
        title: Title of the page, plain text; also shown above the picture.
        caption: Line below it, plain text.
        rate: Speed at which it plays first; 1 is real time.
        shares: Speeds and torques over their limits, shown beside the picture.

    Raises:
        MissingDependency: If Meshcat is not installed.
    """
    viewer, licences = _viewer()
    template = resources.files(__package__).joinpath("player.html").read_text("utf-8")
    fields = {
        "POLICY": POLICY,
        "TITLE": html.escape(title),
        "CAPTION": html.escape(caption),
        "RATE": json.dumps(float(rate)),
        "AT_LIMIT": json.dumps(AT_LIMIT),
        "SPEED_COLOR": SPEED_COLOR,
        "TORQUE_COLOR": TORQUE_COLOR,
        "SHARES": _script(_rounded(shares)),
        "SLOPE": json.dumps(math.tan(math.radians(FIELD_OF_VIEW / 2))),
        "ASPECT": json.dumps(ASPECT),
        "COMMANDS": json.dumps([_text(command) for command in commands]),
        # Inside a comment, which two hyphens would end.
        "LICENCES": licences.replace("--", "- -"),
        "VIEWER": viewer,
    }
    # Piece by piece, as what is put in may contain what looks like a field.
    head, *rest = template.split("{{")
    pieces = [head]
    for part in rest:
        name, _, text = part.partition("}}")
        pieces += [fields[name], text]
    return "".join(pieces)


def _script(value: object) -> str:
    """JSON that can stand in a script: no name in it ends the element."""
    return json.dumps(value).replace("</", "<\\/")


def _rounded(shares: Shares) -> dict[str, Any]:
    return {
        "names": list(shares.joint_names),
        "t": np.round(shares.t, 5).tolist(),
        "torque": np.round(shares.torque.T, 3).tolist(),
        "speed": np.round(shares.speed.T, 3).tolist(),
    }


def _text(command: Command) -> str:
    import umsgpack

    return base64.b64encode(umsgpack.packb(command)).decode("ascii")


@cache
def _viewer() -> tuple[str, str]:
    """Script of Meshcat's viewer and the licences of what is in it."""
    folder = Path(import_meshcat().viewer_assets_path())
    script = folder / "dist" / "main.min.js"
    if not script.is_file():
        raise MissingDependency("meshcat", "viz", "playback")
    texts = [
        path.read_text("utf-8")
        for path in (folder / "LICENSE", script.with_name(f"{script.name}.LICENSE.txt"))
        if path.is_file()
    ]
    # The script must not end the element that it stands in.
    code = script.read_text("utf-8").replace("</script", "<\\/script")
    return code, "\n".join(texts)


def show_page(page: bytes, patience: float = PATIENCE) -> bool:
    """Hand a page to the browser over a local address that lives until it has it.

    Browsers in a sandbox of their own (snap, flatpak) cannot read temporary files, and
    a server that lives on would end with the program, so the page is given out once.

    Args:
        page: The page, in HTML and UTF-8.
        patience: How long to wait for the browser [s].

    Returns:
        Whether the browser took the page.
    """
    taken = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(page)))
            self.end_headers()
            self.wfile.write(page)
            taken.set()

        def log_message(self, format: str, *args: object) -> None:
            """Keep silent."""

    # A thread for each connection: browsers open some that they never use.
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            opened = webbrowser.open(f"http://127.0.0.1:{server.server_port}/", new=2)
            return opened and taken.wait(patience)
        finally:
            server.shutdown()
            thread.join()
