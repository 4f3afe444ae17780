"""Minimum times that are known: closed forms, and extremals found by shooting.

T is to be met to 0.1 % by the methods that plan with torques ("collocation" and
"adjoint"), and by "inverse" where a constant acceleration takes a constant torque.
Elsewhere its torque is below the limit for most of an interval, and T approaches the
minimum only like 1/N. No method may be faster than the minimum.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from bang_bang import Structure, find_extremal
from optimum_cases import Case
from reference_optima import (
    Array,
    Mechanism,
    Separate,
    Task,
    TwoLink,
    friction_time,
    linearized,
    rail_time,
    state_rate,
)
from sample_arms import make_arm, slide
from scipy.integrate import solve_ivp
from two_link_cases import CASES, all_cases

import tominpmp as tm
from tominpmp.dynamics import RobotDynamics

METHODS = ("inverse", "collocation", "adjoint")
INTERVALS = 80
TOLERANCE = 1e-3
# Relative errors of goal and equations that are let pass add up to this share of T.
BELOW = 1e-4
# T of "inverse" exceeds the minimum by at most this over N, relatively.
FIRST_ORDER = 2.0
# The grid: intervals that are short at both ends where a mass is soon at full speed,
# equal ones where torques switch in between.
GRIDS = {
    "rail": "uniform",
    "weight": "uniform",
    "friction": "cosine",
    "pendulum": "uniform",
    "swing": "uniform",
    "level": "uniform",
    "vertical": "uniform",
}


@cache
def planned(
    family: str, name: str, method: str, intervals: int, **options: Any
) -> tm.Solution:
    """The library's solution, of the first guess unless more effort is asked for."""
    usual = tm.Options(
        method=method,
        intervals=intervals,
        grid=GRIDS[family],
        effort="quick",
        max_planning_time=300.0,
    )
    return tm.plan(CASES[family][name].problem(), usual, **options)


def excess(case: Case, T: float) -> float:
    """T relative to the slowest known extremal that is not slower, minus one.

    A local method may end at a local optimum; it must then be one of those known.
    """
    known = [case.minimum, *(extremal.T for extremal in case.extremals[1:])]
    reached = [time for time in known if T >= time * (1.0 - BELOW)]
    assert reached, f"T = {T} is below the minimum {case.minimum}"
    return T / max(reached) - 1.0


def names(*families: str, without: tuple[str, ...] = ()) -> list[tuple[str, str]]:
    """Families and names of cases."""
    return [
        (family, name)
        for family in families
        for name in CASES[family]
        if name not in without
    ]


def replay(task: Task, trajectory: tm.Trajectory) -> Array:
    """Final state under the torques of a motion, by the equations written by hand."""
    x = task.ends[0]
    n = task.mechanism.n
    # Relaxes a thousand times in an interval: an explicit method would creep.
    stiff = isinstance(task.mechanism, Separate) and max(task.mechanism.friction) > 10.0
    for begin, end in zip(trajectory.t[:-1], trajectory.t[1:], strict=True):
        # The torque may jump at the end; its value there belongs to what follows.
        last = end - 1e-9 * (end - begin)

        def rate(t: float, x: Array, last: float = last) -> Array:
            return state_rate(task.mechanism, x, trajectory(min(t, last)).u)

        found = solve_ivp(
            rate,
            (begin, end),
            x,
            method="Radau" if stiff else "DOP853",
            rtol=1e-10,
            atol=1e-12,
            first_step=None if stiff else end - begin,
        )
        x = found.y[:, -1]
    assert x.shape == (2 * n,)
    return np.asarray(x)


# -- the references themselves ---------------------------------------------------------


