"""The MotionBenchMaker benchmark: its judge, its rival and its tables of results."""

from __future__ import annotations

import argparse
import ast
import importlib
import itertools
import sys
import warnings
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from benchmarks import exact_geometry, judging, motionbenchmaker, results  # noqa: E402
from benchmarks.rivals.arm import Arm, TorqueModel  # noqa: E402

LINK = """
  <link name="{name}">
    <inertial>
      <origin xyz="0.25 0 0"/><mass value="1.5"/>
      <inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <collision><origin xyz="0.25 0 0"/><geometry>{shape}</geometry></collision>
  </link>"""
JOINT = """
  <joint name="{name}" type="revolute">
    <parent link="{parent}"/><child link="{child}"/><origin xyz="{x} 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="2" effort="20"/>
    <dynamics damping="{damping}"/>
  </joint>"""
SRDF = """<robot name="two">
  <disable_collisions link1="upper" link2="fore" reason="Adjacent"/>
</robot>"""
SCENE = """
world:
  collision_objects:
    - id: post
      primitives: [{type: box, dimensions: [0.1, 0.2, 1.0]}]
      primitive_poses: [{position: [0.7, 0.4, 0], orientation: [0, 0, 0, 2]}]
    - id: drum
      primitives: [{type: cylinder, dimensions: [0.6, 0.05]}]
      primitive_poses: [{position: [-0.6, 0.5, 0], orientation: [0.6, 0, 0, 0.8]}]
"""
REQUEST = """
start_state:
  joint_state: {name: [shoulder, elbow], position: [0.1, -0.2]}
goal_constraints:
  - joint_constraints:
      - {joint_name: elbow, position: 0.3}
      - {joint_name: shoulder, position: -0.7}
"""


def cube_facets(half: tuple[float, float, float]) -> str:
    """Triangles of a cuboid as an STL file in text."""
    corners = np.array(list(itertools.product((-1, 1), repeat=3))) * half
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4)]
    sides.append((1, 5, 7, 3))
    lines = ["solid cube"]
    for a, b, c, d in sides:
        for triangle in ((a, b, c), (a, c, d)):
            lines += ["facet normal 0 0 0", "outer loop"]
            lines += ["vertex {} {} {}".format(*corners[i]) for i in triangle]
            lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid cube"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("judge")
    (folder / "cube.stl").write_text(cube_facets((0.25, 0.02, 0.02)))
    mesh = f'<mesh filename="{folder / "cube.stl"}"/>'
    box = '<box size="0.5 0.04 0.04"/>'
    urdf = '<robot name="two"><link name="base"/>'
    urdf += JOINT.format(
        name="shoulder", parent="base", child="upper", x=0, damping=0.3
    )
    urdf += LINK.format(name="upper", shape=mesh)
    urdf += JOINT.format(name="elbow", parent="upper", child="fore", x=0.5, damping=0.2)
    urdf += LINK.format(name="fore", shape=box)
    urdf += JOINT.format(name="wrist", parent="fore", child="tool", x=0.5, damping=0)
    urdf += LINK.format(name="tool", shape='<cylinder radius="0.02" length="0.3"/>')
    (folder / "two.urdf").write_text(urdf + "</robot>")
    (folder / "two.srdf").write_text(SRDF)
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "request.yaml").write_text(REQUEST)
    return folder


@pytest.fixture(scope="module")
def arm(folder: Path) -> exact_geometry.ExactArm:
    files = folder / "two.urdf", folder / "two.srdf"
    return exact_geometry.ExactArm.load(*files, {"wrist": 0.4})


@pytest.fixture(scope="module")
def surroundings(
    folder: Path, arm: exact_geometry.ExactArm
) -> exact_geometry.Surroundings:
    obstacles = exact_geometry.read_obstacles(folder / "scene.yaml")
    return exact_geometry.Surroundings(arm, obstacles)


