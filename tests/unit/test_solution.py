"""The record `Solution` that planning returns."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from motion_samples import planar_problem, quintic
from record_samples import record

from tominpmp.exceptions import PlanningFailed, ProblemError
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.problem.problem import Problem
from tominpmp.solution import Solution
from tominpmp.status import Status


@pytest.fixture(scope="module")
def problem() -> Problem:
    return planar_problem()


@pytest.fixture(scope="module")
def motion(problem: Problem) -> Trajectory:
    return quintic(problem.robot, problem.q_start, (0.9, -1.2, -0.9), 1.1, 8)


def solution(
    problem: Problem, trajectory: Trajectory | None, **values: object
) -> Solution:
    given = {
        "status": Status.CONVERGED,
        "message": Status.CONVERGED.value,
        "feasible": trajectory is not None,
    } | values
    return Solution(problem, Options(), trajectory=trajectory, **given)  # type: ignore[arg-type]


@pytest.mark.parametrize("status", Status)
def test_each_status_is_a_sentence_of_its_own(status: Status) -> None:
    assert status.value[0].isupper()
    assert status.value.endswith(".")
    assert len(status.value.split()) > 3
    assert sum(other.value == status.value for other in Status) == 1


def test_converged_solution_is_a_success(problem: Problem, motion: Trajectory) -> None:
    found = solution(problem, motion, history=(record(0), record(1)))
    assert found.success
    assert found.T == motion.duration == 1.1
    assert found.iterations == 2
    assert found.raise_if_failed() is found


def test_feasible_motion_of_an_interrupted_plan_is_a_success(
    problem: Problem, motion: Trajectory
) -> None:
    """A motion that satisfies every constraint is a success, however the planning
    ended.
    """
    found = solution(problem, motion, status=Status.TIME_LIMIT)
    assert found.success
    assert found.raise_if_failed() is found


def test_infeasible_motion_stays_in_the_failed_solution(
    problem: Problem, motion: Trajectory
) -> None:
    message = "No motion was found that keeps all constraints: the goal is missed."
    found = solution(
        problem, motion, feasible=False, status=Status.INFEASIBLE, message=message
    )
    assert not found.success
    assert found.T == np.inf
    assert found.trajectory.duration == 1.1
    with pytest.raises(PlanningFailed) as caught:
        found.raise_if_failed()
    assert str(caught.value) == message
    assert caught.value.solution is found


@pytest.mark.parametrize("feasible", [True, False])
def test_solution_without_a_motion_rejects_plots_and_exports(
    feasible: bool, problem: Problem, tmp_path: Path
) -> None:
    message = "The linear programs could not be solved."
    found = solution(
        problem,
        None,
        feasible=feasible,
        status=Status.NUMERICAL_FAILURE,
        message=message,
    )
    assert not found.success
    assert found.T == np.inf
    assert found.iterations == 0
    with pytest.raises(PlanningFailed, match=message):
        found.raise_if_failed()
    path = tmp_path / "motion"
    for use in (
        lambda: found.play(path.with_suffix(".html")),
        lambda: found.play(),
        lambda: found.plot(),
        lambda: found.plot(path.with_suffix(".png")),
        lambda: found.export(path.with_suffix(".csv")),
        lambda: found.export(path.with_suffix(".npz"), dt=0.01),
    ):
        with pytest.raises(ProblemError, match=f"there is no motion: {message}") as e:
            use()
        assert e.value.field == "trajectory"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ending", ["csv", "npz"])
def test_solution_exports_its_motion(
    ending: str, problem: Problem, motion: Trajectory, tmp_path: Path
) -> None:
    path = tmp_path / f"motion.{ending}"
    # The motion is a sketch, which verification would reject.
    assert solution(problem, motion).export(path, dt=0.1, verify=False) == path
    assert path.stat().st_size > 100


def test_fields_of_a_solution_have_defaults(
    problem: Problem, motion: Trajectory
) -> None:
    found = solution(problem, motion)
    assert found.initial is None
    assert found.history == ()
    assert found.violations == {}
    assert found.verification is None


def test_solution_can_be_pickled(problem: Problem, motion: Trajectory) -> None:
    """Starts run in processes of their own, which send solutions back."""
    found = solution(problem, motion, history=(record(0),), violations={"goal": 1e-9})
    back = pickle.loads(pickle.dumps(found))
    assert back.trajectory == motion
    assert back.status is Status.CONVERGED
    assert back.history == found.history
    assert back.violations == found.violations
    assert back.options == found.options
