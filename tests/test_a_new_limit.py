"""A limit that exists nowhere else is one class, and known wherever limits are."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.arrays import Array, record
from tominpmp.constraints.path import Linear
from tominpmp.dynamics import RobotDynamics
from tominpmp.motion_limits import LimitKind

START, GOAL = (0.5, 1.7, -1.7), (1.6, 0.4, -0.6)
MOST = 3.0


@record
class LimitOfTwoJoints(tm.PathConstraint):
    """A limit on the first two joints together.

    Attributes:
        most: The limit.
    """

    most: float

    subject = "joints 1 and 2"
    curable = True

    @property
    def largest(self) -> float:
        """The limit."""
        return self.most

    def validate(self, robot: tm.Robot) -> None:
        """Check that there are two joints."""
        assert robot.n >= 2


@record
class PlaceTimesSpeed(LimitOfTwoJoints):
    """The first position times the second velocity stays within a limit: |q1 v2|."""

    name = "place times speed"
    unit = "rad^2/s"
    order = 1

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """|q1 v2|."""
        return np.abs(q[:, 0] * v[:, 1])

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Q1 v2 and its derivatives."""
        by_q, by_v = np.zeros((2, len(q), 1, q.shape[1]))
        by_q[:, 0, 0], by_v[:, 0, 1] = v[:, 1], q[:, 0]
        return q[:, :1] * v[:, 1:2], by_q, by_v, np.zeros(0)


def problem(*constraints: tm.PathConstraint) -> tm.Problem:
    """An arm in a plane, whose torques rule."""
    robot = tm.load_robot("planar3r").with_changes(velocity=100.0)
    return tm.Problem(robot, START, tm.JointGoal(GOAL), constraints=constraints)


def planned(*constraints: tm.PathConstraint) -> tm.Solution:
    """Its fastest motion."""
    found = tm.plan(problem(*constraints), effort="quick")
    assert found.success, found.message
    return found


def most_of(solution: tm.Solution) -> float:
    """The largest |q1 v2| of many instants."""
    assert solution.trajectory is not None
    motion = solution.trajectory
    states = motion(np.linspace(0.0, motion.duration, 20001))
    return float(np.max(np.abs(states.q[:, 0] * states.v[:, 1])))


@pytest.fixture(scope="module")
def free() -> tm.Solution:
    return planned()


@pytest.fixture(scope="module")
def held() -> tm.Solution:
    return planned(PlaceTimesSpeed(MOST))


def test_it_is_planned_with(free: tm.Solution, held: tm.Solution) -> None:
    assert most_of(free) > 1.1 * MOST
    assert 0.98 * MOST < most_of(held) < MOST * (1.0 + tm.Tolerances().limits)
    assert held.T > 1.005 * free.T


def test_a_replay_finds_what_breaks_it(free: tm.Solution, held: tm.Solution) -> None:
    assert held.verification is not None and held.verification.ok
    judged = tm.verify(held.problem, free.trajectory)
    assert not judged.ok
    (broken,) = judged.violations
    assert (broken.kind, broken.name, broken.unit) == (
        "place times speed",
        "joints 1 and 2",
        "rad^2/s",
    )
    assert broken.amount == pytest.approx(most_of(free) - MOST, rel=1e-3)
    assert "place times speed" in judged.message


def test_it_has_a_multiplier_where_it_holds(
    free: tm.Solution, held: tm.Solution
) -> None:
    assert held.certificate.ok, held.certificate.message
    (active,) = (
        item for item in held.certificate.active if item.kind == "place times speed"
    )
    assert active.name == "joints 1 and 2"
    assert np.all(active.multiplier > 0.0)
    motion = held.trajectory(0.5 * (active.begin + active.end))
    assert np.abs(motion.q[:, 0] * motion.v[:, 1]) == pytest.approx(MOST, rel=0.05)
    refused = tm.certify(held.problem, free.trajectory)
    assert not refused.ok


def test_a_file_that_breaks_it_is_found(
    free: tm.Solution, held: tm.Solution, tmp_path: Path
) -> None:
    path = tmp_path / "motion.csv"
    held.export(path)
    assert tm.check_export(held, path).ok
    assert tm.check_file(held.problem, path).ok
    free.export(path)
    for found in (tm.check_export(held, path), tm.check_file(held.problem, path)):
        assert [item.kind for item in found.violations] == ["place times speed"]


def test_it_is_among_the_sensitivities(held: tm.Solution) -> None:
    (found,) = held.sensitivities.of("place times speed")
    assert (found.limit, found.limit_unit) == (MOST, "rad^2/s")
    less, more = (planned(PlaceTimesSpeed(c * MOST)).T for c in (0.97, 1.03))
    slope = np.log(more / less) / np.log(1.03 / 0.97)
    assert found.value == pytest.approx(slope, rel=0.1)


