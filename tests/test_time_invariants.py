"""Invariants of minimum times: scaling, mirror images, wider limits, obstacles.

Each law maps one problem onto another, or orders the durations of two problems; they
are compared up to the share of T to which iterations converge.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from optimum_cases import ROD
from sample_arms import DOWNWARD, Link, make_arm, slide

import tominpmp as tm

Array = NDArray[np.float64]

METHODS = ("inverse", "collocation")
INTERVALS = 24
# Share of T to which two iterations agree, with allowance for their smoothing;
# iterations of collocation stop farther from their limit.
SETTLED = {"inverse": 1e-3, "collocation": 6e-3}

EFFORT = np.array([10.0, 5.0])
FRICTION = np.array([2.0, 1.0])
START, GOAL = np.array([-0.4, 0.6]), np.array([0.9, -0.3])


def least_time(
    robot: tm.Robot,
    start: ArrayLike,
    goal: ArrayLike,
    method: str = "inverse",
    *,
    v_start: Array | None = None,
    v_goal: Array | None = None,
    scene: tm.Scene | None = None,
) -> float:
    problem = tm.Problem(
        robot,
        np.asarray(start),
        tm.JointGoal(np.asarray(goal), v_goal),
        scene=tm.Scene() if scene is None else scene,
        v_start=v_start,
    )
    options = tm.Options(
        method=method,
        intervals=INTERVALS,
        grid="uniform",
        effort="quick",
        refine=None,
    )
    solution = tm.plan(problem, options)
    assert solution.status is tm.Status.CONVERGED, solution.message
    return solution.T


@pytest.mark.parametrize(
    ("method", "factor"), [("inverse", 0.5), ("inverse", 3.0), ("collocation", 3.0)]
)
def test_scaled_efforts_and_speeds_scale_the_duration(
    method: str, factor: float
) -> None:
    # Without gravity, t -> t / s makes inertial torques s^2 times as big, friction s.
    slow = make_arm(ROD, ROD, effort=EFFORT, damping=FRICTION, velocity=2.5)
    fast = make_arm(
        ROD,
        ROD,
        effort=factor**2 * EFFORT,
        damping=factor * FRICTION,
        velocity=factor * 2.5,
    )
    T = least_time(slow, START, GOAL, method)
    assert least_time(fast, START, GOAL, method) == pytest.approx(
        T / factor, rel=SETTLED[method]
    )


def test_scaled_efforts_of_the_planar_arm_scale_its_duration(
    planar3r: tm.Robot,
) -> None:
    factor = 2.0
    slow = planar3r.with_changes(gravity=(0.0, 0.0, 0.0))
    fast = slow.with_changes(
        effort=factor**2 * slow.limits.effort_upper, damping=factor * slow.damping
    )
    start, goal = np.array([0.5, 0.3, 0.2]), np.array([1.6, -0.8, 0.9])
    T = least_time(slow, start, goal)
    assert least_time(fast, start, goal) == pytest.approx(
        T / factor, rel=SETTLED["inverse"]
    )


@pytest.mark.parametrize("method", METHODS)
def test_scaled_masses_and_efforts_keep_the_duration(method: str) -> None:
    # Links and motors scaled alike move alike.
    heavy = replace(ROD, mass=7.0 * ROD.mass, inertia=7.0 * ROD.inertia)
    light = make_arm(ROD, ROD, effort=EFFORT, gravity=DOWNWARD, damping=FRICTION)
    strong = make_arm(
        heavy, heavy, effort=7.0 * EFFORT, gravity=DOWNWARD, damping=7.0 * FRICTION
    )
    start, goal = np.array([-1.5, 0.1]), np.array([-1.25, 0.3])
    T = least_time(light, start, goal, method)
    assert least_time(strong, start, goal, method) == pytest.approx(
        T, rel=SETTLED[method]
    )


@pytest.mark.parametrize("method", METHODS)
def test_scaled_lengths_and_efforts_keep_the_duration(method: str) -> None:
    # Lengths by s: inertias, friction and, without gravity, torques by s^2.
    long = replace(ROD, length=2.0, centre=1.0, inertia=4.0 * ROD.inertia)
    arm = make_arm(ROD, ROD, effort=EFFORT, damping=FRICTION)
    T = least_time(arm, START, GOAL, method)
    other = make_arm(long, long, effort=4.0 * EFFORT, damping=4.0 * FRICTION)
    assert least_time(other, START, GOAL, method) == pytest.approx(
        T, rel=SETTLED[method]
    )


@pytest.mark.parametrize("method", METHODS)
def test_mirrored_motion_takes_the_same_duration(method: str) -> None:
    # Mirrored about x in the level plane; about y upright, with the base angle pi - q.
    arm = make_arm(ROD, ROD, effort=EFFORT, damping=FRICTION)
    T = least_time(arm, START, GOAL, method)
    assert least_time(arm, -START, -GOAL, method) == pytest.approx(
        T, rel=SETTLED[method]
    )
    upright = make_arm(
        ROD, ROD, effort=4.0 * EFFORT, gravity=DOWNWARD, damping=FRICTION
    )
    start, goal = np.array([-0.9, 0.3]), np.array([-0.2, 0.5])
    sign, offset = np.array([-1.0, -1.0]), np.array([np.pi, 0.0])
    T = least_time(upright, start, goal, method)
    mirrored = least_time(upright, offset + sign * start, offset + sign * goal, method)
    assert mirrored == pytest.approx(T, rel=SETTLED[method])


@pytest.mark.parametrize("method", METHODS)
def test_motion_with_a_turned_base_takes_the_same_duration(method: str) -> None:
    arm = make_arm(ROD, ROD, effort=EFFORT, damping=FRICTION)
    turn = np.array([2.0, 0.0])
    T = least_time(arm, START, GOAL, method)
    turned = least_time(arm, START + turn, GOAL + turn, method)
    assert turned == pytest.approx(T, rel=SETTLED[method])


def test_reversed_motion_takes_the_same_duration() -> None:
    # Without friction and gravity time can run backwards, with the speeds reversed.
    # Not so by collocation, whose scheme has its stages at a third and at the end.
    arm = make_arm(ROD, ROD, effort=EFFORT)
    slow, quick = np.array([0.2, 0.1]), np.array([0.4, -0.3])
    T = least_time(arm, START, GOAL, v_start=slow, v_goal=quick)
    back = least_time(arm, GOAL, START, v_start=-quick, v_goal=-slow)
    assert back == pytest.approx(T, rel=SETTLED["inverse"])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "wider",
    [
        {"effort": np.array([13.0, 5.0])},
        {"effort": np.array([10.0, 6.0])},
        {"effort": np.array([[-10.0, 12.0], [-7.0, 5.0]])},
        {"velocity": np.array([2.0, 1.8])},
        {"velocity": np.array([1.8, 2.2])},
    ],
    ids=["shoulder", "elbow", "one-sided", "fast shoulder", "fast elbow"],
)
def test_wider_limits_never_lengthen_the_motion(
    method: str, wider: dict[str, Array]
) -> None:
    narrow = make_arm(ROD, ROD, effort=EFFORT, damping=FRICTION, velocity=1.8)
    T = least_time(narrow, START, GOAL, method)
    wide_T = least_time(narrow.with_changes(**wider), START, GOAL, method)
    assert wide_T <= T * (1.0 + SETTLED[method])


def test_friction_and_mass_lengthen_the_motion_on_a_rail() -> None:
    # This holds on one rail; friction may help an arm to brake.
    def rail(mass: float, friction: float) -> tm.Robot:
        return make_arm(slide(mass), effort=10.0, damping=friction)

    times = [
        least_time(rail(mass, friction), [0.0], [1.0], "collocation")
        for mass, friction in [(1.0, 0.0), (2.0, 0.0), (2.0, 2.0), (2.0, 8.0)]
    ]
    assert np.all(np.diff(times) > 0.0)


@pytest.mark.parametrize("method", METHODS)
def test_stop_at_a_via_point_lengthens_the_motion(method: str) -> None:
    arm = make_arm(ROD, ROD, effort=EFFORT, damping=FRICTION)
    middle = np.array([0.3, 0.4])
    direct = least_time(arm, START, GOAL, method)
    first = least_time(arm, START, middle, method)
    second = least_time(arm, middle, GOAL, method)
    assert direct < first + second


def test_obstacles_never_shorten_the_motion(planar3r: tm.Robot) -> None:
    start, goal = np.array([0.6, 0.2, 0.2]), np.array([1.6, 0.2, 0.2])
    near = tm.Sphere("near", radius=0.5, position=(3.6, 5.2, 0.0))
    nearer = tm.Sphere("nearer", radius=0.8, position=(3.4, 4.6, 0.0))
    times: list[float] = []
    harder = None
    for obstacles in ([near, nearer], [near], []):
        problem = tm.Problem(
            planar3r, start, tm.JointGoal(goal), scene=tm.Scene(obstacles)
        )
        found = tm.plan(problem)
        if harder is not None:  # its motion is feasible here, too
            found = min(found, tm.plan(problem, start=harder), key=lambda one: one.T)
        assert found.success, found.message
        harder = found
        times.insert(0, found.T)
    assert times[0] <= times[1] * (1.0 + SETTLED["inverse"])
    assert times[1] <= times[2] * (1.0 + SETTLED["inverse"])
    # The sphere "nearer" is in the way.
    assert times[2] > 1.01 * times[0]


def test_light_idle_joint_keeps_the_duration() -> None:
    # A third link of hardly any mass that stays where it is.
    feather = Link(1e-6, 0.1, 0.05, 1e-8)
    two = make_arm(ROD, ROD, effort=EFFORT, damping=FRICTION)
    three = make_arm(
        ROD,
        ROD,
        feather,
        effort=np.append(EFFORT, 1.0),
        damping=np.append(FRICTION, 0.0),
    )
    T = least_time(two, START, GOAL)
    assert least_time(three, [*START, 0.2], [*GOAL, 0.2]) == pytest.approx(
        T, rel=SETTLED["inverse"]
    )


def test_scaled_speeds_of_obstacles_scale_the_duration(planar3r: tm.Robot) -> None:
    # Like a film that runs twice as fast: the obstacles do, too.
    factor = 2.0
    slow = planar3r.with_changes(gravity=(0.0, 0.0, 0.0))
    fast = slow.with_changes(
        effort=factor**2 * slow.limits.effort_upper,
        damping=factor * slow.damping,
        velocity=factor * slow.limits.velocity,
    )
    start, goal = np.array([0.6, 0.2, 0.2]), np.array([1.6, 0.2, 0.2])

    def gate(speed: float) -> tm.Scene:
        velocity = (-0.4 * speed, 0.6 * speed, 0.0)
        motion = tm.ConstantVelocity(velocity=velocity)
        ball = tm.Sphere("gate", radius=0.6, position=(3.6, 4.4, 0.0), motion=motion)
        return tm.Scene([ball])

    free = least_time(slow, start, goal)
    T = least_time(slow, start, goal, scene=gate(1.0))
    assert T > 1.005 * free
    assert least_time(fast, start, goal, scene=gate(factor)) == pytest.approx(
        T / factor, rel=SETTLED["inverse"]
    )
