"""Refinement with a moving obstacle: a ball on a rail waits behind a wall."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.exact.shooting import ArcProgram
from tominpmp.exact.structure import Arcs
from tominpmp.exact.switching_times import steps_of
from tominpmp.transcription.bspline import InverseTranscription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.grid import delayed_shares
from tominpmp.transcription.layout import split_intervals
from tominpmp.transcription.problem_functions import ProblemFunctions

RAIL = """<robot name="rail"><link name="base"/>
<link name="ball"><inertial><mass value="2"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="ball"/>
<axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="30" velocity="2"/></joint>
</robot>"""


def rail(folder: Path) -> tm.Robot:
    path = folder / "rail.urdf"
    path.write_text(RAIL)
    return tm.load_robot(path)


def opening(
    folder: Path, leave: float, gone: float, aside: float, **kinds: float
) -> tm.Problem:
    """A wall stands in the way until `leave` [s], and is aside from `gone` [s] on."""
    stands, away = (0.0, 0.0, 0.0), (0.0, aside, 0.0)
    way = tm.Waypoints([0.0, leave, gone], [stands, stands, away])
    size = (kinds.get("thick", 0.1), 1.0, 1.0)
    wall = tm.Box("wall", size=size, position=(0.0, 0.0, 0.0), motion=way)
    goal = tm.JointGoal([kinds.get("goal", 1.0)])
    start = [kinds.get("start", -1.0)]
    return tm.Problem(rail(folder), start, goal, scene=tm.Scene([wall]))


def test_refinement_after_the_last_row_exchange_finds_a_motion(tmp_path):
    # Regression, 353 against 352 rows: the last row exchange added rows with which the
    # program was not solved.
    problem = opening(
        tmp_path,
        2.288456013157626,
        2.3784167273600754,
        -2.4577288390845746,
        thick=0.31960290730279367,
        start=-1.0465993614930107,
        goal=0.861624403098729,
    )
    plain = tm.plan(problem, tm.Options())
    refined = tm.plan(problem, tm.Options(refine="grid"))
    assert refined.success, refined.message
    assert refined.T <= plain.T * (1.0 + 1e-6)


@pytest.mark.parametrize("length", [0.0, 1e-16, 1e-13])
def test_vanishing_arc_is_no_step_of_the_motion(length, tmp_path):
    # Regression: times that hardly increase were refused, or the replay divided by the
    # differences.
    problem = opening(tmp_path, 0.01, 0.02, 5.0)
    lengths = np.array([0.3, length, 0.3])
    none = np.zeros((3, 1), dtype=np.int64)
    no = none != 0
    arcs = Arcs(lengths, np.array([[1.0], [0.2], [-1.0]]), no, none, no)
    program = ArcProgram(ProblemFunctions.of(problem), arcs, steps_of(arcs, 20))
    motion = program.trajectory(program.pack())
    assert np.min(np.diff(motion.t)) > 1e-3
    assert motion.duration == pytest.approx(0.6)
    assert tm.verify(problem, motion).complete


@pytest.mark.parametrize("kind", [InverseTranscription, CollocationTranscription])
def test_halved_intervals_keep_the_motion_and_its_free_lengths(kind, tmp_path):
    # Regression: a motion that waits has separate lengths for the wait, which halving
    # lost.
    system = ProblemFunctions.of(opening(tmp_path, 0.5, 1.0, 2.0))
    shares = delayed_shares(12, 0.4)
    program = kind(system, shares, 2.0)
    times = 2.0 * np.concatenate([[0.0], np.cumsum(shares.sum(axis=1))])

    def position(t):
        return np.interp(t, times, np.linspace(-1.0, 1.0, times.size))[:, None]

    z = program.start(position, 2.0, np.array([2.1, 2.1]))
    split = np.arange(shares.shape[0]) % 3 == 0
    finer, start = split_intervals(program, z, split)
    assert finer.shares.shape == (shares.shape[0] + split.sum(), 2)
    np.testing.assert_allclose(finer.shares.sum(axis=0), shares.sum(axis=0))
    before, after = program.trajectory(z), finer.trajectory(start)
    assert after.duration == pytest.approx(before.duration, rel=1e-12)
    t = before.t if kind is CollocationTranscription else np.linspace(0, 1, 50)
    t = np.minimum(t, before.duration)
    np.testing.assert_allclose(after(t).q, before(t).q, atol=1e-12)
