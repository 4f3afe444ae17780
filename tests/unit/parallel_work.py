"""Functions for other processes, which need not import the library for them."""

from __future__ import annotations

import os
import time

PATIENCE = 300.0  # with a machine that does other things, too [s]


def square(x):
    return x * x


def wait_and_tell(seconds):
    time.sleep(seconds)
    return os.getpid(), os.environ.get("OMP_NUM_THREADS")


def sleep_and_tell(seconds):
    os.write(1, f"{os.getpid()}\n".encode())
    time.sleep(seconds)


def await_file(path):
    """Wait until somebody makes a file, if one is named; say who did."""
    end = time.monotonic() + PATIENCE
    while path is not None and not path.exists():
        assert time.monotonic() < end, "nobody makes the file"
        time.sleep(0.01)
    return os.getpid(), os.environ.get("OMP_NUM_THREADS")


def until_asked(folder):
    """Say that this has begun, and wait; tell whether it was asked to end."""
    from tominpmp.initial_guess.parallel import stop_requested

    (folder / str(os.getpid())).touch()
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end and not stop_requested():
        time.sleep(0.02)
    return stop_requested()


def begin_and_wait(folder):
    """Say that this has begun, and wait, whoever asks; nothing without a folder."""
    if folder is not None:
        (folder / str(os.getpid())).touch()
        time.sleep(2.0 * PATIENCE)
