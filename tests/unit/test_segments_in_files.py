"""Ends of segments in motion files, and the replay of files with segments."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tominpmp.motion.joining import join
from tominpmp.verification.stages import with_segments

STAY = 0.1


@pytest.fixture(scope="module")
def solution():
    """A motion on a rail that passes a point twice; segment 3 has its goal there."""
    robot = make_arm(slide(2.0), effort=10.0)
    segments = [
        tm.Segment(tm.JointGoal([1.0]), dwell=STAY),
        tm.Segment(tm.JointGoal([0.2])),
        tm.Segment(tm.JointGoal([0.6])),
        tm.Segment(tm.JointGoal([1.3]), payload=tm.Payload(3.0, "tip")),
    ]
    problem = tm.Problem(robot, [0.0], segments=segments)
    found = tm.plan(problem, intervals=24, control="constant", refine=None)
    assert found.success, found.message
    return found


@pytest.mark.parametrize("ending", ["csv", "npz"])
@pytest.mark.parametrize("dt", [None, 0.01])
def test_exported_file_has_the_ends_of_segments(solution, tmp_path, ending, dt):
    path = solution.export(tmp_path / f"motion.{ending}", dt=dt)
    samples = tm.load_motion(path)
    late = samples.segment_ends - solution.trajectory.segment_ends
    step = 0.0 if dt is None or ending == "npz" else dt
    assert np.all(late >= -1e-12) and np.all(late <= step + 1e-12)
    tolerances = tm.Tolerances()
    problem, plan = solution.problem, solution.trajectory
    motion = tm.verify(problem, samples).replay
    assert motion.complete
    read = with_segments(problem, join(samples, problem.robot).trajectory, tolerances)
    np.testing.assert_allclose(read.segment_ends, plan.segment_ends, atol=3e-3)
    if dt is None:
        assert tm.verify(problem, samples).ok


@pytest.mark.parametrize(
    ("end", "q_end", "v_row", "v_end"),
    [(1.01, 1.0, -0.1, 0.2), (1.0104, 1.0 + 5e-7, 0.1, 0.0)],
    ids=["the row before is near the goal", "the goal is nearer before the end"],
)
def test_recorded_end_of_a_segment_is_kept(end, q_end, v_row, v_end):
    """At the row before that end, the motion is near the goal, but first moves away
    from it: a search for the minimum of the distance would end there. Or the motion
    passes the goal slowly, and is nearest to it up to rounding before the end.
    """
    robot = make_arm(slide(2.0), effort=10.0)
    segments = [tm.Segment(tm.JointGoal([goal])) for goal in (1.0, 0.5)]
    problem = tm.Problem(robot, [0.0], segments=segments)
    q = np.array([[0.0], [0.9995], [q_end], [0.5]])
    v = np.array([[0.0], [v_row], [v_end], [0.0]])
    t, none, ends = (
        np.array([0.0, 1.0, end, 2.0]),
        np.full_like(q, np.nan),
        [end, 2.0],
    )
    samples = tm.Samples(robot.joint_names, t, q, v, none, none, segment_ends=ends)
    motion = join(samples, robot).trajectory
    read = with_segments(problem, motion, tm.Tolerances())
    assert read.segment_ends.tolist() == ends


def test_goal_met_before_its_time_window_and_again_in_it_is_accepted(tmp_path):
    """Regression: the arm begins at the goal, and in a file without ends of segments
    this start was taken for the arrival.
    """
    segments = [
        tm.Segment(tm.JointGoal([0.0]), arrival=(0.5, 1.0)),
        tm.Segment(tm.JointGoal([1.0])),
    ]
    problem = tm.Problem(make_arm(slide(2.0), effort=10.0), [0.0], segments=segments)
    found = tm.plan(problem, control="constant", refine=None)
    assert np.ptp(found.segments[0].trajectory.q) > 1e-3
    verdict = tm.verify(problem, tm.load_motion(found.export(tmp_path / "m.yaml")))
    assert verdict.ok, verdict.message


def test_file_of_one_segment_has_no_segment_column(tmp_path):
    robot = make_arm(slide(2.0), effort=10.0)
    problem = tm.Problem(robot, [0.0], tm.JointGoal([1.0]))
    found = tm.plan(problem, intervals=10, control="constant", refine=None)
    path = found.export(tmp_path / "motion.csv")
    assert "segment" not in path.read_text().splitlines()[0]
    assert tm.load_motion(path).segment_ends is None


@pytest.mark.parametrize("wrong", ["2", "1.5", "3"])
def test_wrong_segment_numbers_in_a_file_are_rejected(solution, tmp_path, wrong):
    path = solution.export(tmp_path / "motion.csv")
    lines = path.read_text().splitlines()
    lines[1] = lines[1].rpartition(",")[0] + f",{wrong}"
    path.write_text("\n".join(lines))
    with pytest.raises(tm.ScenarioError, match="segment: is"):
        tm.load_motion(path)


@pytest.mark.parametrize("ends", [[0.5, 0.2], [-1.0, 1.0], [[1.0]], "ab", [9.0]])
def test_samples_reject_wrong_segment_ends(ends):
    t, x = np.array([0.0, 1.0]), np.zeros((2, 1))
    with pytest.raises(tm.ProblemError, match="segment_ends"):
        tm.Samples(("a",), t, x, x, x, x, segment_ends=ends)


def test_violations_name_their_segment_and_its_time_span(solution):
    slow = [
        tm.Segment(segment.goal, dwell=segment.dwell, payload=segment.payload)
        for segment in solution.problem.segments
    ]
    gentle = tm.MotionLimits(acceleration=0.5)
    slow[1] = tm.Segment(slow[1].goal, motion_limits=gentle)
    problem = tm.Problem(solution.problem.robot, [0.0], segments=slow)
    verdict = tm.verify(problem, solution.trajectory)
    assert {item.segment for item in verdict.violations} == {2}
    begin, end = solution.trajectory.segment_ends[:2]
    assert all(item.span == (begin, end) for item in verdict.violations)
    assert f"on segment 2 ({begin:.3f} to {end:.3f} s), joint" in verdict.message