def test_arm_is_read_with_its_meshes_friction_and_disabled_pairs(arm) -> None:
    assert arm.names == ("shoulder", "elbow")
    np.testing.assert_array_equal(arm.damping, [0.3, 0.2])
    assert [body.name for body in arm.links] == ["upper", "fore", "tool"]
    assert isinstance(arm.links[0].shape, coal.BVHModelBase)
    assert arm.links[0].shape.num_tris == 12
    assert frozenset(("fore", "upper")) in arm.disabled
    # The tool is locked at 0.4 rad, half a metre along the fore arm.
    expected = pin.SE3(pin.utils.rotate("z", 0.4), np.array([0.5, 0.0, 0.0]))
    expected = expected * pin.SE3(np.eye(3), np.array([0.25, 0.0, 0.0]))
    assert arm.links[2].placement.isApprox(expected, 1e-12)


def test_scene_is_read_with_sizes_and_turned_poses(folder: Path) -> None:
    post, drum = exact_geometry.read_obstacles(folder / "scene.yaml")
    np.testing.assert_allclose(post.shape.halfSide, [0.05, 0.1, 0.5])
    np.testing.assert_allclose(post.placement.rotation, np.eye(3), atol=1e-12)
    assert (drum.shape.radius, 2.0 * drum.shape.halfLength) == (0.05, 0.6)
    angle = 2.0 * np.arctan2(0.6, 0.8)
    np.testing.assert_allclose(drum.placement.rotation, pin.utils.rotate("x", angle))


def test_unsupported_obstacles_are_refused(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE.replace("type: cylinder", "type: cone"))
    with pytest.raises(ValueError, match="cone"):
        exact_geometry.read_obstacles(scene)
    scene.write_text(SCENE.replace("id: drum", "id: drum\n      meshes: [a]"))
    with pytest.raises(ValueError, match="drum has meshes"):
        exact_geometry.read_obstacles(scene)


def test_smallest_clearance_is_that_of_all_pairs_and_instants(
    surroundings, rng: np.random.Generator
) -> None:
    for _ in range(5):
        ends = rng.uniform(-1.5, 1.5, (2, 2))
        q = ends[0] + np.linspace(0.0, 1.0, 60)[:, None] * (ends[1] - ends[0])
        found = surroundings.closest(q)
        rotations, positions = surroundings._place(q)
        pairs = range(len(surroundings._pairs))
        every = np.array(
            [
                [surroundings._distance(p, r, x) for p in pairs]
                for r, x in zip(rotations, positions, strict=True)
            ]
        )
        if every.min() > 0.0:
            tolerance = exact_geometry.CLEARANCE_TOLERANCE
            assert every.min() <= found.distance <= every.min() + tolerance
            assert every[found.sample].min() == pytest.approx(found.distance)
            assert found.queries < every.size / 2
        else:
            assert found.distance <= 0.0
        free = [surroundings.is_free(row) for row in q]
        np.testing.assert_array_equal(free, every.min(axis=1) > 0.0)


def test_lower_bounds_are_at_most_the_distances(
    surroundings, rng: np.random.Generator
) -> None:
    q = rng.uniform(-3.0, 3.0, (30, 2))
    placed = surroundings._place(q)
    bounds = surroundings._lower_bounds(*placed)
    travel = surroundings._travel(*placed)
    for k, (rotations, positions) in enumerate(zip(*placed, strict=True)):
        for p in range(bounds.shape[1]):
            exact = surroundings._distance(p, rotations, positions)
            assert bounds[k, p] <= max(exact, 0.0) + 1e-9
    assert np.all(np.diff(travel, axis=0) >= 0.0)
    assert np.all(travel[:, -2:] == 0.0)  # obstacles stand still


def links_in_pairs(surroundings) -> set[frozenset[str]]:
    bodies = surroundings._bodies
    return {frozenset((bodies[i].name, bodies[j].name)) for i, j in surroundings._pairs}


