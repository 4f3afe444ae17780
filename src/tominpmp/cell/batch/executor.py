"""Work spread over processes, threads or a cluster by joblib.

Which of these is the caller's choice, by the name of a backend or by
``joblib.parallel_config``: "loky" (processes), "threading", "dask", "ray", or any other
that was registered.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from importlib import import_module
from typing import Any

from tominpmp.exceptions import MissingDependency, ProblemError, brief, shortened
from tominpmp.initial_guess.parallel import available_processes

# Backends that come with packages of their own.
CLUSTERS = ("dask", "ray")


class Executor:
    """Applies a function to a stream of work, results as they finish.

    Args:
        function: The function; it and the work must be picklable.
        workers: How many pieces of work are done at once; None for as many as the
            backend says, or there are cores.
        backend: Name of a backend of joblib; None for the one that is configured.

    Attributes:
        workers: How many pieces of work are done at once; None for the backend's own.

    Raises:
        ProblemError: If the backend is unknown, or cannot be used.
        MissingDependency: If its package is not installed.
    """

    def __init__(
        self, function: Callable[[Any], Any], workers: int | None, backend: str | None
    ) -> None:
        self._function = function
        try:
            self._backend, self.workers = _chosen(backend, workers)
            self._parallel(self.workers)  # whatever is wrong is wrong now
        except (ImportError, ValueError, TypeError, KeyError) as error:
            raise _wrong(backend, error) from error

    def _parallel(self, workers: int | None) -> Any:
        from joblib import Parallel

        return Parallel(
            n_jobs=workers,
            backend=self._backend,
            return_as="generator_unordered",
            batch_size=1,
        )

    def _run(
        self, work: Iterable[tuple[int, Any]], workers: int | None
    ) -> Generator[tuple[int, Any], None, None]:
        """Results as they finish, with the numbers of their work."""
        from joblib import delayed

        call = delayed(_numbered)
        stream = self._parallel(workers)(call(self._function, *item) for item in work)
        try:
            yield from stream
        finally:
            with warnings.catch_warnings():
                # The caller has stopped asking for the work under way.
                warnings.simplefilter("ignore")
                stream.close()

    def results(self, work: Iterator[tuple[int, Any]]) -> Iterator[tuple[int, Any]]:
        """Results as they finish, with the numbers of their work.

        Work is taken from the iterator only a little before there is somebody to do
        it. Where a process is killed, what was under way is done again, each in a
        process of its own; the result of work whose process dies again is None.

        Args:
            work: Numbers, and what the function is applied to.
        """
        from joblib.externals.loky.process_executor import BrokenProcessPool

        under_way: dict[int, Any] = {}

        def handed_out() -> Iterator[tuple[int, Any]]:
            for number, item in work:
                under_way[number] = item
                yield number, item

        while True:
            with closing(self._run(handed_out(), self.workers)) as found:
                try:
                    for number, result in found:
                        del under_way[number]
                        yield number, result
                    return
                except BrokenProcessPool:
                    pass
            for number, item in sorted(under_way.items()):
                del under_way[number]
                # One worker would be this process.
                with closing(self._run([(number, item)], 2)) as alone:
                    try:
                        yield next(alone)
                    except BrokenProcessPool:
                        yield number, None


def _numbered(
    function: Callable[[Any], Any], number: int, item: Any
) -> tuple[int, Any]:
    return number, function(item)


def _chosen(name: str | None, workers: int | None) -> tuple[Any, int | None]:
    """The backend, and how many pieces of work are done at once.

    What is configured is asked for now: results may be taken when it is no longer.

    Raises:
        ImportError: If the package of the backend is not installed.
        ValueError: If it cannot be used.
    """
    from joblib import parallel_config
    from joblib.parallel import get_active_backend

    configured: Any
    configured, count = get_active_backend()
    if name in CLUSTERS:
        import_module("distributed" if name == "dask" else "ray")
        if name == "ray":
            # No dependency of this library.
            import_module("ray.util.joblib").register_ray()
        # By its name alone joblib would make a backend of Dask that fails.
        with parallel_config(name, n_jobs=-1):
            configured, count = get_active_backend()
    elif name is not None:
        configured, count = name, available_processes()
    elif count in (None, 1) and type(configured).__name__ == "LokyBackend":
        # Nobody has configured any: as many as there are cores.
        configured, count = None, available_processes()
    return configured, count if workers is None else workers


def _wrong(name: str | None, error: Exception) -> Exception:
    """The error to raise for a backend that cannot be used."""
    missing = isinstance(error, ImportError)
    if name == "dask" and missing:
        return MissingDependency("distributed", "cluster", "the backend 'dask'")
    if name == "ray" and missing:
        return ProblemError(
            "backend is 'ray', which needs the package ray, which is not installed: "
            "pip install ray",
            "backend",
        )
    reason = shortened(" ".join(str(error).split()), 300)
    if isinstance(error, ValueError) and reason.startswith("Invalid backend"):
        reason = "joblib does not know it"
    return ProblemError(
        f"backend is {brief(name)}, which cannot be used ({reason}); expected 'loky', "
        "'threading', 'dask', 'ray' or another one of joblib",
        "backend",
    )
