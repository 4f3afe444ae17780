"""Functions that run in other processes, which need not import the library for them."""

from __future__ import annotations

import os
import time

PATIENCE = 300.0  # on a busy machine [s]


def square(x):
    return x * x


def sleep_and_report(seconds):
    time.sleep(seconds)
    return os.getpid()


def print_pid_and_sleep(seconds):
    os.write(1, f"{os.getpid()}\n".encode())
    time.sleep(seconds)


def await_file(path):
    """Wait until the file exists, if a path is given; return the process id."""
    end = time.monotonic() + PATIENCE
    while path is not None and not path.exists():
        assert time.monotonic() < end, "nobody makes the file"
        time.sleep(0.01)
    return os.getpid()


def wait_for_stop_request(folder):
    """Create a file named after this process, and wait; return whether a stop was
    requested.
    """
    from tominpmp.initial_guess.parallel import stop_requested

    (folder / str(os.getpid())).touch()
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end and not stop_requested():
        time.sleep(0.02)
    return stop_requested()


def begin_and_wait(folder):
    """Create a file named after this process, and wait regardless of requests; return
    at once without a folder.
    """
    if folder is not None:
        (folder / str(os.getpid())).touch()
        time.sleep(2.0 * PATIENCE)
