"""Linear algebra on one thread.

Matrices of a motion are small or sparse: more threads are of no use, and where other
programs have the cores, each product waits for the thread that comes last. A plan took
2.7 times as long there, and its replay seven times (``benchmarks/blas_threads.py``).
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

# The number of threads is that of the whole process: one call has it at a time. Those
# within it, and those of other threads meanwhile, have what it has set.
_taken = threading.Lock()


@functools.cache
def blas() -> Any:
    """The libraries of linear algebra, whose threads can be limited.

    To look for them takes some milliseconds, once.
    """
    # Brings one of its own, which is found where it is loaded.
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


def on_one_thread(function: F) -> F:
    """Let a function take one thread for linear algebra, and give back the others."""

    @functools.wraps(function)
    def call(*args: Any, **named: Any) -> Any:
        if not _taken.acquire(blocking=False):
            return function(*args, **named)
        try:
            with blas().limit(limits=1):
                return function(*args, **named)
        finally:
            _taken.release()

    return call  # type: ignore[return-value]
