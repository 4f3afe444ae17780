"""Work spread over processes, threads or a cluster by joblib.

The caller chooses the backend by its name or by ``joblib.parallel_config``: "loky"
(processes), "threading", "dask", "ray", or any other registered backend.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from importlib import import_module
from typing import Any, TypeVar

from tominpmp.exceptions import MissingDependency, ProblemError, brief, quiet, shortened

T = TypeVar("T")


class Executor:
    """Applies a function to a stream of work items, and yields results as they finish.

    Args:
        function: Function of a number and an argument, which returns the number and the
            result; it and the work items must be picklable.
        workers: Number of work items done at once; None for the number that the backend
            is configured with, or the number of cores.
        backend: Name of a backend of joblib; None for the configured backend.

    Attributes:
        workers: Number of work items done at once; -1 for the number of cores.

    Raises:
        ProblemError: If the backend is unknown, or cannot be used.
        MissingDependency: If its package is not installed.
    """

    def __init__(
        self, function: Callable[..., Any], workers: int | None, backend: str | None
    ) -> None:
        from joblib import Parallel

        self._function = function
        try:
            chosen, self.workers = _chosen(backend, workers)
            self._parallel = partial(
                Parallel, backend=chosen, return_as="generator_unordered", batch_size=1
            )
            self._parallel(n_jobs=self.workers)  # so that errors are raised now
        except (ImportError, ValueError, TypeError, KeyError) as error:
            raise _wrong(backend, error) from error

    @contextmanager
    def _running(
        self, work: Iterable[tuple[int, Any]], workers: int
    ) -> Iterator[Iterator[tuple[int, Any]]]:
        """Context with the results as they finish, with the numbers of their work."""
        from joblib import delayed

        calls = (delayed(self._function)(*item) for item in work)
        stream = self._parallel(n_jobs=workers)(calls)
        try:
            yield stream
        finally:
            with quiet(Warning):  # the caller has abandoned the work under way
                stream.close()

    def results(self, work: Iterator[tuple[T, Any]]) -> Iterator[tuple[T, Any]]:
        """Results as they finish, with the labels of their work items.

        Items are taken from the iterator only shortly before a worker is free. If a
        process is killed, the items under way are done again, each in a separate
        process; if that process dies, too, the result is None.

        Args:
            work: Pairs of a label, which stays in this process, and the argument of the
                function.
        """
        from joblib.externals.loky.process_executor import BrokenProcessPool

        under_way: dict[int, tuple[T, Any]] = {}
        numbered = enumerate(work)

        def handed_out() -> Iterator[tuple[int, Any]]:
            for number, item in numbered:
                under_way[number] = item
                yield number, item[1]

        while True:
            running = self._running(handed_out(), self.workers)
            with running as results, suppress(BrokenProcessPool):
                for number, result in results:
                    yield under_way.pop(number)[0], result
                return
            for number in sorted(under_way):
                label, item = under_way.pop(number)
                result = None
                # joblib would run a single worker in this process.
                alone = self._running([(number, item)], 2)
                with alone as results, suppress(BrokenProcessPool):
                    _, result = next(results)
                yield label, result


def _chosen(name: str | None, workers: int | None) -> tuple[Any, int]:
    """The backend, and the number of work items done at once.

    The configuration is read now, as the results may be taken after it has ended.

    Raises:
        ImportError: If the package of the backend is not installed.
        ValueError: If the backend cannot be used.
    """
    from joblib import parallel_config
    from joblib.parallel import get_active_backend

    if name == "dask":
        import_module("distributed")
    elif name == "ray":  # which is no dependency of this library
        import_module("ray.util.joblib").register_ray()
    # From the name alone joblib would make a Dask backend that fails.
    with nullcontext() if name is None else parallel_config(name, n_jobs=-1):
        configured, count = get_active_backend()
    if count in (None, 1) and type(configured).__name__ == "LokyBackend":
        count = -1  # the caller has configured no backend: one process for each core
    return configured, count if workers is None else workers


def _wrong(name: str | None, error: Exception) -> Exception:
    """The error to raise for a backend that cannot be used."""
    if name == "dask" and isinstance(error, ImportError):
        return MissingDependency("distributed", "cluster", "the backend 'dask'")
    reason = shortened(" ".join(str(error).split()), 300)
    if isinstance(error, ValueError) and reason.startswith("Invalid backend"):
        reason = "joblib does not know it"
    return ProblemError(
        f"backend is {brief(name)}, which cannot be used ({reason}); expected 'loky', "
        "'threading', 'dask', 'ray' or another one of joblib",
        "backend",
    )
