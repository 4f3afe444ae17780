r"""Initial guesses: paths over time, which must be feasible only at their ends.

Detours from a guess lead to other local optima: a motion that takes another way around
an obstacle, swings or flips its elbow differs from a given one by large arcs in some
joints. A bump is such an arc: :math:`16\,\tau^2 (1 - \tau)^2`, which is 1 halfway and
vanishes at both ends with its derivative, times the cosine of :math:`k \pi \tau`, which
divides it into two or three arcs.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from tominpmp.arrays import Array
from tominpmp.constraints.path import PathConstraint
from tominpmp.dynamics import directions
from tominpmp.initial_guess.constrained import feasible_path
from tominpmp.initial_guess.inverse_kinematics import MOST_TRIED, Target, end_velocity
from tominpmp.initial_guess.path import RoundedPath
from tominpmp.initial_guess.rrt import PathSearches, is_free, is_free_line, sample_paths
from tominpmp.initial_guess.timing import fastest_between, slowdown, time_path
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.problem_functions import ProblemFunctions

# Random starts of inverse kinematics for a goal that leaves the configuration open, and
# as many nearer to the start of the motion.
KINEMATIC_STARTS = 20
# The same in a second attempt, before a goal is refused: it may only be hard to reach,
# for example a pose within a narrow cone.
MORE_STARTS = 100
# Durations of untimed guesses, as multiples of an estimate of the minimum time.
DURATION_FACTOR = 2.0
# A joint is at rest at an end of a guess if its speed there is below this share of its
# mean speed up to the next sample.
RESTS = 0.5
# Name of the guess that stays at the start.
REST_GUESS = "at rest"
# Name of guesses with the velocities of moving ends.
MOVING = "moving"
# Name of guesses along paths around obstacles.
SAMPLED = "sampled path"
# Name of guesses through random configurations.
VIA_POINT = "via point"
# Number of samples of a guess.
SAMPLES = 200
# Number of sampled paths that are compared before the fastest one is tried. A path
# takes a tenth of the time of a descent, and the fastest path leads to the best
# optimum: in a cage, paths of 1.6 s and 2.6 s became motions of 1.2 s and 1.9 s.
BATCH = 2
# Number of guesses through via points between searches for a path, while no path is
# known. In narrow shelves a descent from the fourth found a motion before a search did.
VIA_GUESSES = 4
# A sampled path is not compared with others if its duration exceeds the duration of the
# straight line by at most this share.
NEAR = 0.2
# Height of a bump in a single joint [rad]: smaller bumps lead back to the same optimum,
# see benchmarks/known_optima.py. It is the largest standard deviation of random heights
# of bumps in all joints.
HEIGHT = 2.0
# Most arcs of a bump.
ARCS = 3
# Largest factor by which a detour may be too fast for its limits; faster detours are
# slowed down to it. Detours that are far too fast take a hundred programs; slower ones
# lead back to the straight line, although an arm that swings is faster. Former motions
# beyond it are slowed down to their limits.
TOO_FAST = 3.0


@dataclass(frozen=True, eq=False)
class Guess:
    """A path over time.

    Attributes:
        name: Name of the kind of guess, by which searches tell straight lines, paths
            around obstacles and via points apart.
        t: Times [s], increasing from 0, shape (m,).
        q: Configurations, shape (m, n) [rad or m].
        timed: Whether the duration follows from the limits along the path; otherwise
            from an estimate.
        delay: Time that the arm waits at the start [s], within the duration.
        feasible: Whether the guess satisfies the constraints on positions, where they
            were checked.
        blocked: Whether all configurations found for the goal are in collision.
        inner_ends: Times at which the segments before the last one end [s], without
            their dwells, shape (k - 1,).
        solved: Whether the guess is a motion that meets the goals of all segments, with
            their velocities.
    """

    name: str
    t: Array
    q: Array
    timed: bool
    delay: float = 0.0
    feasible: bool = True
    blocked: bool = False
    inner_ends: Array = field(default_factory=lambda: np.zeros(0))
    solved: bool = False

    @classmethod
    def of_motion(cls, motion: Trajectory) -> Guess:
        """The path of a motion, sampled at instants spaced evenly in time."""
        t = np.linspace(0.0, motion.duration, SAMPLES)
        return cls("motion", t, motion(t, 0), False)

    @property
    def duration(self) -> float:
        """T [s]."""
        return float(self.t[-1])

    @property
    def ends(self) -> Array:
        """Configurations at the ends of its segments, shape (k, n)."""
        return self.position(np.append(self.inner_ends, self.duration))

    @property
    def durations(self) -> Array:
        """Durations of the segments [s], shape (k,)."""
        return np.diff(np.concatenate([[0.0], self.inner_ends, self.t[-1:]]))

    def position(self, times: Array) -> Array:
        """Configurations at times, shape (k, n).

        Between samples the interpolation is smooth and does not overshoot. With linear
        interpolation the speed would jump in the short intervals at the ends, and cubic
        splines would overshoot.
        """
        return np.asarray(self._curve(np.clip(times, 0.0, self.duration)))

    @cached_property
    def _curve(self) -> CubicHermiteSpline:
        later = np.append(True, np.diff(self.t) > 0.0)
        t, q = self.t[later], self.q[later]
        slopes = PchipInterpolator(t, q, axis=0).derivative()(t)
        # A joint that starts or ends at rest has exactly zero speed there.
        for end, beside in ((0, 1), (-1, -2)):
            mean = (q[beside] - q[end]) / (t[beside] - t[end])
            slow = np.abs(slopes[end]) < RESTS * np.abs(mean)
            slopes[end] = np.where(slow, 0.0, slopes[end])
        return CubicHermiteSpline(t, q, slopes, axis=0)


@dataclass(frozen=True, eq=False)
class GuessRequest:
    """A request for guesses: the means to make them.

    Attributes:
        rng: Random numbers.
        duration: Duration of the guess at rest [s]; None for the duration of the
            fastest line, of those that satisfy the constraints if there are any.
        beyond: Constraints on positions that hold from the goal on.
        passes: Whether the arm may pass the goal, although the guesses stop there.
        onward: Estimates the time that the motion takes after the goal [s] from the
            configuration there, shape (n,); None if the motion ends at the goal.
        searches: Success of the searches for paths, which further searches update.
        goal_key: Number of the segment and identity of its goal; None for a problem
            without segments.
        reached: Final configurations by segment, goal, start, rest at the goal, and
            scene, see :meth:`final_configurations`; combinations of goals share them,
            so that inverse kinematics is solved once for each goal.
    """

    rng: np.random.Generator
    duration: float | None = None
    beyond: Sequence[PathConstraint] = ()
    passes: bool = False
    onward: Callable[[Array], float] | None = None
    searches: PathSearches = field(default_factory=PathSearches)
    goal_key: Hashable = None
    reached: dict[Hashable, tuple[list[Array], bool]] = field(default_factory=dict)

    def guesses(self, system: ProblemFunctions) -> Iterator[Guess]:
        """Initial guesses for a problem, the most promising first.

        The generator is lazy. The first guesses may collide: in most cases the
        optimiser moves them out of the obstacles faster than a path around these is
        found. Sampled paths follow if there are obstacles, or if the arm collides with
        itself on the fastest line; then paths through random via points. While no path
        is known, longer searches for one come between these.

        Args:
            system: Functions of the problem.

        Yields:
            Guesses without end; no guess if inverse kinematics did not reach the goal,
            or reached it only in collisions that cannot be resolved, or where the arm
            cannot rest.

        Raises:
            ProblemError: If no limit keeps a joint from moving arbitrarily fast.
        """
        ends, blocked = self.final_configurations(system)
        for guess in _guesses(system, ends, self) if ends else ():
            yield replace(guess, blocked=blocked)

    def final_configurations(
        self, system: ProblemFunctions
    ) -> tuple[list[Array], bool]:
        """Configurations that reach the goal, and whether all of them are in collision.

        A configuration that the goal itself gives was checked with the problem.
        """
        problem, goal = system.problem, system.problem.goal
        if goal.configuration is not None:
            return [goal.configuration], False
        target = Target(system, goal, beyond=self.beyond)
        begin = problem.q_start.tobytes()  # the nearest configurations come first
        key = self.goal_key or id(goal), begin, target.rests, problem.scene
        if key in self.reached:
            return self.reached[key]
        found, lost = list[Array](), False
        for count in (KINEMATIC_STARTS, MORE_STARTS):
            search = target.configurations(count, self.rng)
            found = search.best or found
            lost = target.all_unusable(found, passes=self.passes)
            if search.free and not lost:
                break
        self.reached[key] = [] if lost else found[:MOST_TRIED], not search.free
        return self.reached[key]


class CachedGuesses:
    """Guesses that can be iterated over repeatedly.

    Args:
        guesses: The guesses; each is made when it is first requested.
    """

    def __init__(self, guesses: Iterator[Guess]) -> None:
        self._guesses = guesses

    def since(self, number: int) -> Iterator[Guess]:
        """The guesses from an index on, counted from 0."""
        self._guesses, copy = itertools.tee(self._guesses)
        return itertools.islice(copy, number, None)


def straight_guess(system: ProblemFunctions, q_end: Array) -> Guess:
    """Straight line in joint space, in minimum time if it can be timed."""
    line = np.stack([system.problem.q_start, q_end])
    return along(system, line, "straight line")


def _line_guess(system: ProblemFunctions, q_end: Array) -> Guess:
    """The straight line, or a path near it that satisfies constraints.

    If the straight line satisfies the constraints on positions, the faster of both is
    taken.
    """
    (feasible, path), guesses = feasible_path(system, q_end), list[Guess]()
    if feasible or path is None:
        guesses.append(replace(straight_guess(system, q_end), feasible=feasible))
    if path is not None:
        guesses.append(along(system, path, "within constraints"))
    return min(guesses, key=_timed_duration)


def _timed_duration(guess: Guess) -> float:
    return guess.duration if guess.timed else np.inf


def _moving_guess(system: ProblemFunctions, q_end: Array) -> Guess | None:
    """Motion with the velocities of both ends, in the least feasible duration found.

    None if both ends rest, or the motion hits an obstacle.
    """
    problem, v_end = system.problem, end_velocity(system, q_end)
    if not (np.any(problem.v_start) or np.any(v_end)):
        return None
    at = fastest_between(system, q_end, v_end, SAMPLES)
    clear = system.in_free_space or is_free(system, at.q[::10])
    return Guess(MOVING, at.t, at.q, True, solved=True) if clear else None


def along(
    system: ProblemFunctions, corners: Array, name: str, *, clear: bool = False
) -> Guess:
    """Path with rounded corners, in minimum time if it can be timed.

    Args:
        system: Functions of the problem.
        corners: Corners of a polyline, shape (m, n) [rad or m].
        name: Name of the guess.
        clear: Whether the corners are rounded so that they are free of collisions, as
            the polyline is.
    """
    path = RoundedPath.through(corners, system.problem.robot.limits.velocity)
    if clear:
        path = path.clear_of_obstacles(lambda q: is_free(system, q))
    rests = np.all(np.ptp(path.corners, axis=0) <= 1e-12)
    timing = None if rests else time_path(system, path)
    if timing is None:
        return _untimed_guess(system, path.evaluate(_quintic())[0], name)
    times = np.linspace(0.0, timing.x[-1], SAMPLES)
    q, _, _ = path.evaluate(np.clip(timing(times), 0.0, 1.0))
    return Guess(name, slowdown(system, times, q) * times, q, True)


def _via_guess(system: ProblemFunctions, via: Array, q_end: Array) -> Guess:
    """Quadratic Bézier curve through a via point halfway, from rest to rest."""
    start, s = system.problem.q_start, _quintic()
    # Passes the configuration at s = 1/2.
    middle = 2.0 * via - 0.5 * (start + q_end)
    weights = np.stack([(1.0 - s) ** 2, 2.0 * s * (1.0 - s), s**2], axis=1)
    limits = system.problem.robot.limits
    q = weights @ np.stack([start, middle, q_end])
    q = np.clip(q, limits.position_lower, limits.position_upper)
    return _untimed_guess(system, q, VIA_POINT)


def _quintic() -> Array:
    """Path parameter from rest to rest, shape (SAMPLES,)."""
    s = np.linspace(0.0, 1.0, SAMPLES)
    return np.asarray(s**3 * (10.0 + s * (6.0 * s - 15.0)))


def _untimed_guess(system: ProblemFunctions, q: Array, name: str) -> Guess:
    duration = DURATION_FACTOR * least_time(system, q)
    times = duration * np.linspace(0.0, 1.0, SAMPLES)
    return Guess(name, slowdown(system, times, q) * times, q, False)


def least_time(system: ProblemFunctions, q: Array) -> float:
    """Least duration of a path, estimated from speed and torque limits [s].

    Args:
        system: Functions of the problem.
        q: Configurations at instants spaced evenly in time, shape (m, n).
    """
    limits, count = system.problem.robot.limits, q.shape[0]
    unit = np.linspace(0.0, 1.0, count)
    v = np.gradient(q, unit, axis=0)
    a = np.gradient(v, unit, axis=0)
    speed = float(np.max(np.abs(v) / limits.velocity, initial=0.0))
    zero = np.zeros_like(q)
    hold = system.torque(q, zero, zero)
    need = system.torque(q, v, a) - hold
    if system.friction is not None:
        # Dry friction does not decrease with the speed of the motion.
        dry = system.friction * directions(v, a)
        need, hold = need - dry, hold + dry
    # Friction grows with 1/T and inertia with 1/T^2; the larger bound covers both.
    room = np.maximum(1.0 - np.abs(hold), 0.1)
    ratio = float(np.max(np.abs(need) / room, initial=0.0))
    return max(speed, float(np.sqrt(ratio)), 1e-3)


def _guesses(
    system: ProblemFunctions,
    ends: Sequence[Array],
    request: GuessRequest,
) -> Iterator[Guess]:
    """Guesses to given final configurations, without end."""
    system = system.passing(np.stack(ends))
    problem, rng = system.problem, request.rng
    final = problem.goal.configuration
    lines = [(_line_guess(system, q), q) for q in ends]
    lines.sort(key=lambda line: (not line[0].feasible, _timed_duration(line[0])))
    if request.onward is not None:
        # Only the first guess looks ahead, so that further ones differ from it.
        T = [_timed_duration(line) + request.onward(q) for line, q in lines]
        best = min(range(len(lines)), key=lambda i: (not lines[i][0].feasible, T[i]))
        lines.insert(0, lines.pop(best))
    straight, ends = zip(*lines, strict=True)
    moving = filter(None, (_moving_guess(system, q) for q in ends))
    direct = (*sorted(moving, key=_timed_duration), *straight)
    # A guess at rest at the start, with the given duration or that of the fastest line.
    times = np.array([0.0, request.duration or straight[0].duration])
    rest = Guess(REST_GUESS, times, np.tile(problem.q_start, (2, 1)), False)
    if system.in_free_space:
        yield from direct
        # The initial guess of the paper, which does not even reach the goal: the linear
        # programs choose the final configuration. Over 33 goals it led to no shorter T
        # than the best of three lines, at twice the planning time.
        yield from [rest] if final is None else []
    else:
        yield from [direct[0], rest] if final is None else direct
    line = np.stack([problem.q_start, ends[0]])
    clear = system.clearance is None or is_free_line(system, *line)

    def sampled() -> Iterator[Guess]:
        known, enough = [line] if clear else [], (1.0 + NEAR) * straight[0].duration
        return sampled_guesses(system, ends, request, known=known, enough=enough)

    # In free space sampled paths are needed only if the arm collides with itself on the
    # straight line.
    if not (system.in_free_space and clear):
        yield from sampled()
    if not system.in_free_space and final is None:
        yield from direct[1:]
    limits = problem.robot.limits
    low = np.maximum(limits.position_lower, problem.q_start - np.pi)
    high = np.minimum(limits.position_upper, problem.q_start + np.pi)
    while True:
        for _ in range(VIA_GUESSES):
            end = ends[int(rng.integers(len(ends)))]
            yield _via_guess(system, rng.uniform(low, high), end)
        if not (clear or request.searches.found):
            yield from sampled()


def sampled_guesses(
    system: ProblemFunctions,
    ends: Sequence[Array],
    request: GuessRequest,
    *,
    known: Sequence[Array] = (),
    enough: float = 0.0,
) -> Iterator[Guess]:
    """Collision-free paths, timed; the fastest path of each batch comes first.

    Paths that are alike to the known free paths, each of shape (m, n), are left out.
    The number of paths depends on the obstacles. If the first path takes at most
    ``enough`` [s], it is not compared with others.
    """
    paths = sample_paths(system, ends, request.rng, request.searches, known=known)
    guesses = (along(system, path, SAMPLED, clear=True) for path in paths)
    batch = list(itertools.islice(guesses, 1))
    if not all(guess.timed and guess.duration <= enough for guess in batch):
        batch += itertools.islice(guesses, BATCH - 1)
    while batch:
        yield from sorted(batch, key=lambda guess: (not guess.timed, guess.duration))
        batch = list(itertools.islice(guesses, BATCH))


def bumps(
    system: ProblemFunctions,
    guess: Guess,
    rng: np.random.Generator,
    *,
    from_base: bool = False,
) -> Iterator[Guess]:
    """Detours from a guess: of single joints in both directions, then of all at random.

    Args:
        system: Functions of the problem, whose position limits are kept.
        guess: The guess to which the bumps are added.
        rng: Random numbers.
        from_base: Whether the joint nearest to the base comes first, as detours of a
            wrist hardly matter; otherwise the last joint does.

    Yields:
        Guesses, without end.
    """
    order = range(system.n) if from_base else range(system.n)[::-1]
    for arcs, joint, height in itertools.product(range(ARCS), order, (-HEIGHT, HEIGHT)):
        heights = np.zeros((ARCS, system.n))
        heights[arcs, joint] = height
        yield bumped(system, guess, heights)
    shares = 1.0 / np.arange(1, ARCS + 1)[:, None]
    while True:
        heights = HEIGHT * rng.uniform() * rng.normal(size=(ARCS, system.n))
        yield bumped(system, guess, shares * heights)


def bumped(system: ProblemFunctions, guess: Guess, heights: Array) -> Guess:
    """A guess with bumps, slowed down if it is far too fast with them.

    Args:
        system: Functions of the problem.
        guess: The guess, at instants spaced evenly in time.
        heights: Heights by number of arcs and joint, shape (k, n), in rad, or in shares
            of the reach for prismatic joints.
    """
    tau = guess.t / guess.duration
    arc = 16.0 * tau**2 * (1.0 - tau) ** 2
    waves = np.cos(np.pi * np.arange(len(heights)) * tau[:, None])
    limits = system.problem.robot.limits
    q = guess.q + (arc[:, None] * waves) @ (heights * system.step_scale)
    q = np.clip(q, limits.position_lower, limits.position_upper)
    too_fast = least_time(system, q) / guess.duration
    slower = max(1.0, too_fast / TOO_FAST)
    return Guess("detour", slower * guess.t, q, False)
