"""Exact switching, against minimum times that are known without the library."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import numpy as np
import pytest
from clocks import Clock
from optimum_cases import DOWNWARD, GRAVITY, HANGING, ROD, Case
from sample_arms import make_arm, slide
from scipy.optimize import OptimizeResult, minimize
from two_link_cases import CASES, all_cases

import tominpmp as tm
from tominpmp.dynamics import RobotDynamics
from tominpmp.exact import switching_refinement as exact
from tominpmp.exact import switching_times
from tominpmp.exact.shooting import CLEARANCE, ArcProgram
from tominpmp.exact.structure import Arcs, read_arcs
from tominpmp.exact.switching_functions import torque_slopes
from tominpmp.exact.switching_times import EXACT, refine_arcs, solve_lengths
from tominpmp.stopping import Budget
from tominpmp.transcription.problem_functions import ProblemFunctions

TOLERANCE = 1e-5
BELOW = 1e-6
# One case of each family; the others are in benchmarks/known_optima.py. The first guess
# alone need not lead to the fastest of several local optima.
QUICK = (
    ("rail", "rail, weak brake, speed limit"),
    ("weight", "two rails"),
    ("friction", "rail, friction 5"),
    ("pendulum", "pendulum, lift, friction"),
    ("level", "rods, friction"),
    ("vertical", "vertical rods"),
)


@cache
def refined(family: str, name: str, starts: int | None = 1) -> tm.Solution:
    options = tm.Options(refine="switching", starts=starts)
    return tm.plan(CASES[family][name].problem(), options)


def known_durations(case: Case) -> list[float]:
    """Durations of all known extremals, the fastest first."""
    return [case.minimum, *(extremal.T for extremal in case.extremals[1:])]


@pytest.mark.parametrize(("family", "name"), QUICK)
def test_duration_is_that_of_an_extremal(family: str, name: str) -> None:
    solution = refined(family, name)
    assert solution.success, solution.message
    times = known_durations(CASES[family][name])
    assert times[0] * (1.0 - BELOW) < solution.T
    assert min(abs(solution.T / T - 1.0) for T in times) < TOLERANCE


def test_faster_order_of_the_switches_is_found() -> None:
    """The first guess leads to a slower order of the switches."""
    case = CASES["level"]["Van Willigenburg"]
    solution = refined("level", "Van Willigenburg", None)
    assert solution.success
    assert abs(solution.T / case.minimum - 1.0) < TOLERANCE


def test_torques_switch_between_their_limits() -> None:
    """Torques switch when the extremal's do, and are at their limits in between."""
    solution = refined("level", "rods, friction")
    case, motion = CASES["level"]["rods, friction"], solution.trajectory
    assert motion is not None
    middles = 0.5 * (motion.t[1:] + motion.t[:-1])
    share = motion(middles).u / np.array([10.0, 5.0])
    np.testing.assert_allclose(np.abs(share), 1.0, atol=1e-9)
    flips = np.flatnonzero(np.any(np.diff(np.sign(share), axis=0) != 0, axis=1))
    expected = case.structures[0].times[:-1]
    np.testing.assert_allclose(motion.t[flips + 1], expected, atol=2e-5)


def test_certificate_of_a_refined_motion_is_accurate() -> None:
    """The Hamiltonian is constant, unlike that of a motion on a grid."""
    found = refined("vertical", "vertical rods").certificate
    assert found is not None
    assert found.ok, found.message
    assert found.stationarity < 1e-4
    assert found.saturated_share > 0.999


def test_speed_limit_is_kept_exactly() -> None:
    solution = refined("rail", "rail, weak brake, speed limit")
    assert solution.trajectory is not None
    fastest = np.max(np.abs(solution.trajectory.sample(1e-3).v))
    assert fastest == pytest.approx(1.0, abs=1e-6)


def test_exact_switching_does_not_lengthen_the_motion() -> None:
    case = CASES["level"]["rods, friction"]
    rough = tm.plan(case.problem(), tm.Options(starts=1, control="constant"))
    solution = refined("level", "rods, friction")
    assert solution.T <= rough.T * (1.0 + 1e-6)


