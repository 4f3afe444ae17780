"""Linear algebra on one thread.

Matrices of a motion are small or sparse: more threads bring no gain, and where other
programs occupy the cores, each product waits for its last thread. A plan took 2.7 times
as long there, and its replay seven times (``benchmarks/blas_threads.py``).
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

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


@contextmanager
def _one_thread() -> Iterator[None]:
    with ExitStack() as stack:
        if _taken.acquire(blocking=False):
            stack.callback(_taken.release)
            stack.enter_context(blas().limit(limits=1))
        yield


#: Decorator that lets a function use one thread for linear algebra, and restores the
#: number.
on_one_thread = _one_thread()