@pytest.mark.parametrize("name", all_cases())
def test_equations_by_hand_are_those_of_the_robot(
    name: str, rng: np.random.Generator
) -> None:
    case = all_cases()[name]
    dynamics, mechanism = RobotDynamics(case.robot()), case.task.mechanism
    q, v, a = rng.normal(size=(3, mechanism.n))
    mass, forces = mechanism.terms(q, v)
    torque = dynamics.inverse(q[None], v[None], a[None])[0]
    np.testing.assert_allclose(torque, mass @ a + forces, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize(
    "mechanism",
    [
        Separate((0.7, 2.0), (0.3, 0.0), (4.0, 0.0), (0.0, 3.0)),
        TwoLink(2.0, 0.8, 0.7, (0.3, 0.2), (9.0, 4.0)),
    ],
)
def test_derivatives_by_hand(mechanism: Mechanism, rng: np.random.Generator) -> None:
    x, u = rng.normal(size=4), rng.normal(size=2)
    f, by_x, by_u = linearized(mechanism, x, u)
    np.testing.assert_allclose(f, state_rate(mechanism, x, u), rtol=1e-12)

    def slope(function: Callable[[Array], Array], at: Array) -> Array:
        steps = 1e-6 * np.eye(at.size)
        columns = [(function(at + d) - function(at - d)) / 2e-6 for d in steps]
        return np.stack(columns, axis=1)

    np.testing.assert_allclose(
        by_x, slope(lambda y: state_rate(mechanism, y, u), x), atol=1e-7
    )
    np.testing.assert_allclose(
        by_u, slope(lambda y: state_rate(mechanism, x, y), u), atol=1e-7
    )


@pytest.mark.parametrize(
    ("minimum", "mechanism", "effort", "start", "goal", "structure"),
    [
        (
            rail_time(1.0, 5.0, 1.5, start_speed=0.3, end_speed=-0.4),
            Separate((2.0,)),
            (-3.0, 10.0),
            (0.0, 0.3),
            (1.0, -0.4),
            Structure("+", "1", (0.35, 1.65)),
        ),
        (
            rail_time(0.2, 5.0, start_speed=2.5),
            Separate((2.0,)),
            (-10.0, 10.0),
            (0.0, 2.5),
            (0.2, 0.0),
            Structure("-", "1", (0.75, 1.05)),
        ),
        (
            friction_time(1.0, 2.0, 5.0, 10.0, 3.0),
            Separate((2.0,), (5.0,)),
            (-3.0, 10.0),
            (0.0, 0.0),
            (1.0, 0.0),
            Structure("+", "1", (0.7, 1.2)),
        ),
    ],
    ids=["weak brake, moving ends", "past the goal", "friction"],
)
def test_closed_forms_agree_with_shooting(
    minimum: float,
    mechanism: Mechanism,
    effort: tuple[float, float],
    start: tuple[float, float],
    goal: tuple[float, float],
    structure: Structure,
) -> None:
    extremal = find_extremal(Task(mechanism, [effort], start, goal), structure)
    assert extremal.T == pytest.approx(minimum, rel=1e-9)
    assert extremal.wrong_sign < 1e-9


def test_friction_limits_of_the_closed_form() -> None:
    # Hardly any friction: the double integrator. Very much: terminal speed throughout,
    # but for braking from it in delay times log 2.
    assert friction_time(1.0, 2.0, 1e-5, 10.0) == pytest.approx(rail_time(1.0, 5.0))
    delay, terminal = 1e-3, 0.5
    exact = 1.0 / terminal + 2.0 * delay * np.log(2.0)
    found = friction_time(1.0, delay * 20.0, 20.0, terminal * 20.0)
    assert found == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize(
    ("family", "name"), names("pendulum", "swing", "level", "vertical")
)
def test_references_satisfy_the_maximum_principle(family: str, name: str) -> None:
    extremals = CASES[family][name].extremals
    assert len(extremals) >= 1
    for extremal in extremals:
        assert extremal.miss < 1e-9
        assert extremal.at_switches < 1e-4
        assert extremal.wrong_sign < 1e-4
        assert extremal.hamiltonian < 1e-3
        assert np.all(np.diff([0.0, *extremal.structure.times]) > 0.0)
    assert extremals[0].T == min(extremal.T for extremal in extremals)


def test_published_time() -> None:
    # As R. Luus and those after him found it, to their digits.
    assert CASES["level"]["Luus"].minimum == pytest.approx(2.98228, abs=5e-6)


# -- the library -----------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("family", "name"), names("rail", "weight"))
def test_constant_accelerations(family: str, name: str, method: str) -> None:
    solution = planned(family, name, method, INTERVALS)
    assert solution.status is tm.Status.CONVERGED
    assert excess(CASES[family][name], solution.T) < TOLERANCE


@pytest.mark.parametrize("method", ("collocation", "adjoint"))
@pytest.mark.parametrize(("family", "name"), names("friction", "pendulum"))
def test_friction_and_gravity(family: str, name: str, method: str) -> None:
    solution = planned(family, name, method, INTERVALS)
    assert solution.status is tm.Status.CONVERGED
    assert excess(CASES[family][name], solution.T) < TOLERANCE


# Torques that track a straight line lead elsewhere, the start of the paper not.
STARTS = {("vertical rods, payload, friction", "adjoint"): {"initial_duration": 1.5}}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "name", "method"),
    [
        (family, name, method)
        for family, name in names("level", "vertical")
        for method in ("collocation", "adjoint")
    ],
)
def test_two_links(family: str, name: str, method: str) -> None:
    options = STARTS.get((name, method), {})
    solution = planned(family, name, method, INTERVALS, **options)
    assert solution.success
    assert excess(CASES[family][name], solution.T) < TOLERANCE


