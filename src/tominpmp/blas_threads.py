"""Linear algebra on one thread.

Matrices of a motion are small or sparse: more threads bring no gain, and where other
programs occupy the cores, each product waits for its last thread. A plan took 2.7 times
as long there, and its replay seven times (``benchmarks/blas_threads.py``).
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

# The number of threads belongs to the whole process: one call sets it at a time. Nested
# calls, and calls of other threads meanwhile, run with the number that it has set.
_taken = threading.Lock()


@functools.cache
def blas() -> Any:
    """Thread controls of the loaded linear-algebra libraries.

    The search for these libraries takes some milliseconds, once.
    """
    # SciPy brings a BLAS of its own, which can be found only once it is loaded.
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


def on_one_thread(function: F) -> F:
    """Let a function use one thread for linear algebra, and restore the number."""

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
