"""Showing a page in the user's browser."""

from __future__ import annotations

import threading
import webbrowser
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

# How long a browser may take to start and ask for the page [s].
PATIENCE = 20.0


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
