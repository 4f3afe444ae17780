"""Work spread over processes, threads or a cluster by joblib.

Which of these is the caller's choice, by the name of a backend or by
``joblib.parallel_config``: "loky" (processes), "threading", "dask", "ray", or any other
that was registered.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any, TypeVar

from tominpmp.exceptions import MissingDependency, ProblemError, brief, shortened
from tominpmp.initial_guess.parallel import available_processes

Work = TypeVar("Work")
Result = TypeVar("Result")

# Backends that come with packages of their own.
CLUSTERS = ("dask", "ray")
# A process that dies is believed to have died of its work after so many attempts.
ATTEMPTS = 2


class Executor:
    """Applies a function to a stream of work, results as they finish.

    Args:
        function: The function; it and the work must be picklable.
        workers: How many pieces of work are done at once; None for as many as the
            backend says, or there are cores.
        backend: Name of a backend of joblib; None for the one that is configured.

    Raises:
        ProblemError: If there is no such backend, or it cannot be used.
        MissingDependency: If its package is not installed.
    """

    def __init__(
        self, function: Callable[[Any], Any], workers: int | None, backend: str | None
    ) -> None:
        self._function, self._backend = function, backend
        self._workers = _count(workers, backend)
        self._parallel()  # whatever is wrong is wrong now

    @property
    def workers(self) -> int | None:
        """How many pieces of work are done at once; None for the backend's own."""
        return self._workers

    def _parallel(self, workers: int | None = None) -> Any:
        from joblib import Parallel

        name = self._backend
        try:
            if name == "ray":
                # No dependency of this library.
                import_module("ray.util.joblib").register_ray()
            return Parallel(
                n_jobs=self._workers if workers is None else workers,
                backend=name,
                return_as="generator_unordered",
                batch_size=1,
            )
        except (ImportError, ValueError, TypeError, KeyError) as error:
            if name == "dask" and isinstance(error, ImportError):
                needed = "distributed", "cluster", "the backend 'dask'"
                raise MissingDependency(*needed) from error
            reason = shortened(" ".join(str(error).split()), 300)
            raise ProblemError(
                f"backend is {brief(name)}, which cannot be used ({reason}); expected "
                "'loky', 'threading', 'dask', 'ray' or another one of joblib",
                "backend",
            ) from error

    def results(
        self, work: Iterator[tuple[int, Work]], lost: Callable[[Work], Result]
    ) -> Iterator[tuple[int, Result]]:
        """Results as they finish, with the numbers of their work.

        Work is taken from the iterator only a little before there is somebody to do
        it. Where a process is killed, what was under way is done again, each in a
        process of its own.

        Args:
            work: Numbers, and what the function is applied to.
            lost: What becomes of work whose process dies again and again.
        """
        from joblib import delayed
        from joblib.externals.loky.process_executor import BrokenProcessPool

        under_way: dict[int, Work] = {}

        def handed_out() -> Iterator[Any]:
            for number, item in work:
                under_way[number] = item
                yield delayed(_numbered)(self._function, number, item)

        while True:
            stream = self._parallel()(handed_out())
            try:
                for number, result in stream:
                    del under_way[number]
                    yield number, result
            except BrokenProcessPool:
                for number in sorted(under_way):
                    yield number, self._alone(number, under_way.pop(number), lost)
                continue
            finally:
                _close(stream)
            return

    def _alone(self, number: int, item: Work, lost: Callable[[Work], Result]) -> Any:
        """Do work that was under way when a process died."""
        from joblib import delayed
        from joblib.externals.loky.process_executor import BrokenProcessPool

        for _ in range(ATTEMPTS - 1):
            # One worker would be this process.
            stream = self._parallel(workers=2)(
                [delayed(_numbered)(self._function, number, item)]
            )
            try:
                return next(stream)[1]
            except BrokenProcessPool:
                continue
            finally:
                _close(stream)
        return lost(item)


def _numbered(
    function: Callable[[Work], Result], number: int, item: Work
) -> tuple[int, Result]:
    return number, function(item)


def _close(stream: Any) -> None:
    """End what is under way, without a word: the caller has stopped asking for it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        stream.close()


def _count(workers: int | None, backend: str | None) -> int | None:
    """How many at once; as many as there are cores unless somebody says otherwise."""
    if workers is not None:
        return workers
    from joblib.parallel import get_active_backend

    configured, count = get_active_backend()
    if backend is None and (
        count not in (None, 1) or type(configured).__name__ != "LokyBackend"
    ):
        return None
    return -1 if backend in CLUSTERS else available_processes()
