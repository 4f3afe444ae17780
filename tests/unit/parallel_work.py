"""Functions for other processes, which need not import the library for them."""

from __future__ import annotations

import os
import time


def square(x):
    return x * x


def wait_and_tell(seconds):
    time.sleep(seconds)
    return os.getpid(), os.environ.get("OMP_NUM_THREADS")


def sleep_and_tell(seconds):
    os.write(1, f"{os.getpid()}\n".encode())
    time.sleep(seconds)
