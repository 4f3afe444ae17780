"""Linear algebra takes one thread while the library works, and no longer."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import scipy.linalg  # noqa: F401 (brings a BLAS of its own)
from threadpoolctl import ThreadpoolController

import tominpmp as tm

MANY = 3


def numbers() -> list[int]:
    """Threads of each library of linear algebra."""
    found = ThreadpoolController().select(user_api="blas").info()
    return [library["num_threads"] for library in found]


def set_all(count: int) -> None:
    """Set the number in a thread that ends: one that lives would have the say."""

    def act() -> None:
        ThreadpoolController().select(user_api="blas").limit(limits=count)

    other = threading.Thread(target=act)
    other.start()
    other.join()


@pytest.fixture(autouse=True)
def several() -> Iterator[None]:
    """More than one, whatever the machine has; some libraries have no more."""
    usual = max(numbers(), default=1)
    set_all(MANY)
    if MANY not in numbers():
        pytest.skip("the linear algebra that is installed has one thread only")
    yield
    set_all(usual)


@pytest.fixture(scope="module")
def problem() -> tm.Problem:
    robot = tm.load_robot("planar3r")
    return tm.Problem(robot, (0.5, 1.7, -1.7), tm.JointGoal((0.7, 1.5, -1.5)))


@pytest.fixture(scope="module")
def motion(problem: tm.Problem) -> tm.Solution:
    return tm.plan(problem, effort="quick", starts=1)


def test_planning_takes_one_thread_and_gives_back_what_was_there(
    problem: tm.Problem,
) -> None:
    before, seen = numbers(), []
    tm.plan(
        problem,
        effort="quick",
        starts=1,
        callback=lambda record: seen.extend(numbers()),
    )
    assert set(seen) == {1}
    assert numbers() == before


def test_what_fails_gives_them_back_too(problem: tm.Problem) -> None:
    class Odd(Exception):
        pass

    def fail(record: object) -> None:
        raise Odd

    before = numbers()
    with pytest.raises(Odd):
        tm.plan(problem, effort="quick", starts=1, callback=fail)
    with pytest.raises(tm.OptionsError):
        tm.plan(problem, method="magic")
    assert numbers() == before


JUDGES: dict[str, Callable[[tm.Problem, tm.Solution], object]] = {
    "verify": lambda problem, motion: tm.verify(problem, motion.trajectory),
    "certify": lambda problem, motion: tm.certify(problem, motion.trajectory),
    "lower_bound": lambda problem, motion: tm.lower_bound(problem),
    "smooth": lambda problem, motion: tm.smooth(motion),
    "sensitivities": lambda problem, motion: motion.sensitivities,
}


@pytest.mark.parametrize("name", JUDGES)
def test_so_does_what_judges_motions(
    monkeypatch: pytest.MonkeyPatch,
    problem: tm.Problem,
    motion: tm.Solution,
    name: str,
) -> None:
    """Seen from where all of them come by: the robot's dynamics and limits."""
    seen: list[int] = []
    usual = tm.Robot.__getattribute__

    def watched(self: tm.Robot, field: str) -> Any:
        if field in ("model", "limits") and len(seen) < 10:
            seen.extend(numbers())
        return usual(self, field)

    before = numbers()
    monkeypatch.setattr(tm.Robot, "__getattribute__", watched)
    JUDGES[name](problem, motion)
    monkeypatch.undo()
    assert set(seen) == {1}
    assert numbers() == before


@pytest.mark.parametrize("first_ends", [True, False])
def test_of_two_threads_none_leaves_a_limit_behind(
    problem: tm.Problem, first_ends: bool
) -> None:
    """The number is the whole process's: who comes second must not put back a one."""
    before, seen = numbers(), list[int]()
    begun, over = threading.Event(), threading.Event()

    def first(record: object) -> None:
        begun.set()
        seen.extend(numbers())
        over.wait(60.0)

    def second(record: object) -> None:
        if first_ends:
            over.set()
            one.join(60.0)
        else:
            seen.extend(numbers())

    def plan(callback: Callable[[object], None]) -> None:
        tm.plan(problem, effort="quick", starts=1, refine=None, callback=callback)

    one = threading.Thread(target=plan, args=(first,))
    one.start()
    assert begun.wait(60.0)
    plan(second)
    over.set()
    one.join(60.0)
    assert not one.is_alive()
    assert set(seen) == {1}
    assert numbers() == before
