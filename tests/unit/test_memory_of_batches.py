"""Batches free the memory of each plan, so that the memory of a process is bounded."""

from __future__ import annotations

import gc
import sys
from pathlib import Path

import numpy as np

import tominpmp as tm

QUICK = {"intervals": 8, "refine": None, "effort": "quick", "workers": 1, "starts": 1}
# Number of all plans, and of the first plans, during which caches fill.
PLANS, FIRST = 40, 15
# Memory blocks that may differ between two measurements; one plan has more blocks.
STRAY = 300


def test_plans_of_a_batch_leave_no_memory_allocated(tmp_path: Path) -> None:
    robot, home = tm.load_robot("planar3r", velocity=0.5), np.array([0.5, 1.7, -1.7])
    problems = (
        tm.Problem(robot, home, tm.JointGoal(home + 0.01 * k), self_collision=False)
        for k in range(1, PLANS + 1)
    )
    blocks, kept = [], []
    for number, outcome in enumerate(tm.plan_many(problems, results=tmp_path, **QUICK)):
        assert outcome.success
        del outcome
        if number + 1 in (FIRST, PLANS):
            gc.collect()
            blocks.append(sys.getallocatedblocks())
            kept.append(len(gc.get_objects()))
    assert blocks[1] - blocks[0] < STRAY
    assert kept[1] - kept[0] < STRAY