def test_fixed_and_allowed_pairs_are_left_out(surroundings) -> None:
    pairs = links_in_pairs(surroundings)
    assert frozenset(("upper", "fore")) not in pairs  # by the SRDF
    assert frozenset(("fore", "tool")) not in pairs  # on one joint
    assert frozenset(("post", "drum")) not in pairs
    assert {frozenset(("upper", "tool")), frozenset(("fore", "post"))} <= pairs


class Line:
    """A straight motion with constant acceleration, then the same deceleration.

    Args:
        arm: The arm.
        start: Configuration at the start, at rest.
        goal: Configuration at the end, at rest.
        T: Duration [s].
    """

    def __init__(self, arm, start, goal, T: float) -> None:
        self.arm, self.start, self.T = arm, np.array(start), T
        self.a = 4.0 * (np.array(goal) - start) / T**2
        self.knots = np.array([0.0, 0.5 * T, T])
        self.data = arm.model.createData()

    def __call__(self, t: float):
        half = 0.5 * self.T
        if t < half:
            q, v, a = self.start + 0.5 * t**2 * self.a, t * self.a, self.a
        else:
            left = self.T - t
            end = self.start + half**2 * self.a
            q, v, a = end - 0.5 * left**2 * self.a, left * self.a, -self.a
        u = pin.rnea(self.arm.model, self.data, q, v, a) + self.arm.damping * v
        return q, v, a, u


def verdict(folder: Path, arm, surroundings, motion, **options) -> judging.Verdict:
    request = judging.read_request(folder / "request.yaml")
    return judging.judge(arm, surroundings, request, motion, motion.knots, **options)


def test_valid_motion_passes_and_its_replay_is_exact(
    folder: Path, arm, surroundings
) -> None:
    motion = Line(arm, [0.1, -0.2], [-0.7, 0.3], 1.2)
    found = verdict(folder, arm, surroundings, motion)
    assert found.passed, found.faults
    assert found.goal_error < 1e-7
    assert found.replay_error < 1e-7
    assert found.clearance.distance > 0.0
    peak = np.abs(motion.a).max() * 0.6
    assert found.velocity_excess == max(0.0, peak / 2.0 - 1.0)


@pytest.mark.parametrize(
    ("start", "goal", "T", "fault"),
    [
        ([0.1, -0.2], [-0.7, 0.302], 1.2, "goal"),
        ([0.103, -0.2], [-0.7, 0.3], 1.2, "goal"),  # the replay begins elsewhere
        ([0.1, -0.2], [-0.7, 0.3], 0.7, "velocity"),
        ([0.1, -0.2], [-0.7, 0.3], 0.4, "effort"),
        ([0.1, -0.2], [-3.1, 0.3], 5.0, "position"),
        ([0.1, -0.2], [1.1, 0.3], 2.0, "contact"),
    ],
)
def test_judge_names_each_fault(
    folder: Path, arm, surroundings, start, goal, T: float, fault: str
) -> None:
    found = verdict(folder, arm, surroundings, Line(arm, start, goal, T))
    assert fault in found.faults
    assert not found.passed


def test_replay_detects_torques_without_friction(
    folder: Path, arm, surroundings
) -> None:
    motion = Line(arm, [0.1, -0.2], [-0.7, 0.3], 1.2)

    def frictionless(t: float):
        q, v, a, u = motion(t)
        return q, v, a, u - arm.damping * v

    request = judging.read_request(folder / "request.yaml")
    case = arm, surroundings, request, frictionless, motion.knots
    found = judging.judge(*case)
    assert "goal" in found.faults
    assert found.replay_error > 1e-2
    assert judging.judge(*case, replayed=False).passed


def test_nan_in_a_verdict_is_a_fault() -> None:
    clearance = exact_geometry.Clearance(np.nan, "a", "b", 0, 0)
    bad = judging.Verdict(clearance, 0.0, np.nan, np.nan, np.nan, np.nan, 0.0, 0.0)
    assert set(bad.faults) == {"position", "velocity", "effort", "contact", "goal"}


