"""The option `energy_weight`: closed forms, trades of time against energy, errors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid

import tominpmp as tm
from tests.energy_derivatives import check_gradient
from tests.sample_arms import make_arm, slide, swinging_arm
from tominpmp.exceptions import OptionsError
from tominpmp.motion.measures import ENERGIES
from tominpmp.planner import energy, smoothing
from tominpmp.stopping import Stop
from tominpmp.transcription.bspline import BSplineTranscription, InverseTranscription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram


def rail(distance: float = 1.0) -> tm.Problem:
    arm = make_arm(slide(1.0), effort=np.array([100.0]))
    return tm.Problem(arm, [0.0], tm.JointGoal([distance]))


def two_links() -> tm.Problem:
    return tm.Problem(swinging_arm(12.0, 6.0), [0.3, 0.4], tm.JointGoal([1.2, -0.6]))


@pytest.mark.parametrize(
    ("distance", "weight", "method", "error"),
    [
        (1.0, 1.0, "auto", 1e-6),
        (2.0, 0.3, "auto", 1e-6),
        (1.0, 1.0, "collocation", 1e-3),
    ],
)
def test_duration_and_energy_of_a_rail_match_the_closed_form(
    distance, weight, method, error
):
    solution = tm.plan(rail(distance), energy_weight=weight, method=method)
    assert solution.success, solution.message
    T = (36.0 * weight * distance**2) ** 0.25
    assert pytest.approx(T, rel=error) == solution.T
    energy = 12.0 * distance**2 / T**3
    assert solution.energy == pytest.approx(energy, rel=2 * error)
    assert solution.cost == pytest.approx(T + weight * energy, rel=error)
    assert solution.cost == pytest.approx(4.0 / 3.0 * T, rel=error)
    assert "trade of time against energy" in solution.message


def test_duration_and_cost_of_a_unit_rail():
    solution = tm.plan(rail(), energy_weight=1.0)
    assert pytest.approx(2.449490, abs=1e-6) == solution.T
    assert solution.cost == pytest.approx(3.265986, abs=1e-6)


@pytest.fixture(scope="module")
def trades():
    """Solutions of two links for each weight of the energy."""
    weights = (1e-3, 1e-2)
    quick = {"intervals": 16, "starts": 1}
    return {k: tm.plan(two_links(), energy_weight=k, **quick) for k in weights}


@pytest.mark.parametrize("options", [{"energy_weight": 1.0}, {"slack": 0.01}])
def test_time_limit_before_the_second_objective_is_reported(monkeypatch, options):
    """Regression: the status was that of a completed plan, or of an optimal motion."""

    def late(*_):
        raise Stop(requested=False)

    for stage in (energy, smoothing):
        monkeypatch.setattr(stage, "reoptimised", late)
    solution = tm.plan(rail(), max_planning_time=30.0, **options)
    assert solution.success and solution.status is tm.Status.TIME_LIMIT
    assert "there was no time for" in solution.message
    assert "within the 30 s allowed." in solution.message


def test_energy_that_was_not_weighed_for_lack_of_time_is_told(trades):
    """Regression: the message was that of a plan without an energy weight."""
    cut = replace(trades[1e-3], status=tm.Status.TIME_LIMIT)
    found = energy.with_least_cost(cut)
    assert found.status is tm.Status.TIME_LIMIT
    assert found.message == f"{cut.message} Its energy was not weighed."


def test_larger_weight_saves_energy_and_takes_more_time(trades):
    less, least = trades.values()
    for solution in trades.values():
        assert solution.success, solution.message
        assert solution.verification.ok
    assert less.T < least.T
    assert less.energy > least.energy
    # Each solution is the better one at its own weight.
    for weight, best in trades.items():
        for other in trades.values():
            assert best.T + weight * best.energy <= (
                other.T + weight * other.energy
            ) * (1.0 + 5e-3)


def test_reported_energy_is_the_integral_of_the_torques(trades):
    motion = trades[1e-2].trajectory
    t = np.linspace(0.0, motion.duration, 20001)
    squares = np.sum(motion(t).u ** 2, axis=1)
    assert trades[1e-2].energy == pytest.approx(trapezoid(squares, t), rel=1e-5)


def test_tool_speed_limit_holds_with_an_energy_weight():
    arm = make_arm(slide(1.0), effort=np.array([100.0]))
    slow = tm.ToolSpeed("tip", 0.5)
    problem = tm.Problem(arm, [0.0], tm.JointGoal([1.0]), constraints=(slow,))
    solution = tm.plan(problem, energy_weight=1.0, intervals=20)
    assert solution.success, solution.message
    v = solution.trajectory(np.linspace(0.0, solution.T, 500)).v
    assert np.abs(v).max() < 0.5 * 1.005
    assert solution.T > 2.449490


def test_certificate_says_that_it_is_about_the_duration(trades):
    assert trades[1e-2].certificate.message.startswith("This is about the duration")


def test_sensitivities_are_rejected_with_an_energy_weight(trades):
    with pytest.raises(tm.ProblemError, match=r"energy_weight is 0\.01, expected 0"):
        _ = trades[1e-2].sensitivities


def _programs():
    system = ProblemFunctions.of(two_links())
    # On fewer intervals an inner stage of collocation has several solutions.
    shares = interval_shares("cosine", 16)
    whole = np.sum(shares, axis=1, keepdims=True)

    def path(t):
        share = np.clip(np.atleast_1d(t) / 2.0, 0.0, 1.0)[:, None]
        start, goal = np.array([0.3, 0.4]), np.array([1.2, -0.6])
        bend = np.array([0.3, 0.2]) * np.sin(np.pi * share)
        return start + (3 * share**2 - 2 * share**3) * (goal - start) + bend

    jumping = InverseTranscription(system, shares, 2.0)
    yield jumping, jumping.start(path, 2.0, np.full(shares.shape[1], 2.0))
    smooth = BSplineTranscription(system, whole, 3)
    yield smooth, smooth.start(path, 2.0, np.array([2.0]))
    lifted = CollocationTranscription(system, whole, 2.0)
    yield lifted, lifted.start(path, 2.0, np.array([2.0]))


@pytest.mark.parametrize("kind", ENERGIES.values(), ids=ENERGIES)
@pytest.mark.parametrize("number", range(3))
def test_energy_gradient_matches_differences(number, kind):
    transcription, z = list(_programs())[number]
    rng = np.random.default_rng(0)
    z = z + 1e-2 * rng.standard_normal(z.size)
    program = NonlinearProgram.of(transcription).at(z)
    check_gradient(program, kind, z, rng, step=1e-6, rel=1e-5)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"energy_weight": -1.0}, "energy_weight is -1.0, expected a number >= 0"),
        ({"energy_weight": math.nan}, "energy_weight is nan"),
        ({"energy_weight": "much"}, "energy_weight is 'much'"),
        (
            {"energy_weight": 1.0, "method": "adjoint"},
            "method is 'adjoint', and energy",
        ),
        ({"energy_weight": 1.0, "control_period": 0.01}, "control_period is 0.01, and"),
        ({"energy_weight": 1.0, "slack": 0.1}, "slack is 0.1, and energy_weight"),
        ({"energy_weight": 1.0, "objective": "feasible"}, "objective is 'feasible'"),
    ],
)
def test_energy_weight_rejects_incompatible_options(changes, words):
    with pytest.raises(OptionsError, match=words):
        tm.plan(rail(), **changes)


def test_energy_weight_survives_a_scenario_file(tmp_path):
    path = tmp_path / "rail.toml"
    robot = tm.load_robot("planar3r", gravity=(0, 0, 0))
    problem = tm.Problem(robot, [0.5, 0.5, 0.5], tm.JointGoal([0.6, 0.5, 0.4]))
    tm.save_scenario(path, problem, tm.Options(energy_weight=0.01))
    assert tm.load_scenario(path).options.energy_weight == 0.01


def test_energy_plan_leaves_the_path_of_the_fastest_motion():
    """The path of the fastest motion is locally optimal, and costs 25 % more."""
    robot = tm.load_robot("ur5", limits="urdf")
    start = [0.04, 1.35, -1.07, 1.35, -0.56, -0.23]
    goal = tm.JointGoal([0.98, -0.27, 0.15, -1.42, 0.76, 0.11])
    solution = tm.plan(tm.Problem(robot, start, goal), energy_weight=1e-3)
    assert solution.status is tm.Status.CONVERGED, solution.message
    assert solution.cost < 2.15
    assert solution.T > 1.5
    assert solution.energy < 500.0


def test_energy_plan_raises_the_merit_weight_for_weak_motors():
    """Slowing down does not remove violations of holding torques.

    The weight of these violations must be raised.
    """
    robot = tm.load_robot("planar3r")
    goal = tm.JointGoal([0.3, 0.3, 0.69])
    problem = tm.Problem(robot, [0.53, -0.6, 0.94], goal)
    solution = tm.plan(problem, energy_weight=1e-4)
    assert solution.status is tm.Status.CONVERGED, solution.message
    assert solution.cost < 0.9405
