"""Time against mechanical work: closed forms, work of the replay, scenario files."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.optimize import brentq

import tominpmp as tm
from tests.sample_arms import make_arm, slide, swinging_arm
from tominpmp import options, stopping
from tominpmp.exceptions import OptionsError
from tominpmp.motion.measures import ENERGIES, EnergyKind
from tominpmp.planner import energy


def rail(force: float) -> tm.Robot:
    return make_arm(slide(1.0), effort=np.array([force]))


def closed_form(distance: float, weight: float, force: float) -> tuple[float, float]:
    """T and work of a unit mass that accelerates, coasts and brakes.

    With the speed v of coasting, T = d/v + v/a, and the work is v^2/2. J is least where
    k v^3 + v^2/a = d, or at the speed that leaves no distance for coasting.
    """
    fastest = np.sqrt(distance * force)

    def slope(v: float) -> float:
        return weight * v**3 + v**2 / force - distance

    v = fastest if slope(fastest) < 0.0 else brentq(slope, 1e-9, fastest)
    return distance / v + v / force, 0.5 * v**2


@pytest.mark.parametrize(
    ("distance", "weight", "force"), [(1.0, 1.0, 4.0), (2.0, 0.1, 4.0), (2.0, 5.0, 1.0)]
)
def test_time_against_work_on_a_rail_matches_the_closed_form(distance, weight, force):
    problem = tm.Problem(rail(force), [0.0], tm.JointGoal([distance]))
    options = tm.Options(energy="work", energy_weight=weight)
    T, work = closed_form(distance, weight, force)
    least = pytest.approx(T + weight * work, rel=1e-3)
    assert tm.plan(problem, options).cost == least
    # Accelerations that jump like the force of the motor come closer to its work.
    solution = tm.plan(problem, options, control="constant")
    assert solution.success, solution.message
    assert solution.cost == least
    assert pytest.approx(T, rel=1e-2) == solution.T
    assert solution.energy == pytest.approx(work, rel=3e-2)
    # The mass coasts: the motor is idle between acceleration and braking.
    t = np.linspace(0.0, solution.T, 1001)
    idle = np.abs(solution.trajectory(t).u[:, 0]) < 0.05 * force
    v = np.sqrt(2.0 * work)
    assert np.mean(idle) == pytest.approx((T - 2.0 * v / force) / T, abs=0.1)


def test_collocation_matches_the_closed_form_of_time_against_work():
    problem = tm.Problem(rail(4.0), [0.0], tm.JointGoal([1.0]))
    options = tm.Options(energy="work", energy_weight=1.0, method="collocation")
    solution = tm.plan(problem, options)
    T, work = closed_form(1.0, 1.0, 4.0)
    assert solution.cost == pytest.approx(T + work, rel=1e-3)


def test_tiny_weight_of_work_leaves_the_time_optimal_motion():
    problem = tm.Problem(rail(1.0), [0.0], tm.JointGoal([1.0]))
    options = tm.Options(energy="work", energy_weight=1e-9)
    assert pytest.approx(2.0, rel=5e-4) == tm.plan(problem, options).T
    solution = tm.plan(problem, options, control="constant")
    assert pytest.approx(2.0, rel=1e-4) == solution.T


def test_cost_of_segments_with_a_stop_is_the_sum_of_their_costs():
    segments = [
        tm.Segment(tm.JointGoal([1.0]), stop=True),
        tm.Segment(tm.JointGoal([3.0])),
    ]
    problem = tm.Problem(rail(4.0), [0.0], segments=segments)
    solution = tm.plan(problem, energy="work", energy_weight=1.0)
    parts = [closed_form(d, 1.0, 4.0) for d in (1.0, 2.0)]
    expected = sum(T + work for T, work in parts)
    assert solution.cost == pytest.approx(expected, rel=2e-3)


@pytest.fixture(scope="module")
def swing():
    """Two links in a plane under gravity: the time-optimal plan, and a plan with little
    work.
    """
    problem = tm.Problem(swinging_arm(12.0, 6.0), [0.3, 0.4], tm.JointGoal([1.2, -0.6]))
    quick = tm.Options(intervals=12, starts=1, refine=None, energy="work")
    fastest = tm.plan(problem, quick)
    return fastest, tm.plan(problem, quick.changed({"energy_weight": 0.1}))


def test_work_matches_the_integral_of_positive_power(swing):
    for solution in swing:
        t = np.linspace(0.0, solution.T, 40001)
        _, v, _, u = solution.trajectory(t)
        power = np.sum(np.maximum(u * v, 0.0), axis=1)
        assert solution.energy == pytest.approx(trapezoid(power, t), rel=1e-3)


@pytest.mark.parametrize(("weight", "cost"), [(1e-3, 0.6515), (0.03, 0.8715)])
def test_work_is_weighed_where_torques_are_the_active_limits(swing, weight, cost):
    """Regression: programs were not solved, as small weights of work stood beside
    equations, and constant accelerations cost more than the fastest motion.
    """
    problem = swing[0].problem
    solution = tm.plan(problem, energy="work", energy_weight=weight)
    assert solution.status is tm.Status.CONVERGED, solution.message
    assert solution.cost < cost


def test_motion_of_less_work_is_kept_when_the_time_ends(swing, clock, monkeypatch):
    """Regression: the time limit ended its replay, and the fastest motion was left."""
    steps = itertools.count()

    def left():
        clock.advance(51.0 if next(steps) == 15 else 0.0)
        return stopping.seconds_left()

    monkeypatch.setattr(energy, "seconds_left", left)
    trade = {"energy": "work", "energy_weight": 0.1}
    solution = tm.plan(swing[0].problem, **trade, max_planning_time=50.0)
    assert solution.status is tm.Status.TIME_LIMIT
    assert "trade of time against work" in solution.message
    assert solution.verification.ok
    assert solution.cost < 0.95 * (swing[0].T + 0.1 * swing[0].energy)


def test_weight_of_work_trades_time_for_less_work(swing):
    fastest, thrifty = swing
    assert thrifty.success, thrifty.message
    assert thrifty.verification.ok
    assert thrifty.energy < 0.6 * fastest.energy
    assert thrifty.cost < fastest.T + 0.1 * fastest.energy
    assert "trade of time against work" in thrifty.message
    assert " J, " in thrifty.message


@pytest.mark.parametrize("method", ["inverse", "collocation"])
def test_custom_energy_is_one_entry_of_a_table(monkeypatch, method):
    """T + k int v^2 dt: the mass coasts at the speed 1/sqrt(k), if it reaches this
    speed.
    """

    def term(u, v):
        return v, np.zeros_like(u), np.ones_like(v)

    speed = EnergyKind("squared speed", "m^2/s", term, squared=True, jumping=True)
    monkeypatch.setitem(ENERGIES, "speed_squared", speed)
    monkeypatch.setitem(options.CHOICES, "energy", tuple(ENERGIES))
    distance, weight, force = 2.0, 1.0, 4.0
    problem = tm.Problem(rail(force), [0.0], tm.JointGoal([distance]))
    given = {"energy": "speed_squared", "energy_weight": weight, "method": method}
    solution = tm.plan(problem, **given)
    v = 1.0 / np.sqrt(weight)
    T = distance / v + v / force
    energy = v * distance - v**3 / (3.0 * force)
    assert solution.cost == pytest.approx(T + weight * energy, rel=1e-3)
    assert pytest.approx(T, rel=1e-2) == solution.T
    assert solution.energy == pytest.approx(energy, rel=1e-2)
    assert "trade of time against squared speed" in solution.message


def test_wrong_energy_is_rejected():
    with pytest.raises(OptionsError, match="energy is 'heat', expected one of: torque"):
        tm.Options(energy="heat")
    with pytest.raises(OptionsError, match="energy is 3"):
        tm.Options(energy=3)


def test_energy_survives_saving_and_loading(tmp_path):
    robot = tm.load_robot("planar3r", gravity=(0, 0, 0))
    problem = tm.Problem(robot, [0.5, 0.5, 0.5], tm.JointGoal([0.6, 0.5, 0.4]))
    options = tm.Options(energy="work", energy_weight=0.01)
    path = tmp_path / "arm.toml"
    tm.save_scenario(path, problem, options)
    assert tm.load_scenario(path).options.energy == "work"