@pytest.mark.parametrize(
    "name", ["judging.py", "exact_geometry.py", "rivals/rrt_toppra.py", "rivals/arm.py"]
)
def test_judge_and_rival_do_not_import_the_library(name: str) -> None:
    tree = ast.parse((ROOT / "benchmarks" / name).read_text(encoding="utf-8"))
    imported = [
        item.name if isinstance(node, ast.Import) else node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for item in node.names
    ]
    assert "numpy" in imported
    assert not [word for word in imported if word and word.startswith("tominpmp")]


@pytest.fixture(scope="module")
def rival():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of third parties, at their first import
        pytest.importorskip("toppra")
        pytest.importorskip("ompl")
        return importlib.import_module("benchmarks.rivals.rrt_toppra")


def test_rival_plans_around_an_obstacle(folder: Path, arm, surroundings, rival) -> None:
    # The post is between the start and this goal.
    request = judging.read_request(folder / "request.yaml")
    request = judging.Request(request.start, {"shoulder": 1.3, "elbow": 0.2})
    start, goal = arm.vector(request.start), arm.vector(request.goal)
    line = start + np.linspace(0.0, 1.0, 100)[:, None] * (goal - start)
    assert surroundings.closest(line).distance <= 0.0
    model = arm.model
    limits = Arm(
        model=model,
        position_lower=model.lowerPositionLimit,
        position_upper=model.upperPositionLimit,
        velocity=model.velocityLimit,
        effort_lower=-model.effortLimit,
        effort_upper=model.effortLimit,
        damping=arm.damping,
        armature=np.zeros(2),
    )
    found = rival.solve(
        limits,
        start,
        goal,
        surroundings.is_free,
        lambda q: surroundings.closest(q).distance > 0.0,
    )
    assert found.success, found.status
    torque = TorqueModel(limits)

    def motion(t: float):
        q, v, a = (part[0] for part in found.motion(np.array([t])))
        return q, v, a, torque(q, v, a)

    case = arm, surroundings, request, motion, found.knots
    assert judging.judge(*case, replayed=False).passed
    assert found.T > np.max(np.abs(goal - start) / model.velocityLimit)
    times = np.linspace(0.0, found.T, 2001)
    q, v, _ = found.motion(times)
    # Accelerations of up to 40 rad/s^2 jump within a millisecond.
    slope = np.gradient(q, times, axis=0)[1:-1]
    np.testing.assert_allclose(slope, v[1:-1], atol=4e-2)
    assert np.abs(q[0] - start).max() < 1e-9 and np.abs(q[-1] - goal).max() < 1e-9


def test_subdivided_points_lie_on_the_path(rival) -> None:
    points = np.array([[0.0, 0.0], [1.0, 2.0], [2.0, 2.0]])
    expected = [[0.0, 0.0], [0.5, 1.0], [1.0, 2.0], [1.5, 2.0], [2.0, 2.0]]
    np.testing.assert_array_equal(rival.subdivide(points), expected)


@pytest.mark.parametrize(
    ("text", "numbers"), [("3", [3]), ("1-3", [1, 2, 3]), ("2,1-2,7", [2, 1, 7])]
)
def test_ranges_of_problems_are_parsed(text: str, numbers: list[int]) -> None:
    assert motionbenchmaker.parse_range(text) == numbers


@pytest.mark.parametrize("text", ["", "a", "3-1", "0", "1-", "-2"])
def test_wrong_ranges_are_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="no range"):
        motionbenchmaker.parse_range(text)


COLUMNS = (*results.KEY, "success", "status", "faults", "T", "process_seconds")