def test_replay_of_a_refined_motion_ends_at_the_goal() -> None:
    """Integrated independently, the torques end at the goal: arcs are not too short."""
    solution = refined("vertical", "vertical rods")
    assert solution.verification is not None
    end = solution.verification.replay
    expected = CASES["vertical"]["vertical rods"].task.ends[1]
    found = np.concatenate([end.q[-1], end.v[-1]])
    np.testing.assert_allclose(found, expected, atol=2e-6)


def test_passive_joint_keeps_its_motion_at_the_time_limit(clock: Clock) -> None:
    """A cart with a free pole, refined from the states and torques of collocation.

    The planning time ends in the middle of the refinement on every machine.
    """
    effort = np.array([20.0, 0.0])
    robot = make_arm(slide(1.0), ROD, effort=effort, gravity=DOWNWARD)
    problem = tm.Problem(robot, [0.0, HANGING], tm.JointGoal([0.3, HANGING]))
    rough = tm.plan(problem, tm.Options(starts=1))
    clock.tick = 1.0
    options = tm.Options(starts=1, refine="switching", max_planning_time=700.0)
    solution = tm.plan(problem, options)
    assert rough.success
    assert solution.status is tm.Status.TIME_LIMIT
    assert solution.success, solution.message
    assert solution.T <= rough.T * (1.0 + 0.02)


@pytest.mark.parametrize(
    ("choice", "word"),
    [
        ({"refine": "switching", "control": "linear"}, "'linear'"),
        ({"refine": "grid", "method": "adjoint"}, "'adjoint'"),
    ],
)
def test_message_names_the_option_that_prevents_refinement(
    choice: dict[str, Any], word: str
) -> None:
    """The plan returns the motion without refinement, and its message says why."""
    problem = CASES["rail"]["rail"].problem()
    choice = {"max_iterations": 12, **choice}
    options = tm.Options(**choice)
    plain = tm.Options(**(choice | {"refine": None}))
    solution, same = tm.plan(problem, options), tm.plan(problem, plain)
    assert solution.success is same.success
    assert solution.T <= same.T * (1.0 + 1e-12)
    if solution.success:
        assert re.search("not refined|not placed exactly", solution.message)
        assert word in solution.message


def test_motions_of_other_methods_are_refined() -> None:
    problem = CASES["rail"]["rail"].problem()
    for method in ("collocation", "adjoint", "penalty"):
        solution = tm.plan(problem, method=method, refine="switching", starts=1)
        assert solution.T == pytest.approx(CASES["rail"]["rail"].minimum, rel=1e-9)


