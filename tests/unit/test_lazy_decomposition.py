"""Meshes of links are decomposed into convex pieces only where links come near.

An arm without obstacles is checked with one hull for each link; only the links that
come nearest are checked as convex pieces.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

import tominpmp as tm
from tominpmp.cli.plan import LOGGER, Progress
from tominpmp.collision import decomposition, decomposition_cache
from tominpmp.collision.checker import CollisionChecker
from tominpmp.stopping import Deadline, Stop, check
from tominpmp.verification.nearest import nearest_pair

ENDS = [0.0, -1.2, 1.0, 0.0, 0.5, 0.0], [1.5, -0.8, 0.4, 0.3, -0.5, 1.0]
MESHES = 7
# The tests check which links are decomposed, not the search for the best motion.
QUICK = {"effort": "quick", "refine": None}


@pytest.fixture
def cut(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[list[int]]:
    """Triangle counts of the meshes decomposed during a test, from an empty cache."""
    monkeypatch.setenv(decomposition_cache.FOLDER_VARIABLE, str(tmp_path))
    decomposition_cache._known_pieces.cache_clear()
    found: list[int] = []
    usual = decomposition.decompose

    def decompose(mesh: Any) -> Any:
        found.append(mesh.num_tris)
        return usual(mesh)

    monkeypatch.setattr(decomposition, "decompose", decompose)
    yield found
    decomposition_cache._known_pieces.cache_clear()


def straight(robot: tm.Robot | None = None) -> tm.Problem:
    arm = tm.load_robot("ur5", limits="urdf") if robot is None else robot
    return tm.Problem(arm, ENDS[0], tm.JointGoal(ENDS[1]))


def test_plan_in_free_space_decomposes_only_the_nearest_links(cut: list[int]) -> None:
    """The plan is the same whichever links were decomposed before."""
    problem = straight()
    assert cut == []
    fresh = tm.plan(problem, **QUICK)
    assert fresh.success
    assert 0 < len(cut) <= 3
    # The replay reports the clearance of the pieces.
    times = np.linspace(0.0, fresh.T, 2000)
    room = problem.checker.distances(fresh.trajectory(times).q)
    assert len(cut) == MESHES
    assert fresh.verification.min_clearance == pytest.approx(room.min(), abs=1e-5)
    assert not problem.checker.is_free(np.array([0.0, -1.0, 3.1, 0.0, 0.0, 0.0]))
    again_problem = straight()
    _ = again_problem.checker.pairs
    again = tm.plan(again_problem, **QUICK)
    assert len(cut) == MESHES
    assert again.T == fresh.T
    np.testing.assert_array_equal(again.trajectory.q, fresh.trajectory.q)
    one, other = fresh.verification, again.verification
    assert one.min_clearance == other.min_clearance
    assert str(one.worst["clearance"]) == str(other.worst["clearance"])


def test_plan_from_touching_links_does_not_depend_on_decomposition() -> None:
    fingers = {"panda_finger_joint1": 0.0, "panda_finger_joint2": 0.0}
    ends = (
        [1.1983, 1.5287, -0.6743, -2.9015, 2.2466, 1.8704, 0.3356],
        [-2.3445, 1.3482, 2.7482, -2.7004, 1.2406, 2.9528, 0.9919],
    )
    durations = []
    for early in (False, True):
        panda = tm.load_robot("panda", limits="urdf", locked_joints=fingers)
        problem = tm.Problem(panda, ends[0], tm.JointGoal(ends[1]))
        if early:
            problem.checker.distances(np.array(ends))
        solution = tm.plan(problem)
        assert solution.success
        durations.append(solution.T)
    assert durations[0] == durations[1]


def test_hulls_are_never_farther_apart_than_pieces() -> None:
    arm = tm.load_robot("ur5", limits="urdf")
    checker = CollisionChecker(arm, tm.Scene(), self_collision=True)
    q = np.random.default_rng(3).uniform(-3.0, 3.0, size=(30, 6))
    nearest = []
    for part in (checker.with_cut(frozenset()), checker):
        found: dict[frozenset[str], Any] = {}
        for pair, room in zip(part.pairs, part.distances(q).T, strict=True):
            names = frozenset(pair)
            found[names] = np.minimum(found.get(names, np.inf), room)
        nearest.append(found)
    hulls, pieces = nearest
    assert hulls.keys() == pieces.keys()
    assert any(np.any(room > 0.0) for room in hulls.values())
    # Depths of penetration of hulls and of pieces cannot be compared.
    for names, room in hulls.items():
        apart = room > 0.0
        assert np.all(room[apart] <= pieces[names][apart] + 1e-7)


def test_start_clear_by_pieces_but_not_by_hulls_is_accepted() -> None:
    arm = tm.load_robot("ur5", limits="urdf")
    checker = CollisionChecker(arm, tm.Scene(), self_collision=True)
    hulls = checker.with_cut(frozenset())
    rng = np.random.default_rng(5)
    drawn = (rng.uniform(-3.0, 3.0, 6) for _ in range(4000))
    q = next(q for q in drawn if checker.is_free(q) and not hulls.is_free(q))
    assert not checker.hulls_clear(q)
    tm.Problem(arm, q, tm.JointGoal(q))


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_checked_pairs_of_links_do_not_depend_on_decomposition(name: str) -> None:
    checker = CollisionChecker(tm.load_robot(name), tm.Scene(), self_collision=True)
    some = frozenset([checker.pairs[0][0]])
    every = {frozenset(pair) for pair in checker.pairs}
    for cut in (frozenset(), some):
        part = checker.with_cut(frozenset(cut))
        assert {frozenset(pair) for pair in part.pairs} == every
        assert len(part.pairs) <= len(checker.pairs)


def test_motion_clear_by_hulls_is_accepted_without_time_to_decompose(
    cut: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: the bound was known, and measured once more after the deadline."""
    solution = tm.plan(straight())
    known = solution.verification.min_clearance
    decomposition_cache._known_pieces.cache_clear()
    problem = straight()
    found = nearest_pair(problem, solution.verification.replay, problem.checker, 1e-6)
    assert found is not None and found[1].distance == known

    deadline = Deadline()

    def late(mesh: Any) -> Any:
        deadline.end = -np.inf
        check()

    decomposition_cache._known_pieces.cache_clear()
    monkeypatch.setattr(decomposition, "decompose", late)
    monkeypatch.setattr(decomposition_cache, "_read", lambda path: None)
    problem = straight()
    motion = solution.verification.replay
    with deadline.in_force():
        bound = nearest_pair(problem, motion, problem.checker, 1e-6)
    assert bound is not None and not bound[0].violated
    assert 0.0 < bound[1].distance <= known


