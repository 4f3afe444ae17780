"""A new limit is one class, which every part of the library uses: plans, replays,
files.
"""

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
    """The first position times the second velocity has a limit: |q1 v2|."""

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
    """A planar arm whose torques are the active limits."""
    robot = tm.load_robot("planar3r").with_changes(velocity=100.0)
    return tm.Problem(robot, START, tm.JointGoal(GOAL), constraints=constraints)


def planned(*constraints: tm.PathConstraint) -> tm.Solution:
    """The time-optimal motion with these constraints."""
    found = tm.plan(problem(*constraints), effort="quick")
    assert found.success, found.message
    return found


def largest_product(solution: tm.Solution) -> float:
    """The largest |q1 v2| at many instants."""
    assert solution.trajectory is not None
    motion = solution.trajectory
    states = motion(np.linspace(0.0, motion.duration, 20001))
    return float(np.max(np.abs(states.q[:, 0] * states.v[:, 1])))


@pytest.fixture(scope="module")
def free() -> tm.Solution:
    return planned()


@pytest.fixture(scope="module")
def limited() -> tm.Solution:
    return planned(PlaceTimesSpeed(MOST))


def test_plan_keeps_a_custom_constraint(
    free: tm.Solution, limited: tm.Solution
) -> None:
    assert largest_product(free) > 1.1 * MOST
    assert (
        0.98 * MOST < largest_product(limited) < MOST * (1.0 + tm.Tolerances().limits)
    )
    assert limited.T > 1.005 * free.T


def test_replay_finds_violations_of_a_custom_constraint(
    free: tm.Solution, limited: tm.Solution
) -> None:
    assert limited.verification is not None and limited.verification.ok
    verdict = tm.verify(limited.problem, free.trajectory)
    assert not verdict.ok
    (broken,) = verdict.violations
    assert (broken.kind, broken.name, broken.unit) == (
        "place times speed",
        "joints 1 and 2",
        "rad^2/s",
    )
    assert broken.amount == pytest.approx(largest_product(free) - MOST, rel=1e-3)
    assert "place times speed" in verdict.message


def test_certificate_has_multipliers_of_a_custom_constraint(
    free: tm.Solution, limited: tm.Solution
) -> None:
    assert limited.certificate.ok, limited.certificate.message
    (active,) = (
        item for item in limited.certificate.active if item.kind == "place times speed"
    )
    assert active.name == "joints 1 and 2"
    assert np.all(active.multiplier > 0.0)
    motion = limited.trajectory(0.5 * (active.begin + active.end))
    assert np.abs(motion.q[:, 0] * motion.v[:, 1]) == pytest.approx(MOST, rel=0.05)
    refused = tm.certify(limited.problem, free.trajectory)
    assert not refused.ok


def test_file_checks_find_violations_of_a_custom_constraint(
    free: tm.Solution, limited: tm.Solution, tmp_path: Path
) -> None:
    path = tmp_path / "motion.csv"
    limited.export(path)
    assert tm.check_export(limited, path).ok
    assert tm.check_file(limited.problem, path).ok
    free.export(path)
    for found in (tm.check_export(limited, path), tm.check_file(limited.problem, path)):
        assert [item.kind for item in found.violations] == ["place times speed"]


def test_sensitivity_to_a_custom_constraint_matches_differences(
    limited: tm.Solution,
) -> None:
    (found,) = limited.sensitivities.of("place times speed")
    assert (found.limit, found.limit_unit) == (MOST, "rad^2/s")
    less, more = (planned(PlaceTimesSpeed(c * MOST)).T for c in (0.97, 1.03))
    slope = np.log(more / less) / np.log(1.03 / 0.97)
    assert found.value == pytest.approx(slope, rel=0.1)


def test_custom_constraint_survives_saving_and_loading(
    limited: tm.Solution, tmp_path: Path
) -> None:
    path = tmp_path / "cell.toml"
    tm.save_scenario(path, limited.problem, limited.options)
    assert 'type = "place_times_speed"' in path.read_text()
    read = tm.load_scenario(path).problem
    assert read.constraints == limited.problem.constraints


# -- a limit of motors -----------------------------------------------------------------


class PowerLimit(LimitKind):
    """The power of a motor has a limit: |u v| [W]."""

    def excess(
        self, bound: Any, u: Array, v: Array, side: float
    ) -> tuple[Array, Array, Array]:
        """Power beyond the limit, and its derivatives."""
        return side * u * v - bound, side * v, side * u


@dataclass(frozen=True, eq=False)
class Limits(tm.MotionLimits):
    """Motion limits with a limit of the power."""

    power: Any = field(
        default=None, metadata={"kind": PowerLimit("power", ("W", "W"), "uv", 3)}
    )


WATTS = 20.0


