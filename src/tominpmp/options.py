"""Options of a plan: one frozen record, checked when it is made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Annotated, Any, Literal, TypeAlias, get_args

import numpy as np

import tominpmp.checks as checks
from tominpmp.arrays import Array, Record, array_or_nan, number_or_nan
from tominpmp.exceptions import OptionsError, unknown
from tominpmp.status import IterationRecord

Method = Literal["auto", "inverse", "collocation", "adjoint", "penalty"]
Control = Literal["auto", "constant", "linear", "spline"]
StepRule = Literal["adaptive", "paper"]
Grid = Literal["cosine", "uniform"]
Objective = Literal["time", "feasible"]
Effort = Literal["quick", "standard", "thorough"]
Energy = Literal["torque_squared", "work"]
Refinement = Literal["auto", "grid", "switching"]
EFFORTS = get_args(Effort)
CHOICES = {
    "method": get_args(Method),
    "step_rule": get_args(StepRule),
    "control": get_args(Control),
    "grid": get_args(Grid),
    "objective": get_args(Objective),
    "effort": EFFORTS,
    "energy": get_args(Energy),
    "refine": (*get_args(Refinement), None),
}
# Default limit of the planning time, by effort [s]. On the golden set it cuts short a
# tenth of the quick plans, and one of 37 standard ones (``python -m
# benchmarks.latency``).
TIME_LIMITS = {"quick": 2.0, "standard": 10.0, "thorough": 60.0}
# Least number of periods of a motion on a controller's clock, or of a segment of it;
# the shortest motions last longer than they need.
FEWEST_PERIODS = 4
# Largest value of numbers without a smaller one: beyond any use, while its square is
# still finite.
LARGEST = 1e9
# Longest period of a controller [s].
LONGEST_PERIOD = 1.0


def _number(
    value: object, name: str, expected: str, above: float = -1.0, most: float = LARGEST
) -> float:
    """Check a number that is 0 at least, or above a bound, and not too large."""
    if number_or_nan(value) > most:
        expected = f"{expected}, at most {most:g}"
    return checks.number(value, name, expected, 0.0, above, most)


def _time_limit(value: object, name: str) -> float:
    """Check a positive time, which may be infinite [s]."""
    return np.inf if number_or_nan(value) == np.inf else _positive(value, name)


def _torques(value: Any, name: str) -> Array:
    """Check torques of one instant, (n,), or of all intervals, (N, n) [N m]."""
    control = array_or_nan(value)
    shaped = control.ndim in (1, 2) and control.size > 0
    if not shaped or not np.all(np.isfinite(control)):
        expected = "finite torques, of shape (n,) or (N, n) [N m]"
        raise checks.wrong(value, name, expected)
    return control


_positive = partial(_number, expected="a positive number", above=0.0)
_share = partial(_number, expected="a number >= 0, or None")
_weight = partial(_number, expected="a number >= 0 [1/(N^2 m^2) or s/J]")
_solver = partial(checks.text, expected="the name of a solver")
_period = partial(_positive, expected="a positive number [s]", most=LONGEST_PERIOD)
_tolerance = partial(
    checks.number, expected="a tolerance >= 0", least=0.0, infinite=True
)
# Types of the options with their checks. Larger values are taken for a mistake, before
# they fill the memory or start too many processes.
Intervals: TypeAlias = Annotated[int, partial(checks.whole, least=4, most=10_000)]
Iterations: TypeAlias = Annotated[int, partial(checks.whole, least=1, most=1_000_000)]
Processes: TypeAlias = Annotated[int, partial(checks.whole, least=1, most=256)]
Seed: TypeAlias = Annotated[int, partial(checks.whole, most=2**63 - 1)]
Starts: TypeAlias = Annotated[int, partial(checks.whole, least=1, most=10_000)]
Positive: TypeAlias = Annotated[float, _positive]
TimeLimit: TypeAlias = Annotated[float, _time_limit]
Period: TypeAlias = Annotated[float, _period]
Share: TypeAlias = Annotated[float, _share]
Slack: TypeAlias = Annotated[float, partial(_share, most=10.0)]
Weight: TypeAlias = Annotated[float, _weight]
Tolerance: TypeAlias = Annotated[float, _tolerance]
SolverName: TypeAlias = Annotated[str, _solver]
Torques: TypeAlias = Annotated[Array, _torques]
Callback: TypeAlias = Annotated[
    "Callable[[IterationRecord], bool | None]", checks.of_type(Callable, "a function")
]


@dataclass(frozen=True, kw_only=True, eq=False)
class Tolerances(Record):
    """Largest deviations with which the replay of a motion still confirms it.

    Attributes:
        goal: Distance from the goal at the end [rad or m].
        speed: Difference to the velocity at the end [rad/s or m/s].
        limits: Excess over position, velocity and effort limits: relative to the limit;
            for positions and efforts relative to the range.
        contact: Clearance that may be missing at a start or goal in contact [m].
    """

    goal: Tolerance = 1e-3
    speed: Tolerance = 1e-2
    limits: Tolerance = 5e-3
    contact: Tolerance = 1e-5

    def __post_init__(self) -> None:
        """Check every tolerance."""
        with checks.raised_as(OptionsError):
            super().__post_init__()


@dataclass(frozen=True, kw_only=True, eq=False)
class Options(Record):
    """Options of a plan. The defaults are sensible for any arm.

    Attributes:
        method: Transcription: "inverse" (accelerations, torque limits as rows),
            "collocation" (states and torques), "adjoint" (the paper's), "penalty" (the
            paper's comparison), or "auto": "inverse" for arms with a motor at every
            joint, else "collocation".
        intervals: Number N of intervals of the time grid of the search, 10 000 at most.
            Several segments share them, each having 10 (or N) at least.
            The grid of the resulting motion may have more intervals, see ``refine``.
        grid: "cosine" (short intervals at both ends, see
            :func:`~tominpmp.transcription.grid.interval_shares`) or "uniform".
        control: How the torque (adjoint, collocation) or the acceleration (inverse)
            runs over an interval: "constant", or for "inverse" also "linear"
            (continuous accelerations) and "spline" (smooth ones); "auto" takes "linear"
            where limits require it, or where torques are the active limits on 24
            intervals or more, and otherwise "constant", as with active speed limits or
            several segments.
        objective: "time" for the fastest motion, or "feasible" for the first one that
            keeps all constraints, in its replay too; its time is not minimised.
        effort: How widely the planner searches for a global optimum: "quick" (one
            descent to the nearest local optimum), "standard" (a few more on coarse
            grids, where a faster motion may exist and they take little time), or
            "thorough" (many more, of all kinds, and until the time limit if one is
            given). A higher effort repeats the attempts of a lower one, and then adds
            others.
        energy_weight: Weight k of the energy, in 1/(N^2 m^2) or s/J according to
            ``energy``: the objective is T + k times the energy; 0 for time alone. The
            fastest motion, with which the search for the least objective begins, is
            planned with quick effort and without refinement.
        energy: Definition of the energy: "torque_squared", the integral of the squared
            torques of all motors over time [N^2 m^2 s], including the forces of
            prismatic joints [N], which is proportional to the heat losses of motors; or
            "work", the mechanical work of all motors [J], each motor by itself: the
            energy of braking is neither recovered nor counted.
        slack: Share of T to give away for quiet torques: the planned motion is passed
            to :func:`tominpmp.smooth`. None skips that step.
        refine: Stage after the first solve: "auto" (intervals of the best motion are
            halved where its controls bend, as long as that promises 0.3 % of T, or
            0.03 % with thorough effort; not for "adjoint" and "penalty"); None, for a
            motion on the grid of the search; "grid" (the same as "auto", as long as
            that promises 0.03 % of T); "switching" (the instants at which torques
            switch become unknowns, for small arms, and other orders of the switches are
            tried unless ``starts`` is 1).
        smoothing: Weight of the total variation of the controls in the objective, in s
            per full range: it makes controls quiet where the minimum time leaves them
            free. None takes 1e-4 T for "inverse" and "collocation" in free space, but
            zero on fine grids, where it costs 0.1 % of T; among obstacles the same
            weight, on the squares of the jumps unless "highs" is the solver of the
            linear programs; and 0 for "adjoint" and "penalty".
        starts: Number of initial guesses; None lets the planner choose. A larger number
            keeps the attempts of a smaller one and adds others; as long as no attempt
            has led to a motion, more are made in any case.
        seed: Seed of all random numbers.
        max_planning_time: Time limit [s], kept to 10 % and 0.2 s, counted from the call
            of the planner; the best motion so far is returned, and verified within that
            time. The default depends on the effort: 2 s for "quick", 10 s for
            "standard", 60 s for "thorough"; infinity is no limit.
        max_iterations: Largest number of iterations per start.
        tolerance: Relative progress below which the iteration stops: when the last
            three iterations together reduced T by less than this share.
        feasibility: Largest constraint violation that counts as feasible: relative for
            torques and velocities, in m and rad for goals and clearances. A start
            within this distance of its goal takes no time.
        goal_tolerance: Distance from the goal [rad or m] at which the independent
            replay of a motion may end, see :class:`Tolerances`.
        speed_tolerance: Deviation from the velocity of the goal [rad/s or m/s] with
            which the replay may end.
        limit_tolerance: Relative excess of the replay over limits that is tolerated.
        contact_tolerance: Clearance that may be missing at a start or goal that is
            itself at the margin [m]; elsewhere the whole clearance is required.
        trust_region: Initial radius of the trust region [rad].
        step_rule: For "adjoint": "adaptive", or "paper" (fixed radii, every step
            accepted).
        control_step: Largest torque change per iteration with the step rule "paper",
            the paper's rho [N m].
        time_step: Largest change of T per iteration with the step rule "paper", the
            paper's epsilon [s].
        initial_duration: Duration of the initial guess at rest [s], the paper's T^0,
            for "adjoint", "penalty" and goals on frames; None lets the planner choose.
        initial_control: Initial torques for "adjoint" and "penalty", the paper's u^0,
            shape (n,) or (N, n) [N m]; None for zero if a duration is given, and
            otherwise for torques that track the first guess of other methods.
        lp_solver: Solver of the linear programs: "highs" (dual simplex, warm started),
            "piqp" (interior point), the name of any other solver that qpsolvers knows,
            or "auto".
        control_period: Period of the controller that executes the motion as samples
            [s]: all knots and the duration become multiples of it, so that the
            polynomials by which the controller interpolates the samples are the motion
            itself, see :mod:`~tominpmp.transcription.grid`. At most a second; None
            leaves the knots free.
        processes: Number of processes over which several starts are distributed, up to
            256; no more are started than there are cores, and the result does not
            depend on their number.
        callback: Called with an IterationRecord after every iteration; returning True
            stops the planning, and an error that it raises ends it.
    """

    method: Method = "auto"
    intervals: Intervals = 40
    grid: Grid = "cosine"
    control: Control = "auto"
    objective: Objective = "time"
    effort: Effort = "standard"
    energy_weight: Weight = 0.0
    energy: Energy = "torque_squared"
    slack: Slack | None = None
    refine: Refinement | None = "auto"
    smoothing: Share | None = None
    starts: Starts | None = None
    seed: Seed = 0
    max_planning_time: TimeLimit | None = None
    max_iterations: Iterations = 100
    tolerance: Positive = 2e-4
    feasibility: Positive = 1e-6
    goal_tolerance: Positive = Tolerances.goal
    speed_tolerance: Positive = Tolerances.speed
    limit_tolerance: Positive = Tolerances.limits
    contact_tolerance: Positive = Tolerances.contact
    trust_region: Positive = 0.3
    step_rule: StepRule = "adaptive"
    control_step: Positive = 0.05
    time_step: Positive = 0.01
    initial_duration: Positive | None = None
    initial_control: Torques | None = None
    lp_solver: SolverName = "auto"
    control_period: Period | None = None
    processes: Processes = 1
    callback: Callback | None = None

    def __post_init__(self) -> None:
        """Check every option."""
        with checks.raised_as(OptionsError):
            for name, known in CHOICES.items():
                checks.choice(getattr(self, name), known, name)
            super().__post_init__()

    @property
    def time_limit(self) -> float:
        """Allowed planning time [s]; infinite without a limit."""
        if self.max_planning_time is None:
            return TIME_LIMITS[self.effort]
        return self.max_planning_time

    @property
    def tolerances(self) -> Tolerances:
        """Largest deviations with which the replay still confirms a motion."""
        return Tolerances(
            goal=self.goal_tolerance,
            speed=self.speed_tolerance,
            limits=self.limit_tolerance,
            contact=self.contact_tolerance,
        )

    @classmethod
    def of(cls, options: Options | None) -> Options:
        """The caller's options; the defaults for None.

        Raises:
            ProblemError: If they are not options.
        """
        if options is None:
            return cls()
        return checks.instance(options, Options, "options", "Options or None")

    def changed(self, changes: Mapping[str, Any]) -> Options:
        """A copy of these options with some values changed.

        Args:
            changes: New values by the name of the option.

        Raises:
            OptionsError: If an option is unknown, or its value is wrong.
        """
        checks.instance(changes, Mapping, "changes", "values of options by name")
        known = self.names()
        for name in changes:
            if name not in known:
                raise OptionsError(unknown("option", name, known), option=name)
        return replace(self, **changes) if changes else self

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Names of all options."""
        return tuple(item.name for item in fields(cls))