def test_failed_exact_switching_keeps_the_motion_on_the_grid(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No arcs are found: the motion on the grid is returned, with a message."""
    monkeypatch.setattr(exact, "refine_arcs", lambda *arguments: None)
    problem = CASES["level"]["rods, friction"].problem()
    grid = tm.Options(starts=1, refine="grid", control="constant")
    plain = tm.plan(problem, grid)
    options = tm.Options(starts=1, refine="switching", control="constant")
    solution = tm.plan(problem, options)
    assert solution.success
    assert solution.T == pytest.approx(plain.T, rel=1e-5)
    assert "the motion on the grid was kept" in solution.message


@pytest.mark.parametrize("limit", [350.0, 600.0])
def test_time_limit_keeps_a_verified_motion(clock: Clock, limit: float) -> None:
    """Without a limit, the plan would read the clock a thousand times, 1 s each."""
    clock.tick = 1.0
    case = all_cases()["vertical rods"]
    options = tm.Options(refine="switching", max_planning_time=limit)
    solution = tm.plan(case.problem(), options)
    assert solution.status is tm.Status.TIME_LIMIT
    assert solution.success
    assert solution.T >= case.minimum * (1.0 - BELOW)


def test_position_goal_of_a_planar_arm_is_refined() -> None:
    """The tip of a planar arm has a constant height: its equation is singular."""
    robot = CASES["level"]["rods"].robot()
    reached = np.array([np.cos(0.9) + np.cos(0.6), np.sin(0.9) + np.sin(0.6), 0.0])
    goal = tm.PositionGoal("tip", reached)
    problem = tm.Problem(robot, [-0.4, 0.6], goal)
    solution = tm.plan(problem, tm.Options(refine="switching", starts=1))
    assert solution.success
    assert "on the grid" not in solution.message
    found = solution.certificate
    assert found is not None
    assert found.stationarity < 1e-4


# -- arcs ------------------------------------------------------------------------------


def rail_system() -> ProblemFunctions:
    return ProblemFunctions.of(CASES["rail"]["rail"].problem())


def arcs(lengths: list[float], levels: list[float]) -> Arcs:
    shape = (len(lengths), 1)
    none = np.zeros(shape, dtype=np.int64)
    column = np.array(levels)[:, None]
    return Arcs(np.array(lengths), column, none != 0, none, none != 0)


def states_at_rest(times: np.ndarray) -> np.ndarray:
    """States of a rail at rest at its start."""
    return np.zeros((times.size, 2))


def test_arc_lengths_of_a_rail_are_those_of_the_closed_form() -> None:
    system = rail_system()
    found = solve_lengths(
        system, arcs([0.3, 0.8], [1.0, -1.0]), states_at_rest, Budget()
    )
    assert found is not None
    assert found.feasible
    np.testing.assert_allclose(found.arcs.lengths, np.sqrt(1 / 5.0), rtol=1e-9)


def test_motion_of_arcs_is_the_same_at_every_call() -> None:
    """Its weights of interpolation were summed in a random order."""
    system = rail_system()
    held = arcs([0.1, 0.12], [0.5, -0.4])
    held.held[1], held.follows[1] = 1, True
    program = ArcProgram(system, held, np.array([5, 5]))
    motions = [program.trajectory(program.pack()) for _ in range(80)]
    assert len({motion.q.tobytes() for motion in motions}) == 1


def test_best_iterate_of_slsqp_is_used(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The best iterate of SLSQP counts, not the last one, which may be infeasible."""

    def with_a_worse_last_iterate(
        *args: object, callback: Any, **settings: object
    ) -> OptimizeResult:
        found = minimize(*args, callback=callback, **settings)
        return minimize(lambda y: -found.x @ y, 1.1 * found.x, callback=callback)

    monkeypatch.setattr(switching_times, "minimize", with_a_worse_last_iterate)
    rough = arcs([0.3, 0.8], [1.0, -1.0])
    found = solve_lengths(rail_system(), rough, states_at_rest, Budget())
    assert found is not None
    assert found.feasible


def test_superfluous_arcs_vanish() -> None:
    system = rail_system()
    rough = arcs([0.1, 0.2, 0.3, 0.4], [-1.0, 1.0, -1.0, 1.0])
    found = refine_arcs(system, rough, states_at_rest, Budget())
    assert found is not None
    assert found.duration == pytest.approx(2 * np.sqrt(1 / 5.0), rel=1e-8)
    assert found.arcs.cleaned().count == 2


def test_arcs_that_miss_the_goal_are_infeasible() -> None:
    """One arc of full force ends at full speed, not at rest."""
    system = rail_system()
    found = solve_lengths(system, arcs([1.0], [1.0]), states_at_rest, Budget())
    assert found is None or not found.feasible


def test_used_up_budget_ends_the_solve_for_arc_lengths() -> None:
    system = rail_system()
    rough = arcs([0.3, 0.8], [1.0, -1.0])
    assert solve_lengths(system, rough, states_at_rest, Budget(seconds=-1.0)) is None


def test_derivatives_of_shooting_match_finite_differences(
    rng: np.random.Generator,
) -> None:
    """Derivatives of end and limits; one joint is held on one of the arcs."""
    case = all_cases()["vertical rods, friction"]
    system = ProblemFunctions.of(case.problem())
    levels = np.array([[0.5, -0.4], [0.3, 0.0], [-0.2, 0.6]])
    held = np.array([[0, 0], [0, 1], [0, 0]])
    rough = Arcs(np.array([0.1, 0.15, 0.1]), levels, held == 0, held, held != 0)
    program = ArcProgram(system, rough, np.array([4, 4, 4]))
    y = program.pack()
    first = program.shoot(y)
    assert first is not None
    program.watch(program.nearby(first.motion, 2.0))
    shot, step = program.shoot(y), 1e-6
    assert shot is not None
    assert shot.margin.size > 10
    for column in range(program.size):
        ends = []
        for sign in (1, -1):
            z = y.copy()
            z[column] += sign * step
            other = program.shoot(z)
            assert other is not None
            ends.append(other.rows.value)
        slope = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(shot.slopes[:, column], slope, rtol=1e-5, atol=1e-6)


def test_switching_functions_include_clearances_and_goal_regions(
    rng: np.random.Generator,
) -> None:
    """Regression: without their multipliers, the predicted gains were wrong."""
    ball = tm.Sphere("O", radius=0.8, position=(4.0, 0.0, 0.0))
    corner = tm.PositionGoal("tip", (4.0, 1.0, 0.0), tolerance=0.01)
    arm, start = tm.load_robot("planar3r"), (0.5, 1.7, -1.7)
    system = ProblemFunctions.of(tm.Problem(arm, start, corner, [ball]))
    held = np.zeros((3, 3), dtype=int)
    levels = rng.uniform(-0.5, 0.5, (3, 3))
    rough = Arcs(np.full(3, 0.1), levels, held == 0, held, held != 0)
    program = ArcProgram(system, rough, np.array([4, 5, 6]))
    y = program.pack()
    first = program.shoot(y)
    assert first is not None
    program.watch(program.nearby(first.motion, 2.0))
    shot = program.shoot(y)
    assert shot is not None
    assert shot.margin.size > program.watched.kind.size > 10
    assert CLEARANCE in program.watched.kind
    weights = rng.normal(size=shot.rows.value.size)
    by_unknowns = weights @ shot.slopes
    slopes = torque_slopes(program, shot, weights) / program.duration
    by_arcs = np.add.reduceat(slopes, [0, 4, 9])
    np.testing.assert_allclose(by_arcs.ravel(), by_unknowns[3:], rtol=1e-9, atol=1e-9)


def test_arcs_are_read_from_a_bang_bang_motion() -> None:
    """In the interval of the switch, the torque lies between its limits."""
    h = np.full(10, 0.1)
    shares = np.array([1.0] * 4 + [0.5] + [-1.0] * 5)[:, None]
    found = read_arcs(h, shares, np.zeros((11, 1)), np.array([True]))
    np.testing.assert_allclose(found.lengths, [0.475, 0.525], atol=1e-12)
    np.testing.assert_allclose(found.levels[:, 0], [1.0, -1.0])


def test_held_joint_keeps_its_velocity() -> None:
    case = all_cases()["vertical rods"]
    system = ProblemFunctions.of(case.problem())
    held = np.array([[0, 1]])
    levels = np.array([[0.7, 0.0]])
    rough = Arcs(np.array([0.2]), levels, held == 2, held, held != 0)
    shot = ArcProgram(system, rough, np.array([8])).shoot(np.array([1.0]))
    assert shot is not None
    v = shot.motion.x[:, 3]
    np.testing.assert_allclose(v, v[0], atol=1e-12)
    # The torque that holds the joint is that of the inverse dynamics.
    x, rates = shot.motion.x[-1], shot.motion.rates
    dynamics = RobotDynamics(case.robot())
    tau = dynamics.inverse(x[None, :2], x[None, 2:], rates.f[-1:, 2:])[0]
    np.testing.assert_allclose(rates.tau[-1], tau, rtol=1e-9)
    assert tau[0] == pytest.approx(0.7 * 40.0, rel=1e-9)
    assert EXACT < 1e-6 < GRAVITY
