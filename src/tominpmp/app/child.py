"""The process that plans: ``python -m tominpmp.app.child``, started by a worker."""

from __future__ import annotations

import os
import signal
import threading

from tominpmp.app.jobs import Inbox, receive, send, work
from tominpmp.app.planning import Session


def main() -> None:
    """Serve the parent until it closes the input."""
    # Ctrl-C in the terminal is for the parent, which closes the input.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    output = os.fdopen(os.dup(1), "wb")
    # What libraries print must not get between the records.
    os.dup2(2, 1)
    inbox = Inbox()

    # Not through sys.stdin: its lock would be held when the interpreter ends.
    source = os.fdopen(os.dup(0), "rb", closefd=False)

    def read() -> None:
        try:
            while True:
                inbox.put(receive(source))
        except (EOFError, OSError):
            inbox.close()

    threading.Thread(target=read, daemon=True).start()
    try:
        work(Session(), inbox, lambda item: send(output, item))
    except BrokenPipeError:
        pass


if __name__ == "__main__":
    main()
