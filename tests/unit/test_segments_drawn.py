"""Pages show payloads, obstacles and ends of segments at their places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tominpmp.kinematics import RobotKinematics
from tominpmp.motion.trajectory import Trajectory
from tominpmp.viz.meshcat_scene import Recorder, draw
from tominpmp.viz.surroundings import drawn_path, scene_items

meshcat = pytest.importorskip("meshcat")


@pytest.fixture(scope="module")
def solution():
    shape = tm.Box("crate", size=(0.1, 0.1, 0.1))
    crate = tm.Payload(1.0, "tip", geometry=[shape], name="crate")
    ball = tm.Sphere("ball", radius=0.1, position=(0.0, 5.0, 0.0))
    segments = [
        tm.Segment(tm.JointGoal([0.5]), stop=True),
        tm.Segment(tm.JointGoal([1.0]), payload=crate, scene=tm.Scene([ball])),
        tm.Segment(tm.JointGoal([0.2])),
    ]
    robot = make_arm(slide(2.0), effort=10.0)
    problem = tm.Problem(robot, [0.0], segments=segments)
    found = tm.plan(problem, intervals=20, control="constant", refine=None)
    assert found.success, found.message
    return found


def crate_bodies(problem, trajectory, times):
    """The payloads of a motion, each of which is one body named after its shape."""
    loads = [one for one in scene_items(problem, trajectory, times) if one.load]
    names = ["crate", "crate (2)"][: len(loads)]
    assert [load.load for load in loads] == names
    assert all(load.name == "crate" and load.present.all() for load in loads)
    return loads


def test_payload_is_drawn_before_during_and_after_its_segment(solution):
    first, second, third = solution.trajectory.segment_ends
    times = np.array([0.0, first, 0.5 * (first + second), second, third])
    (load,) = crate_bodies(solution.problem, solution.trajectory, times)
    x = load.placements[:, :3, 3] - load.placements[0, :3, 3]
    way = np.linalg.norm(x, axis=1)
    middle = float(solution.trajectory(times[2]).q[0]) - 0.5
    np.testing.assert_allclose(way, [0.0, 0.0, middle, 0.5, 0.5], atol=1e-9)


def test_equal_payloads_at_two_places_are_two_bodies():
    """Regression: both payloads were drawn as one body, which jumped from one place to
    the other.
    """
    shape = tm.Box("crate", size=(0.1, 0.1, 0.1))
    crate = tm.Payload(1.0, "tip", geometry=[shape], name="crate")
    ends = [0.5, 1.0, 0.7, 0.2, 0.6]
    carried = [False, True, True, False, True]
    segments = [
        tm.Segment(tm.JointGoal([q]), payload=crate if has else None)
        for q, has in zip(ends, carried, strict=True)
    ]
    robot = make_arm(slide(2.0), effort=10.0)
    problem = tm.Problem(robot, [0.0], segments=segments)
    t = np.arange(6.0)
    q = np.array([[0.0], *([end] for end in ends)])
    zero = np.zeros_like(q)
    motion = Trajectory(robot.joint_names, t, q, zero, zero, segment_ends=t[1:])
    times = np.array([0.5, 1.0, 1.5, 2.5, 3.0, 3.5, 4.0, 4.5])
    hand = motion(times).q[:, 0]
    # The first payload stands at 0.5, is carried on two segments to 0.7, and stays
    # there; the other stands at 0.2, where it is taken up.
    ways = [0.5, 0.5, hand[2], hand[3], 0.7, 0.7, 0.7, 0.7], [*[0.2] * 7, hand[7]]
    begin = RobotKinematics(robot).placement(q[0], "tip").translation[0]
    for load, way in zip(crate_bodies(problem, motion, times), ways, strict=True):
        np.testing.assert_allclose(load.placements[:, 0, 3] - begin, way, atol=1e-9)


def test_payload_taken_up_again_where_it_stands_is_one_body(solution):
    first, carries, last = solution.problem.segments
    problem = replace(
        solution.problem,
        goal=None,
        segments=[first, carries, replace(last, payload=carries.payload)],
    )
    times = solution.trajectory.segment_ends
    (load,) = crate_bodies(problem, solution.trajectory, times)
    way = load.placements[:, 0, 3] - load.placements[0, 0, 3]
    np.testing.assert_allclose(way, [0.0, 0.5, -0.3], atol=1e-9)


def test_different_payloads_with_one_name_are_two_bodies(solution):
    """Regression: the second payload took the place of the first."""
    small, large = (
        tm.Payload(1.0, "tip", geometry=[tm.Box("crate", size=(size,) * 3)])
        for size in (0.1, 0.2)
    )
    problem = replace(
        solution.problem,
        goal=None,
        segments=[
            replace(segment, payload=payload, scene=None)
            for segment, payload in zip(
                solution.problem.segments, (small, None, large), strict=True
            )
        ],
    )
    recorder = Recorder()
    draw(meshcat.Visualizer(window=recorder), problem, solution.trajectory, fps=20.0)
    put = [c["path"] for c in recorder.commands if c["type"] == "set_object"]
    loads = [path for path in put if path.startswith("/meshcat/loads/")]
    assert len(loads) == len(set(loads)) == 2


def test_obstacles_are_visible_only_on_their_segments(solution):
    first, second, _ = solution.trajectory.segment_ends
    times = np.array([0.5 * first, first, 0.5 * (first + second), second + 0.01])
    ball, _ = scene_items(solution.problem, solution.trajectory, times)
    assert ball.name == ball.shape.name == "ball"
    assert not ball.moves
    np.testing.assert_array_equal(ball.present, [False, True, True, False])


def test_page_has_payloads_obstacles_and_ends_of_segments(solution):
    recorder = Recorder()
    viewer = meshcat.Visualizer(window=recorder)
    draw(viewer, solution.problem, solution.trajectory, fps=20.0)
    put = {c["path"] for c in recorder.commands if c["type"] == "set_object"}
    assert "/meshcat/loads/crate/crate" in put
    assert {"/meshcat/ends of segments/1", "/meshcat/ends of segments/2"} <= put
    (animation,) = (c for c in recorder.commands if c["type"] == "set_animation")
    tracks = {
        one["path"]: {track["name"] for track in one["clip"]["tracks"]}
        for one in animation["animations"]
    }
    assert tracks["/meshcat/loads/crate/crate"] == {".position", ".quaternion"}
    assert tracks["/meshcat/obstacles/ball"] == {".visible"}


def test_payload_handed_over_to_another_frame_is_one_body():
    robot = make_arm(slide(1.0), slide(1.0), effort=10.0)
    first, other = robot.frame_names[-1], "link1"
    # The first frame is 0.2 m further along x where the other takes over.
    holds = ((first, (0.3, 0.0, 0.0)), (other, (0.5, 0.0, 0.0)))
    held = [
        tm.Payload(0.1, frame, geometry=[tm.Box("b", size=(0.1,) * 3, position=at)])
        for frame, at in holds
    ]
    segments = [
        tm.Segment(tm.JointGoal([0.1, 0.2]), stop=True, payload=held[0]),
        tm.Segment(tm.JointGoal([0.3, 0.0]), payload=held[1]),
    ]
    problem = tm.Problem(robot, [0.0, 0.0], segments=segments)
    found = tm.plan(problem, intervals=12, control="constant", refine=None)
    assert found.success, found.message
    times = np.array([0.0, found.T])
    (load,) = scene_items(problem, found.trajectory, times)
    q = found.trajectory(times).q
    for row, (frame, at) in enumerate(holds):
        box = np.eye(4)
        box[:3, 3] = at
        place = RobotKinematics(robot).placement(q[row], frame).homogeneous @ box
        np.testing.assert_allclose(load.placements[row], place, atol=1e-9)


def test_path_of_many_segments_is_drawn_without_corners():
    # 25 circles, each of them a segment; with 300 points they had twelve corners each.
    t = np.linspace(0.0, 25.0, 2501)
    angle = 2.0 * np.pi * t
    q = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    v = 2.0 * np.pi * np.stack([-q[:, 1], q[:, 0]], axis=1)
    ends = np.arange(1.0, 26.0)
    robot = make_arm(slide(2.0), slide(2.0, (0, 1, 0)), effort=10.0)
    motion = Trajectory(robot.joint_names, t, q, v, 0.0 * q, segment_ends=ends)
    problem = tm.Problem(robot, [0.0, 0.0], tm.JointGoal([0.0, 0.0]))
    drawn, stops = drawn_path(problem, motion, "tip")
    start = drawn[0] - [1.0, 0.0, 0.0]
    between = np.linalg.norm(0.5 * (drawn[1:] + drawn[:-1]) - start, axis=1)
    assert between.min() > 0.99
    np.testing.assert_allclose(stops - start, [[1.0, 0.0, 0.0]] * 24, atol=1e-9)


def test_caption_of_a_page_counts_obstacles_of_all_segments(solution, tmp_path):
    page = solution.play(tmp_path / "motion.html").read_text()
    assert "<p>1 joint, 3 segments, 1 obstacle</p>" in page