@pytest.mark.parametrize(("family", "name"), names("swing"))
def test_swinging_up_by_default(family: str, name: str) -> None:
    # Where no path leads there, random torques do, if not always the fastest way.
    solution = planned(family, name, "auto", INTERVALS, effort="standard")
    minimum = CASES[family][name].minimum
    assert solution.success
    assert (1.0 - BELOW) * minimum <= solution.T <= 1.1 * minimum


@pytest.mark.parametrize("method", ("collocation", "adjoint"))
@pytest.mark.parametrize(("family", "name"), names("swing"))
def test_swinging_up(family: str, name: str, method: str) -> None:
    # Nothing leads the first guess to swing; up to 0.5 % for the coarse grid.
    solution = planned(family, name, method, INTERVALS)
    assert solution.success
    assert excess(CASES[family][name], solution.T) < 5.0 * TOLERANCE


@pytest.mark.parametrize(
    ("family", "name"),
    # Straight lines lead the last two elsewhere: to a saddle point, where no small
    # change helps to first order, and to a dead end.
    names(
        "friction",
        "pendulum",
        "level",
        without=("Van Willigenburg", "rods, moving ends"),
    ),
)
def test_inverse_is_of_first_order(family: str, name: str) -> None:
    case = CASES[family][name]
    solution = planned(family, name, "inverse", INTERVALS)
    assert solution.success
    assert excess(case, solution.T) < TOLERANCE + FIRST_ORDER / INTERVALS


@pytest.mark.parametrize(
    ("family", "name", "lower", "upper"),
    [
        ("friction", "rail, friction 5", 0.4, 0.6),
        ("pendulum", "pendulum, upright", 0.4, 0.6),
        ("level", "rods, friction", 0.4, 0.6),
        ("level", "Luus", 0.4, 0.6),
    ],
)
def test_halving_the_intervals(
    family: str, name: str, lower: float, upper: float
) -> None:
    case = CASES[family][name]
    options = {"refine": None, "control": "constant"}
    coarse, fine = (
        excess(case, planned(family, name, "inverse", intervals, **options).T)
        for intervals in (INTERVALS // 2, INTERVALS)
    )
    assert lower < fine / coarse < upper


REPLAYED = [
    ("rail", "rail, weak brake, speed limit"),
    ("rail", "rail, past the goal and back"),
    ("weight", "rail, upwards"),
    ("friction", "rail, friction 5"),
    ("friction", "rail, friction 50"),
    ("pendulum", "pendulum, upright, friction"),
    ("pendulum", "pendulum, moving ends"),
    ("level", "Luus"),
    ("level", "rods, friction"),
]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("family", "name"), REPLAYED)
def test_replay_ends_at_the_goal(family: str, name: str, method: str) -> None:
    case = CASES[family][name]
    trajectory = planned(family, name, method, INTERVALS).trajectory
    assert trajectory is not None
    position, velocity = np.split(replay(case.task, trajectory) - case.task.ends[1], 2)
    assert np.max(np.abs(position)) < 1e-4
    assert np.max(np.abs(velocity)) < 1e-4 * max(1.0, np.max(np.abs(trajectory.v)))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("family", "name"), REPLAYED)
def test_limits_hold_between_the_nodes(family: str, name: str, method: str) -> None:
    case = CASES[family][name]
    solution = planned(family, name, method, INTERVALS)
    assert solution.trajectory is not None
    states = solution.trajectory(np.linspace(0.0, solution.T, 2001))
    lower, upper = case.task.bounds.T
    share = np.abs(states.u - 0.5 * (lower + upper)) / (0.5 * (upper - lower))
    assert np.max(share) < 1.0 + 2.5e-3
    limit = solution.problem.robot.limits.velocity
    assert np.max(np.abs(states.v) / limit) < 1.0 + 1e-6


@pytest.mark.parametrize("method", METHODS)
def test_position_goal_of_two_rails(method: str) -> None:
    # Each coordinate is a rail of its own, and the slower one rules.
    robot = make_arm(
        slide(1.0), slide(2.0, (0.0, 1.0, 0.0)), effort=np.array([20.0, 10.0])
    )
    goal = tm.PositionGoal("tip", (0.5, 1.0, 0.0))
    solution = tm.plan(
        tm.Problem(robot, np.zeros(2), goal), tm.Options(method=method, grid="uniform")
    )
    assert solution.success
    assert solution.T == pytest.approx(rail_time(1.0, 5.0), rel=TOLERANCE)
