"""Replay finds every contact: of micrometres, between samples, and of true shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robot_samples import INERTIAL, joint, link, load, robot

import tominpmp as tm
from tominpmp.collision.bodies import part_bodies
from tominpmp.collision.selection import link_bodies
from tominpmp.collision.shapes import is_mesh
from tominpmp.description.model import mesh_arrays
from tominpmp.verification.closest_approach import ClosestApproach

RADIUS = 0.05
BALL = f"<collision><geometry><sphere radius='{RADIUS}'/></geometry></collision>"
LIMIT = '<limit lower="-3" upper="3" effort="100" velocity="8"/>'


@pytest.fixture
def rail(tmp_path: Path) -> tm.Robot:
    """A ball that slides along x, at (1 + q, 0, 0)."""
    return load(
        tmp_path,
        robot(
            link("base", ""),
            link("ball", INERTIAL + BALL),
            joint("slide", "base", "ball", "prismatic", limit=LIMIT, axis="1 0 0"),
        ),
    )


def past_a_ball(rail: tm.Robot, gap: float, margin: float = 0.0) -> tm.Problem:
    """The ball passes another one, with a gap between them at q = 0.0123."""
    away = 2.0 * RADIUS + margin + gap
    post = tm.Sphere("post", radius=RADIUS, position=(1.0123, away, 0.0))
    scene = tm.Scene([post])
    return tm.Problem(rail, [-1.0], tm.JointGoal([1.0]), scene=scene, margin=margin)


@pytest.mark.parametrize("margin", (0.0, 0.02))
def test_replay_rejects_a_penetration_below_a_micrometre(
    rail: tm.Robot, margin: float
) -> None:
    free = tm.plan(tm.Problem(rail, [-1.0], tm.JointGoal([1.0]))).trajectory
    for gap in (-5e-6, -5e-7):
        found = tm.verify(past_a_ball(rail, gap, margin), free)
        assert not found.ok
        assert found.worst["clearance"].amount == pytest.approx(-gap, rel=0.01)
    for gap in (5e-6, 5e-7):
        found = tm.verify(past_a_ball(rail, gap, margin), free)
        assert found.ok
        assert found.min_clearance == pytest.approx(margin + gap, abs=1e-9)


def test_replay_finds_a_contact_between_two_samples(rail: tm.Robot) -> None:
    free = tm.plan(tm.Problem(rail, [-1.0], tm.JointGoal([1.0]))).trajectory
    fast = float(np.max(np.abs(free.v)))
    # The balls overlap for a tenth of a millisecond.
    depth = (0.5e-4 * fast) ** 2 / (2.0 * RADIUS)
    rows = tm.verify(past_a_ball(rail, 1.0), free).replay.q[:, 0]
    here = int(np.argmin(np.abs(rows)))
    between = 1.0 + 0.5 * (rows[here] + rows[here + 1])
    post = tm.Sphere(
        "post", radius=RADIUS, position=(between, 2.0 * RADIUS - 0.2 * depth, 0.0)
    )
    problem = tm.Problem(rail, [-1.0], tm.JointGoal([1.0]), scene=tm.Scene([post]))
    found = tm.verify(problem, free)
    assert np.all(problem.checker.distances(found.replay.q) > 0.0)
    assert not found.ok


def test_start_and_goal_in_contact_are_allowed(rail: tm.Robot) -> None:
    ends = [
        tm.Sphere(name, radius=RADIUS, position=(1.0 + x, 0.0, 0.0))
        for name, x in (("behind", -1.0 - 2 * RADIUS), ("before", 1.0 + 2 * RADIUS))
    ]
    problem = tm.Problem(rail, [-1.0], tm.JointGoal([1.0]), scene=tm.Scene(ends))
    solution = tm.plan(problem)
    assert solution.success
    assert solution.verification.min_clearance > -1e-5


@pytest.mark.parametrize("name", ("panda", "ur5", "xarm7", "kinova"))
def test_convex_pieces_contain_their_meshes(name: str) -> None:
    arm = tm.load_robot(name)
    for part, body in enumerate(link_bodies(arm, "mesh")):
        if not is_mesh(body.shape):
            continue
        vertices, corners = mesh_arrays(body.shape)
        weights = np.random.default_rng(0).dirichlet(np.ones(3), size=len(corners))
        inside = np.einsum("kc,kci->ki", weights, vertices[corners])
        vertices = np.concatenate([vertices, inside])
        beyond = np.full(len(vertices), np.inf)
        for piece in (item.shape for item in part_bodies(arm, part, "convex")):
            from scipy.spatial import ConvexHull

            planes = ConvexHull(np.array(piece.points())).equations
            outside = np.max(vertices @ planes[:, :3].T + planes[:, 3], axis=1)
            beyond = np.minimum(beyond, outside)
        assert np.max(beyond) < 1e-7


def test_least_clearance_matches_dense_samples(rail: tm.Robot) -> None:
    arm = tm.load_robot("ur5", limits="urdf")
    problem = tm.Problem(
        arm, [0.0, -1.2, 1.0, 0.0, 0.5, 0.0], tm.JointGoal([2, -0.8, 0.4, 0.3, -1, 1])
    )
    found = tm.plan(problem).verification
    rows = found.replay
    checker = problem.checker
    sampled = np.min(checker.distances(rows.q, 0.3, rows.t))
    assert found.min_clearance == pytest.approx(sampled, rel=0.1)
    pairs = len(checker.pairs)
    search = ClosestApproach(checker, rows, np.zeros(pairs), np.zeros((2, pairs)))
    least = search.run()
    assert not least.violated
    assert least.possible_violation == 0.0