def test_it_is_read_from_a_file(held: tm.Solution, tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    tm.save_scenario(path, held.problem, held.options)
    assert 'type = "place_times_speed"' in path.read_text()
    read = tm.load_scenario(path).problem
    assert read.constraints == held.problem.constraints


# -- a limit of motors -----------------------------------------------------------------


class PowerLimit(LimitKind):
    """The power of a motor stays within a limit: |u v| [W]."""

    def excess(
        self, bound: Any, u: Array, v: Array, side: float
    ) -> tuple[Array, Array, Array]:
        """Power beyond the limit, and its derivatives."""
        return side * u * v - bound, side * v, side * u


@dataclass(frozen=True, eq=False)
class Limits(tm.MotionLimits):
    """Motion limits with one of the power."""

    power: Any = field(
        default=None, metadata={"kind": PowerLimit("power", ("W", "W"), "uv", 3)}
    )


WATTS = 20.0


def powered(watts: float) -> tm.Solution:
    """The fastest motion of the arm, the motor of whose first joint is weak."""
    limits = Limits(power={"joint1": watts})
    found = tm.plan(replace(problem(), motion_limits=limits), effort="quick")
    assert found.success, found.message
    return found


def power_of(solution: tm.Solution) -> float:
    """The largest power of the first motor, of many instants."""
    motion = solution.trajectory
    states = motion(np.linspace(0.0, motion.duration, 20001))
    return float(np.max(np.abs(states.u[:, 0] * states.v[:, 0])))


def test_a_limit_of_motors_is_one_class(free: tm.Solution, tmp_path: Path) -> None:
    held = powered(WATTS)
    assert power_of(free) > 1.2 * WATTS
    assert 0.98 * WATTS < power_of(held) < WATTS * (1.0 + tm.Tolerances().limits)
    judged = tm.verify(held.problem, free.trajectory)
    (broken,) = judged.violations
    assert (broken.kind, broken.name, broken.unit) == ("power", "joint1", "W")
    assert broken.amount == pytest.approx(power_of(free) - WATTS, rel=1e-3)
    assert "joint joint1 is" in judged.message
    assert held.certificate.ok, held.certificate.message
    (active,) = (item for item in held.certificate.active if item.kind == "power")
    assert active.name == "joint1"
    assert not tm.certify(held.problem, free.trajectory).ok
    free.export(tmp_path / "motion.csv")
    found = tm.check_export(held, tmp_path / "motion.csv")
    assert [item.kind for item in found.violations] == ["power"]
    (worth,) = held.sensitivities.of("power")
    assert (worth.limit, worth.limit_unit) == (WATTS, "W")
    less, more = (powered(c * WATTS).T for c in (0.97, 1.03))
    slope = np.log(more / less) / np.log(1.03 / 0.97)
    assert worth.value == pytest.approx(slope, rel=0.1)
    assert held.sensitivities.balance == pytest.approx(0.0, abs=0.02)
    tm.save_scenario(tmp_path / "cell.toml", held.problem)
    read = tm.load_scenario(tmp_path / "cell.toml").problem
    assert read.motion_limits == held.problem.motion_limits


# -- a limit of several motors together ------------------------------------------------


@record
class SummedPower(LimitOfTwoJoints):
    """The power of the first two motors together stays within a limit."""

    name = "summed power"
    unit = "W"
    order = 2

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """|u1 v1 + u2 v2|."""
        return np.abs(self.vector_rows(q, v, a)[0][:, 0])

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """The summed power and its derivatives."""
        by = RobotDynamics(self.kinematics.robot).inverse_jacobians(q, v, a)
        u, w = by.tau[:, None].copy(), v[:, None].copy()
        u[:, :, 2:] = w[:, :, 2:] = 0.0
        by_q, by_v, by_a = (w @ part for part in (by.tau_q, by.tau_v, by.tau_a))
        return np.sum(u * w, axis=2), by_q, by_v + u, by_a


def summed_power_of(solution: tm.Solution) -> float:
    """The largest summed power of many instants."""
    assert solution.trajectory is not None
    motion = solution.trajectory
    states = motion(np.linspace(0.0, motion.duration, 20001))
    power = (states.u * states.v)[:, :2].sum(axis=1)
    return float(np.max(np.abs(power)))


@pytest.mark.parametrize("method", ["inverse", "collocation"])
def test_a_limit_of_several_motors_is_one_class(
    free: tm.Solution, method: str, tmp_path: Path
) -> None:
    most = 0.7 * summed_power_of(free)
    asked = problem(SummedPower(most))
    held = tm.plan(asked, method=method)
    assert held.success, held.message
    assert 0.98 * most < summed_power_of(held) < most * (1.0 + tm.Tolerances().limits)
    assert held.T > 1.005 * free.T
    judged = tm.verify(asked, free.trajectory)
    (broken,) = judged.violations
    assert (broken.kind, broken.unit) == ("summed power", "W")
    assert broken.amount == pytest.approx(summed_power_of(free) - most, rel=1e-3)
    assert held.certificate.ok, held.certificate.message
    assert "summed power" in {item.kind for item in held.certificate.active}
    tm.save_scenario(tmp_path / "cell.toml", asked)
    read = tm.load_scenario(tmp_path / "cell.toml").problem
    assert read.constraints == asked.constraints
