"""One test for each defect that random problems and malformed files revealed.

Its docstring states the defect; the test checks the general rule that the defect
violated, on the smallest problem that shows it.
"""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from optimum_cases import ROD
from sample_arms import make_arm, slide

import tominpmp as tm

OPTIONS = tm.Options(intervals=8, effort="quick", refine=None)


def test_goal_that_the_start_satisfies_converges() -> None:
    """Regression: T fell without end until iterations or planning time were used up."""
    rail = make_arm(slide(1.0), effort=10.0)
    goal = tm.JointRegionGoal([0.3], 0.1)
    solution = tm.plan(tm.Problem(rail, [0.25], goal), OPTIONS)
    assert solution.status is tm.Status.CONVERGED
    assert 0.0 <= solution.T < 1e-3
    assert abs(solution.trajectory.q[-1, 0] - 0.3) <= 0.1 + 1e-6


@pytest.mark.parametrize("kind", ["position", "pose", "region"])
def test_lower_bound_of_a_goal_at_the_edge_of_reach_is_valid(kind: str) -> None:
    """Regression: rounding put the goal out of reach; the bound exceeded 100 s."""
    rod = make_arm(ROD, effort=10.0, velocity=2.0)
    end = np.array([0.7])
    model = rod.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, end)
    frame = rod.frame_names[-1]
    place = data.oMf[rod.frame_id(frame)]
    # As written to a file with ten digits.
    place = pin.SE3(place.rotation, np.round(place.translation, 10))
    point = np.zeros(3)
    goals = {
        "position": tm.PositionGoal(frame, place.translation),
        "pose": tm.PoseGoal(frame, place, tolerance=1e-6, angle_tolerance=0.01),
        "region": tm.RegionGoal(frame, point, point, place),
    }
    solution = tm.plan(tm.Problem(rod, [0.1], goals[kind]), OPTIONS)
    assert solution.success
    assert solution.lower_bound is not None
    assert solution.lower_bound.T <= solution.T


def test_unit_vectors_are_not_normalised_again() -> None:
    """Regression: each loading divided a direction by its length, and it drifted."""
    rng = np.random.default_rng(5)
    for _ in range(200):
        goal = tm.AxisGoal("tip", rng.normal(size=3), 1e200 * rng.normal(size=3))
        assert np.linalg.norm(goal.direction) == pytest.approx(1.0, abs=1e-15)
        again = tm.AxisGoal("tip", goal.axis.tolist(), goal.direction.tolist())
        assert again == goal
        assert pickle.loads(pickle.dumps(goal)) == goal


def test_message_on_a_long_unknown_key_is_short(tmp_path: Path) -> None:
    """Regression: the message contained a key of 100 000 characters in full."""
    path = tmp_path / "s.toml"
    path.write_text(f"{'x' * 100_000} = 1\n", encoding="utf-8")
    with pytest.raises(tm.ScenarioError, match="no such key") as caught:
        tm.load_scenario(path)
    assert len(str(caught.value)) < 1000


def test_planning_request_is_refused_as_a_scene(tmp_path: Path) -> None:
    """Regression: files in the wrong order gave a scene without obstacles."""
    path = tmp_path / "request.yaml"
    path.write_text("goal_constraints: [{joint_constraints: []}]\n", encoding="utf-8")
    with pytest.raises(tm.ScenarioError, match="not a planning scene"):
        tm.load_moveit_scene(path)


@pytest.mark.parametrize("text", ["{}\n", "", "# acceleration: 15\n"])
def test_empty_file_of_motion_limits_is_refused(text: str, tmp_path: Path) -> None:
    """Regression: a file without entries was read as one that sets no limits."""
    path = tmp_path / "limits.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(tm.ScenarioError, match="is empty, expected acceleration"):
        tm.load_motion_limits(path, tm.load_robot("planar3r"))


def test_scaling_factor_of_zero_is_refused(tmp_path: Path) -> None:
    """Regression: the message on a factor of 0 named a range that includes 0."""
    path = tmp_path / "joint_limits.yaml"
    text = "default_velocity_scaling_factor: 0\njoint_limits: {}\n"
    path.write_text(text, encoding="utf-8")
    message = "default_velocity_scaling_factor: is 0, expected a share greater than 0"
    with pytest.raises(tm.ScenarioError, match=message):
        tm.load_joint_limits(path)


def test_payload_is_saved_with_its_robot(planar3r: tm.Robot, tmp_path: Path) -> None:
    """Regression: robots with a payload could not be saved."""
    robot = planar3r.with_payload(tm.Payload(mass=0.05, frame="tip"))
    problem = tm.Problem(robot, [1.4, 0.1, 0.1], tm.JointGoal([1.5, 0.1, 0.1]))
    path = tm.save_scenario(tmp_path / "s.toml", problem)
    assert tm.load_scenario(path).problem == problem


def test_mesh_without_triangles_is_refused(tmp_path: Path) -> None:
    """A file of the right format without content is no obstacle."""
    path = tmp_path / "empty.stl"
    path.write_bytes(bytes(84))
    with pytest.raises(tm.SceneError, match="no triangles"):
        tm.Mesh("part", path=path)