def row(problem: int, success: bool, T: float = 1.0, scene: str = "box"):
    return {
        "scene": scene,
        "problem": str(problem),
        "success": str(success),
        "status": "CONVERGED",
        "faults": "" if success else "contact",
        "T": str(T),
        "process_seconds": str(float(problem)),
    }


def test_rows_are_written_at_once_and_read_again(tmp_path: Path) -> None:
    path = tmp_path / "out" / "rows.csv"
    table = results.Table(path, COLUMNS)
    for problem in (1, 2):
        table.add(row(problem, True))
        assert len(results.Table(path, COLUMNS).rows) == problem
    table.add(row(2, False))
    again = results.Table(path, COLUMNS).rows
    assert [again[key]["success"] for key in again] == ["True", "False"]
    with pytest.raises(SystemExit, match="other columns"):
        results.Table(path, (*COLUMNS, "more"))


def test_row_truncated_by_an_interruption_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    results.Table(path, COLUMNS).add(row(1, True))
    with path.open("a", encoding="utf-8") as file:
        file.write("box,2,Tr")
    assert list(results.Table(path, COLUMNS).rows) == [("box", "1")]


def test_table_counts_failures_and_compares_problems_that_both_solved() -> None:
    ours = [row(1, True, 1.0), row(2, True, 2.0), row(3, False, 0.1)]
    theirs = [row(1, True, 2.0), row(2, False, 9.0), row(3, True, 9.0)]
    assert results.compare(ours, theirs) == (0.5, 1)
    assert np.isnan(results.compare(ours, [])[0])
    last = results.markdown_table(ours, theirs).splitlines()[-1]
    cells = [cell.strip() for cell in last.strip("|").split("|")]
    assert cells[:4] == ["all", "2 / 3 (66.7%)", "1.500", "2.000"]
    assert cells[-2:] == ["0.500", "1"]
    assert results.failures(ours) == ["box 3: CONVERGED (contact)"]


def test_durations_are_compared_with_the_shorter_motion_of_both_runs() -> None:
    ours = [row(1, True, 1.0), row(2, True, 2.0), row(3, True, 1.03), row(4, False, 9)]
    theirs = [row(1, True, 2.0), row(2, True, 1.0), row(3, True, 1.0), row(4, True, 1)]
    line = results.excess_line(ours, theirs)
    assert "3 problems" in line
    assert "on 33.3 %, within 5 % on 66.7 %, and 100.0 % above" in line
    assert "No problem" in results.excess_line(ours, [])


def test_error_is_a_row_and_the_next_problem_follows(tmp_path: Path) -> None:
    case = motionbenchmaker.Case("box", 1, tmp_path)
    arguments = argparse.Namespace(rival=False, time_limit=None)
    found = motionbenchmaker.run_case(case, arguments)
    assert found["success"] == "False"
    assert found["status"].startswith("FileNotFoundError")
    assert (found["scene"], found["problem"]) == ("box", "1")


def test_meter_counts_nested_calls_once_and_restores_the_class() -> None:
    class Worker:
        def outer(self) -> int:
            return self.inner() + 1

        def inner(self) -> int:
            return sum(range(20_000))

    original = dict(vars(Worker))
    meter = motionbenchmaker.Meter()
    with meter.on(Worker):
        assert Worker().outer() == sum(range(20_000)) + 1
        after_one = meter.seconds
        assert Worker.outer is not original["outer"]
    assert after_one > 0.0
    assert Worker.outer is original["outer"]
    assert Worker().outer() and meter.seconds == after_one


def test_missing_data_folder_is_named_in_the_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.delenv(motionbenchmaker.VARIABLE, raising=False)
    with pytest.raises(SystemExit):
        motionbenchmaker.main([])
    assert "--data is missing" in capsys.readouterr().err
    out = ["--out", str(tmp_path / "rows.csv")]
    with pytest.raises(SystemExit, match=r"request0001\.yaml"):
        motionbenchmaker.main(["--data", str(tmp_path), *out])
