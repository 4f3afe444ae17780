"""A new kind of goal is one class, which plans, lower bounds and replays use."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.arrays import Array, Record
from tominpmp.goals.base import Goal
from tominpmp.goals.place import Label, Place
from tominpmp.kinematics import RobotKinematics

Q_START = np.array([0.3, 0.5, -0.4])


@dataclass(frozen=True, eq=False)
class HeightGoal(Record, Goal):
    """Bring a frame to a height; its other coordinates and its orientation are free.

    Attributes:
        frame: Name of the frame.
        height: Along the y axis, in which a planar arm hangs [m].
    """

    frame: str
    height: float

    def validate(self, robot: tm.Robot) -> None:
        """Check that the frame exists."""
        robot.frame_id(self.frame)

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Height of the frame above the goal [m]."""
        value = kinematics.placement(q, self.frame).translation[1:2] - self.height
        by_q = kinematics.jacobian(q, self.frame)[1:2]
        zero = np.zeros(1)
        return Place(value, by_q, zero, zero, (Label(f"frame {self.frame}", "m"),))

    @property
    def frame_name(self) -> str:
        """The frame."""
        return self.frame

    def distances(self, points: Array) -> Array:
        """Distances of points from the plane, shape (m, 3) to (m,)."""
        return np.abs(points[:, 1] - self.height)


@pytest.mark.parametrize("method", ["inverse", "collocation", "adjoint"])
@pytest.mark.parametrize("control", ["constant", "linear"])
def test_goal_class_of_a_caller_is_planned_and_bounded(
    planar3r: tm.Robot, method: str, control: str
) -> None:
    if control == "linear" and method != "inverse":
        pytest.skip("linear accelerations belong to the inverse method")
    problem = tm.Problem(planar3r, Q_START, HeightGoal("tip", 1.5))
    few = {"effort": "quick", "intervals": 24, "refine": None}
    solution = tm.plan(problem, method=method, control=control, **few)
    assert solution.success, solution.message
    assert solution.trajectory is not None
    end = RobotKinematics(planar3r).placement(solution.trajectory.q[-1], "tip")
    assert end.translation[1] == pytest.approx(1.5, abs=1e-5)
    assert 0.0 < tm.lower_bound(problem).T <= solution.T


class SlowingGoal(HeightGoal):
    """A height at which the arm stops, with a velocity residual of its own."""

    def motion_residual(
        self, kinematics: RobotKinematics, q: Array, v: Array
    ) -> tuple[Array, Array, Array]:
        """Twice the velocities."""
        return 2.0 * v, np.zeros((v.size, v.size)), 2.0 * np.eye(v.size)


def test_via_point_of_a_caller_is_passed_at_any_velocity(planar3r: tm.Robot) -> None:
    segments = [
        tm.Segment(SlowingGoal("tip", 1.5)),
        tm.Segment(SlowingGoal("tip", 1.8), stop=True),
        tm.Segment(tm.JointGoal(Q_START)),
    ]
    problem = tm.Problem(planar3r, Q_START, segments=segments)
    kinematics, counts = RobotKinematics(planar3r), list[int]()
    for phase in problem.phases[:2]:
        goal = phase.goal
        counts.append(goal.residual(kinematics, Q_START, Q_START).value.size)
        assert len(goal.labels(kinematics)) == counts[-1]
        assert goal.misses(kinematics, Q_START, Q_START)
    assert counts == [1, 4]


def test_errors_on_a_goal_class_of_a_caller_name_frame_and_type(
    planar3r: tm.Robot,
) -> None:
    high = tm.Problem(planar3r, Q_START, HeightGoal("tip", 50.0))
    with pytest.raises(tm.ProblemError, match="brings frame 'tip' there"):
        tm.plan(high, intervals=10)
    cell = tm.Workcell(
        {"a": (planar3r, (0.0, 0.0, 0.0)), "b": (planar3r, (9.0, 0.0, 0.0))}
    )
    with pytest.raises(tm.ProblemError, match="a: goal is of type HeightGoal"):
        cell.goal({"a": HeightGoal("tip", 1.5), "b": None})
