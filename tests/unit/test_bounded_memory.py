"""Memory stays bounded for very long motions, and too long motions are reported."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.transcription.exchange import MOST_SAMPLES, _samples
from tominpmp.verification.replay import MOST_ROWS
from tominpmp.verification.verification import LONGEST

GIGABYTE = 1_000_000_000

SLOW = """
import json, resource, sys
from pathlib import Path
import tominpmp as tm
arm = tm.load_robot("ur5", limits="urdf", velocity=float(sys.argv[1]))
start = [0.0, -1.2, 1.0, 0.0, 0.5, 0.0]
goal = tm.JointGoal([2.7, -0.9, 1.2, 0.1, 0.6, 0.1])
box = tm.Box("box", size=(0.1, 0.1, 0.1), position=(0.0, 0.0, 1.5),
             motion=tm.ConstantVelocity((0.0, 0.0, 1e-5)))
found = tm.plan(tm.Problem(arm, start, goal, scene=tm.Scene([box])),
                tm.Options(starts=1, effort="quick", refine=None,
                           max_planning_time=600.0))
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
status = Path("/proc/self/status")
if status.exists():  # what is above counts what the parent had when it forked, too
    (line,) = [one for one in status.read_text().splitlines() if "VmHWM" in one]
    peak = int(line.split()[1]) * 1024
rows = found.verification.replay.t.size if found.verification else 0
print(json.dumps([peak, rows, found.success, found.message]))
"""


def planned(velocity: str) -> tuple[int, int, bool, str]:
    done = subprocess.run(
        [sys.executable, "-c", SLOW, velocity],
        # Each thread of a machine with many cores would have buffers of its own.
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=900,
        check=True,
    )
    return tuple(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.slow
def test_motion_of_three_quarters_of_an_hour_needs_below_a_gigabyte() -> None:
    peak, rows, success, _ = planned("1e-3")
    assert success
    assert peak < GIGABYTE
    assert rows <= 1.1 * MOST_ROWS


@pytest.mark.slow
def test_motion_of_ten_thousand_years_fails_with_a_message() -> None:
    peak, _, success, message = planned("1e-11")
    assert not success
    assert peak < GIGABYTE
    assert "can be replayed" in message


def test_too_long_motion_is_rejected_without_a_replay() -> None:
    rail = tm.load_robot("planar3r")
    problem = tm.Problem(rail, [0.5, 0.1, 0.1], tm.JointGoal([0.6, 0.1, 0.1]))
    motion = tm.plan(problem).trajectory
    t = np.array(motion.t) * (2.0 * LONGEST / motion.duration)
    slow = tm.Trajectory(motion.joint_names, t, motion.q, motion.v, motion.u)
    found = tm.verify(problem, slow)
    assert not found.ok
    assert "can be replayed" in found.message
    assert found.replay.t.size == t.size


def test_number_of_instants_between_rows_is_bounded() -> None:
    for T in (1.0, 1e3, 1e6, 1e12):
        instants = _samples(np.full(40, T / 40))
        assert instants.size <= 1.1 * MOST_SAMPLES


def test_distances_of_distant_pairs_need_little_memory() -> None:
    arm = tm.load_robot("ur5", limits="urdf")
    far = [tm.Sphere(f"s{k}", radius=0.1, position=(5 + k, 0, 0)) for k in range(40)]
    checker = tm.Problem(
        arm, np.full(6, 0.1), tm.JointGoal(np.zeros(6)), scene=tm.Scene(far)
    ).checker
    assert len(checker.pairs) > 500
    q = np.full((4000, 6), 0.1)
    tracemalloc.start()
    distances = checker.distances(q, 0.05)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < distances.nbytes + 40 * 1024 * len(checker.pairs) + 20_000_000
