"""Plans against known minimum times: closed forms, and extremals found by shooting.

T has to match the minimum to 0.1 % with the methods that plan with torques
("collocation" and "adjoint"), and with "inverse" where a constant acceleration needs a
constant torque. Elsewhere the torque of "inverse" is below its limit for most of an
interval, and T approaches the minimum only like 1/N. No method may be faster than the
minimum.
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
# Accepted relative errors of goal and equations add up to this share of T.
BELOW = 1e-4
# T of "inverse" exceeds the minimum by at most this number over N, relatively.
FIRST_ORDER = 2.0
# The grid: intervals that are short at both ends if a mass is soon at full speed, and
# equal intervals if torques switch in between.
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
    """The solution of the library, from the first guess alone unless options ask for
    more.
    """
    usual = tm.Options(
        method=method,
        intervals=intervals,
        grid=GRIDS[family],
        effort="quick",
        max_planning_time=300.0,
    )
    return tm.plan(CASES[family][name].problem(), usual, **options)


def excess(case: Case, T: float) -> float:
    """Relative excess of T over the slowest known extremal that is not slower.

    A local method may end at a local optimum, which must then be a known extremal.
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
    """The final state under the torques of a motion, by the hand-written equations."""
    x = task.ends[0]
    n = task.mechanism.n
    # The friction relaxes a thousand times per interval, too fast for explicit methods.
    stiff = isinstance(task.mechanism, Separate) and max(task.mechanism.friction) > 10.0
    for begin, end in zip(trajectory.t[:-1], trajectory.t[1:], strict=True):
        # The torque may jump at the end, where its value belongs to the next interval.
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


# -- the reference solutions -----------------------------------------------------------


@pytest.mark.parametrize("name", all_cases())
def test_hand_written_equations_match_the_robot(
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
def test_hand_written_derivatives_match_differences(
    mechanism: Mechanism, rng: np.random.Generator
) -> None:
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


def test_closed_form_with_friction_has_the_right_limits() -> None:
    # With very little friction, the mass is a double integrator. With very much
    # friction, it has its terminal speed except while braking, for delay times log 2.
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


def test_time_of_luus_matches_its_publication() -> None:
    # The value of R. Luus and later authors, to their digits.
    assert CASES["level"]["Luus"].minimum == pytest.approx(2.98228, abs=5e-6)


# -- the library -----------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("family", "name"), names("rail", "weight"))
def test_plans_with_constant_accelerations_reach_the_minimum(
    family: str, name: str, method: str
) -> None:
    solution = planned(family, name, method, INTERVALS)
    assert solution.status is tm.Status.CONVERGED
    assert excess(CASES[family][name], solution.T) < TOLERANCE


@pytest.mark.parametrize("method", ("collocation", "adjoint"))
@pytest.mark.parametrize(("family", "name"), names("friction", "pendulum"))
def test_plans_with_friction_and_gravity_reach_the_minimum(
    family: str, name: str, method: str
) -> None:
    solution = planned(family, name, method, INTERVALS)
    assert solution.status is tm.Status.CONVERGED
    assert excess(CASES[family][name], solution.T) < TOLERANCE


# From torques that track a straight line, the descent ends at another optimum; from the
# initial iterate of the paper, it does not.
STARTS = {
    ("vertical rods, payload, friction", "adjoint"): {"initial_duration": 1.5},
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "name", "method"),
    [
        (family, name, method)
        for family, name in names("level", "vertical")
        for method in ("collocation", "adjoint")
    ],
)
def test_plans_of_two_links_reach_the_minimum(
    family: str, name: str, method: str
) -> None:
    options = {"intervals": INTERVALS} | STARTS.get((name, method), {})
    solution = planned(family, name, method, **options)
    assert solution.success
    assert excess(CASES[family][name], solution.T) < TOLERANCE


@pytest.mark.parametrize(("family", "name"), names("swing"))
def test_default_plan_swings_up_a_pendulum(family: str, name: str) -> None:
    # No path leads to the goal; random torques do, but not always the fastest way.
    solution = planned(family, name, "auto", INTERVALS, effort="standard")
    minimum = CASES[family][name].minimum
    assert solution.success
    assert (1.0 - BELOW) * minimum <= solution.T <= 1.1 * minimum


@pytest.mark.parametrize("method", ("collocation", "adjoint"))
@pytest.mark.parametrize(("family", "name"), names("swing"))
def test_swing_up_from_the_first_guess_reaches_the_minimum(
    family: str, name: str, method: str
) -> None:
    # The first guess does not swing; the coarse grid costs up to 0.5 %.
    solution = planned(family, name, method, INTERVALS)
    assert solution.success
    assert excess(CASES[family][name], solution.T) < 5.0 * TOLERANCE


@pytest.mark.parametrize(
    ("family", "name"),
    # From straight lines, the last two end elsewhere: at a saddle point, where no small
    # change helps to first order, and at a dead end.
    names(
        "friction",
        "pendulum",
        "level",
        without=("Van Willigenburg", "rods, moving ends"),
    ),
)
def test_excess_of_the_inverse_method_is_of_first_order(family: str, name: str) -> None:
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
def test_halving_the_intervals_halves_the_excess(
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
def test_replay_by_hand_written_equations_ends_at_the_goal(
    family: str, name: str, method: str
) -> None:
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
def test_two_rails_take_as_long_as_the_slower_rail(method: str) -> None:
    # Each coordinate is a rail of its own, and the slower rail determines T.
    robot = make_arm(
        slide(1.0), slide(2.0, (0.0, 1.0, 0.0)), effort=np.array([20.0, 10.0])
    )
    goal = tm.PositionGoal("tip", (0.5, 1.0, 0.0))
    solution = tm.plan(
        tm.Problem(robot, np.zeros(2), goal), tm.Options(method=method, grid="uniform")
    )
    assert solution.success
    assert solution.T == pytest.approx(rail_time(1.0, 5.0), rel=TOLERANCE)
