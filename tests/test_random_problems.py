"""Property tests: random arms with random problems, and an independent check.

For every arm and problem, a plan returns a Solution without a NaN, or raises one of the
library's errors. A motion that counts as a success passes a replay that shares no code
with the library's, and takes no less time than the lower bound.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from independent_check import faults, nonfinite_values
from random_problems import GOALS, KINDS, Case, plan_quietly, random_case

import tominpmp as tm

# Each run draws the same examples; a failure is reported with its seed.
EXAMPLES = settings(
    derandomize=True,
    database=None,
    deadline=None,
    max_examples=7,
    suppress_health_check=list(HealthCheck),
    print_blob=False,
)
SEEDS = st.integers(0, 2**32 - 1)


def arms(most: int) -> st.SearchStrategy[list[str]]:
    """Kinds of the joints of an arm."""
    return st.lists(st.sampled_from(KINDS), min_size=1, max_size=most)


def checked_plan(case: Case, **options: object) -> tm.Solution | None:
    """Plan a case and check its solution; None if the library refuses the case."""
    chosen = {"intervals": 10, "max_iterations": 15, "starts": 1} | options
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            solution = plan_quietly(case, **chosen)
        except tm.TominpmpError as error:
            assert str(error).strip()
            return None
    assert nonfinite_values(solution) == []
    assert solution.message.strip()
    if solution.success:
        assert faults(case, solution) == []
        bound = solution.lower_bound
        assert bound is None or bound.T <= solution.T * (1.0 + 1e-6)
    return solution


@EXAMPLES
@given(kinds=arms(9), moving=st.booleans(), seed=SEEDS)
def test_random_joint_goals_give_valid_solutions(
    kinds: list[str], moving: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    checked_plan(random_case(rng, kinds, "joint", moving=moving))


@EXAMPLES
@example(kinds=["revolute"], goal="position", seed=96)  # the start is at the goal
@given(kinds=arms(6), goal=st.sampled_from(GOALS[1:]), seed=SEEDS)
def test_random_goals_of_every_kind_give_valid_solutions(
    kinds: list[str], goal: str, seed: int
) -> None:
    checked_plan(random_case(np.random.default_rng(seed), kinds, goal))


@EXAMPLES
@given(
    kinds=arms(5),
    goal=st.sampled_from(("joint", "position")),
    obstacles=st.integers(1, 4),
    seed=SEEDS,
)
def test_random_obstacles_give_valid_solutions(
    kinds: list[str], goal: str, obstacles: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    checked_plan(random_case(rng, kinds, goal, obstacles=obstacles))


@pytest.mark.parametrize("seed", range(6))
def test_small_random_arms_reach_their_joint_goals(seed: int) -> None:
    """A planner that never finds a motion would have the properties above, too."""
    rng = np.random.default_rng(seed)
    kinds = [KINDS[i] for i in rng.integers(3, size=1 + seed % 3)]
    case = random_case(rng, kinds, "joint")
    solution = checked_plan(case, max_iterations=100, starts=None)
    assert solution is not None
    assert solution.success


@pytest.mark.parametrize(
    "values",
    [
        {"q_start": np.full(2, np.nan)},
        {"q_start": np.zeros(3)},
        {"v_start": np.full(2, np.inf)},
        {"v_start": np.full(2, 1e6)},
        {"margin": np.nan},
        {"margin": -1.0},
        {"goals": (("joint", {"q": np.full(2, np.nan), "v": None}),)},
        {"goals": (("joint", {"q": np.full(2, 1e300), "v": None}),)},
        {"goals": (("joint", {"q": np.zeros(1), "v": None}),)},
        {"goals": (("position", {"position": [1e9, 0, 0], "tolerance": 0.0}),)},
        {"goals": (("position", {"position": [0, 0], "tolerance": 0.0}),)},
        {"obstacles": ((np.zeros(3), np.nan),)},
        {"obstacles": ((np.zeros(3), -1.0),)},
        {"obstacles": ((np.full(3, np.inf), 1.0),)},
    ],
    ids=lambda values: next(iter(values)),
)
def test_wrong_numbers_are_refused(values: dict[str, object]) -> None:
    rng = np.random.default_rng(3)
    case = random_case(rng, ["revolute", "revolute"], "joint")
    with pytest.raises(tm.TominpmpError):
        plan_quietly(Case(**(vars(case) | values)))