def planned_with_power(watts: float) -> tm.Solution:
    """The time-optimal motion of the arm with a limited power of the first motor."""
    limits = Limits(power={"joint1": watts})
    found = tm.plan(replace(problem(), motion_limits=limits), effort="quick")
    assert found.success, found.message
    return found


def largest_power(solution: tm.Solution) -> float:
    """The largest power of the first motor at many instants."""
    motion = solution.trajectory
    states = motion(np.linspace(0.0, motion.duration, 20001))
    return float(np.max(np.abs(states.u[:, 0] * states.v[:, 0])))


def test_custom_motion_limit_is_used_by_every_part(
    free: tm.Solution, tmp_path: Path
) -> None:
    limited = planned_with_power(WATTS)
    assert largest_power(free) > 1.2 * WATTS
    assert (
        0.98 * WATTS < largest_power(limited) < WATTS * (1.0 + tm.Tolerances().limits)
    )
    verdict = tm.verify(limited.problem, free.trajectory)
    (broken,) = verdict.violations
    assert (broken.kind, broken.name, broken.unit) == ("power", "joint1", "W")
    assert broken.amount == pytest.approx(largest_power(free) - WATTS, rel=1e-3)
    assert "joint joint1 is" in verdict.message
    assert limited.certificate.ok, limited.certificate.message
    (active,) = (item for item in limited.certificate.active if item.kind == "power")
    assert active.name == "joint1"
    assert not tm.certify(limited.problem, free.trajectory).ok
    free.export(tmp_path / "motion.csv")
    found = tm.check_export(limited, tmp_path / "motion.csv")
    assert [item.kind for item in found.violations] == ["power"]
    (worth,) = limited.sensitivities.of("power")
    assert (worth.limit, worth.limit_unit) == (WATTS, "W")
    less, more = (planned_with_power(c * WATTS).T for c in (0.97, 1.03))
    slope = np.log(more / less) / np.log(1.03 / 0.97)
    assert worth.value == pytest.approx(slope, rel=0.1)
    assert limited.sensitivities.balance == pytest.approx(0.0, abs=0.02)
    tm.save_scenario(tmp_path / "cell.toml", limited.problem)
    read = tm.load_scenario(tmp_path / "cell.toml").problem
    assert read.motion_limits == limited.problem.motion_limits


def test_message_names_the_unit_of_a_limit_once() -> None:
    with pytest.raises(tm.ProblemError, match=r"expected positive numbers \[W\]"):
        Limits(power=-1.0)


@dataclass(frozen=True, eq=False)
class CountedLimits(tm.MotionLimits):
    """Motion limits with a limit of the power that counts as a limit of the speed."""

    counted_power: Any = field(
        default=None,
        metadata={"kind": PowerLimit("counted", ("W", "W"), "uv", 3, "velocity")},
    )


def test_custom_motion_limit_counts_as_part_of_another_kind(free: tm.Solution) -> None:
    limits = CountedLimits(counted_power={"joint1": WATTS})
    verdict = tm.verify(replace(problem(), motion_limits=limits), free.trajectory)
    (broken,) = verdict.violations
    assert (broken.kind, broken.name) == ("velocity", "joint1")
    assert broken.amount == pytest.approx(largest_power(free) - WATTS, rel=1e-3)


# -- a limit of several motors together ------------------------------------------------


@record
class SummedPower(LimitOfTwoJoints):
    """The power of the first two motors together has a limit."""

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


def largest_summed_power(solution: tm.Solution) -> float:
    """The largest summed power at many instants."""
    assert solution.trajectory is not None
    motion = solution.trajectory
    states = motion(np.linspace(0.0, motion.duration, 20001))
    power = (states.u * states.v)[:, :2].sum(axis=1)
    return float(np.max(np.abs(power)))


@pytest.mark.parametrize("method", ["inverse", "collocation"])
def test_custom_constraint_of_torques_is_used_by_every_part(
    free: tm.Solution, method: str, tmp_path: Path
) -> None:
    most = 0.6 * largest_summed_power(free)
    with_limit = problem(SummedPower(most))
    limited = tm.plan(with_limit, method=method)
    assert limited.success, limited.message
    assert (
        0.98 * most
        < largest_summed_power(limited)
        < most * (1.0 + tm.Tolerances().limits)
    )
    assert limited.T > 1.005 * free.T
    verdict = tm.verify(with_limit, free.trajectory)
    (broken,) = verdict.violations
    assert (broken.kind, broken.unit) == ("summed power", "W")
    assert broken.amount == pytest.approx(largest_summed_power(free) - most, rel=1e-3)
    assert limited.certificate.ok, limited.certificate.message
    assert "summed power" in {item.kind for item in limited.certificate.active}
    tm.save_scenario(tmp_path / "cell.toml", with_limit)
    read = tm.load_scenario(tmp_path / "cell.toml").problem
    assert read.constraints == with_limit.constraints
