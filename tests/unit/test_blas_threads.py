"""BLAS uses one thread during the calls of the library, and its former number after."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import scipy.linalg  # noqa: F401 (brings a BLAS of its own)
from threadpoolctl import ThreadpoolController

import tominpmp as tm
from tominpmp.initial_guess.guess import straight_guess
from tominpmp.planner.starts import descend_in_process
from tominpmp.transcription.problem_functions import ProblemFunctions

MANY = 3


def thread_counts() -> list[int]:
    """The number of threads of each loaded BLAS library."""
    found = ThreadpoolController().select(user_api="blas").info()
    return [library["num_threads"] for library in found]


def set_all(count: int) -> None:
    """Set the number in a thread that ends: a living thread would determine it."""

    def act() -> None:
        ThreadpoolController().select(user_api="blas").limit(limits=count)

    other = threading.Thread(target=act)
    other.start()
    other.join()


@pytest.fixture(autouse=True)
def several_threads() -> Iterator[None]:
    """BLAS has several threads; if every library has one, the tests are skipped."""
    usual = max(thread_counts(), default=1)
    set_all(MANY)
    if MANY not in thread_counts():
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


def test_plan_uses_one_thread_and_restores_the_former_number(
    problem: tm.Problem,
) -> None:
    before, seen = thread_counts(), []
    tm.plan(
        problem,
        effort="quick",
        starts=1,
        callback=lambda record: seen.extend(thread_counts()),
    )
    assert set(seen) == {1}
    assert thread_counts() == before


def test_failed_plan_restores_the_number_of_threads(problem: tm.Problem) -> None:
    class Odd(Exception):
        pass

    def fail(record: object) -> None:
        raise Odd

    before = thread_counts()
    with pytest.raises(Odd):
        tm.plan(problem, effort="quick", starts=1, callback=fail)
    with pytest.raises(tm.OptionsError):
        tm.plan(problem, method="magic")
    assert thread_counts() == before


def test_descent_in_a_worker_process_uses_one_thread(problem: tm.Problem) -> None:
    before, seen = thread_counts(), list[int]()
    options = tm.Options(
        method="inverse",
        lp_solver="piqp",
        callback=lambda record: seen.extend(thread_counts()),
    )
    system = ProblemFunctions.of(problem)
    guess = straight_guess(system, problem.goal.configuration)
    descend_in_process(system, options, time.time() + 300.0, math.inf, guess)
    assert set(seen) == {1}
    assert thread_counts() == before


FUNCTIONS: dict[str, Callable[[tm.Problem, tm.Solution], object]] = {
    "verify": lambda problem, motion: tm.verify(problem, motion.trajectory),
    "certify": lambda problem, motion: tm.certify(problem, motion.trajectory),
    "lower_bound": lambda problem, motion: tm.lower_bound(problem),
    "smooth": lambda problem, motion: tm.smooth(motion),
    "sensitivities": lambda problem, motion: motion.sensitivities,
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_on_motions_use_one_thread_and_restore_the_number(
    monkeypatch: pytest.MonkeyPatch,
    problem: tm.Problem,
    motion: tm.Solution,
    name: str,
) -> None:
    """The number is read in accesses to the robot, which all functions make."""
    seen: list[int] = []
    usual = tm.Robot.__getattribute__

    def watched(self: tm.Robot, field: str) -> Any:
        if field in ("model", "limits") and len(seen) < 10:
            seen.extend(thread_counts())
        return usual(self, field)

    before = thread_counts()
    monkeypatch.setattr(tm.Robot, "__getattribute__", watched)
    FUNCTIONS[name](problem, motion)
    monkeypatch.undo()
    assert set(seen) == {1}
    assert thread_counts() == before


@pytest.mark.parametrize("first_ends", [True, False])
def test_two_concurrent_plans_restore_the_number_of_threads(
    problem: tm.Problem, first_ends: bool
) -> None:
    """The number belongs to the process: the second plan must not restore a one."""
    before, seen = thread_counts(), list[int]()
    begun, over = threading.Event(), threading.Event()

    def first(record: object) -> None:
        begun.set()
        seen.extend(thread_counts())
        over.wait(60.0)

    def second(record: object) -> None:
        if first_ends:
            over.set()
            one.join(60.0)
        else:
            seen.extend(thread_counts())

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
    assert thread_counts() == before