def test_self_collision_without_time_to_decompose_is_not_accepted(
    cut: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = tm.load_robot("ur5", limits="urdf")
    folded = [0.0, -1.0, 3.1, 0.0, 0.0, 0.0]
    blind = tm.Problem(arm, ENDS[0], tm.JointGoal(folded), self_collision=False)
    motion = tm.plan(blind)
    assert motion.success

    def late(mesh: Any) -> Any:
        raise Stop(requested=False)

    monkeypatch.setattr(decomposition, "decompose", late)
    watched = straight(arm)
    with pytest.raises(Stop):
        nearest_pair(watched, motion.verification.replay, watched.checker, 1e-6)


def test_decomposition_is_logged_before_and_after(
    cut: list[int], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, logger="tominpmp")
    tm.plan(straight())
    messages = [r.getMessage() for r in caplog.records if "pieces" in r.getMessage()]
    assert len(messages) == 2 * len(cut) > 0
    assert "is cut into convex pieces" in messages[0]
    assert "_link'" in messages[0]  # the link of the mesh
    assert "became" in messages[1]


@pytest.mark.parametrize("quiet", [False, True])
def test_terminal_shows_the_decomposition_unless_quiet(
    cut: list[int], quiet: bool
) -> None:
    shown = StringIO()
    console = Console(file=shown, force_terminal=True, width=300)
    logger = logging.getLogger(LOGGER)
    level, handlers = logger.level, list(logger.handlers)
    with Progress(console, quiet=quiet, verbose=False):
        tm.plan(straight())
    assert cut
    assert ("is cut into convex pieces" in shown.getvalue()) is not quiet
    assert (logger.level, logger.handlers) == (level, handlers)


def test_message_names_the_mesh_whose_decomposition_took_too_long(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Regression: the message said only that no motion was found."""
    monkeypatch.setenv(decomposition_cache.FOLDER_VARIABLE, str(tmp_path))
    decomposition_cache._known_pieces.cache_clear()

    def decompose(mesh: Any) -> Any:
        raise Stop(requested=False)

    monkeypatch.setattr(decomposition, "decompose", decompose)
    robot = tm.load_robot("so101")
    low, high = robot.limits.position_lower, robot.limits.position_upper
    start, goal = low + 0.35 * (high - low), low + 0.6 * (high - low)
    solution = tm.plan(tm.Problem(robot, start, tm.JointGoal(goal)))
    decomposition_cache._known_pieces.cache_clear()
    assert solution.status is tm.Status.TIME_LIMIT and not solution.success
    assert "link' was being cut into convex pieces" in solution.message
    assert "which may need more planning time, or fewer than its " in solution.message
