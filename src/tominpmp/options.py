"""Options of a plan: one frozen record, checked when it is made."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from tominpmp.arrays import Array, Record, array_or_nan, number_or_nan
from tominpmp.checks import choice, instance, number, text, whole, wrong
from tominpmp.exceptions import OptionsError, brief

if TYPE_CHECKING:
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
# Whole numbers, and the least that each may be.
WHOLE = {"intervals": 4, "max_iterations": 1, "processes": 1, "seed": 0, "starts": 1}
POSITIVE = (
    *("max_planning_time", "initial_duration", "control_period", "trust_region"),
    *("tolerance", "feasibility", "control_step", "time_step"),
    *("goal_tolerance", "speed_tolerance", "limit_tolerance", "contact_tolerance"),
)
# More is taken for a mistake, before it fills the memory or starts too many processes.
MOST = {
    "intervals": 10_000,
    "max_iterations": 1_000_000,
    "processes": 256,
    "seed": 2**63 - 1,
    "starts": 10_000,
    "slack": 10.0,
    "control_period": 1.0,
}
# Planning time that is allowed where a caller sets no limit, by effort [s]. On the
# golden set it cuts short a tenth of the quick plans, and one of 37 standard ones
# (``python -m benchmarks.latency``).
TIME_LIMITS = {"quick": 2.0, "standard": 10.0, "thorough": 60.0}
# Likewise for all other numbers: longer than anybody waits, and squares still fit.
LARGEST = 1e9
# A motion on the clock of a controller, or a segment of one, has so many periods at
# least; the shortest have more than they need.
FEWEST_PERIODS = 4


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """What the replay of a motion may be off by to be believed.

    Attributes:
        goal: Distance from the goal at the end [rad or m].
        speed: Difference to the velocity at the end [rad/s or m/s].
        limits: Excess over position, velocity and effort limits: relative to the limit,
            for positions and efforts to the range.
        contact: Clearance that a pair may lack around a start or goal that touches [m].
    """

    goal: float = 1e-3
    speed: float = 1e-2
    limits: float = 5e-3
    contact: float = 1e-5

    def __post_init__(self) -> None:
        """Check every tolerance."""
        for item in fields(self):
            given, expected = getattr(self, item.name), "a tolerance >= 0"
            found = number(
                given, item.name, expected, 0.0, infinite=True, error=OptionsError
            )
            object.__setattr__(self, item.name, found)


@dataclass(frozen=True, kw_only=True, eq=False)
class Options(Record):
    """How a motion is planned. The defaults are sensible for any arm.

    Attributes:
        method: Transcription: "inverse" (accelerations, torque limits as rows),
            "collocation" (states and torques), "adjoint" (the paper's), "penalty" (the
            paper's comparison), or "auto": "inverse" for arms with a motor at every
            joint, else "collocation".
        intervals: Number N of intervals of the time grid of the search, 10 000 at most.
            Several segments share them, each having 10 (or N) at least.
            The motion that is found may have more, see ``refine``.
        grid: "cosine" (short intervals at both ends, see
            :func:`~tominpmp.transcription.grid.interval_shares`) or "uniform".
        control: How the torque (adjoint, collocation) or the acceleration (inverse)
            runs over an interval: "constant", or for "inverse" also "linear"
            (continuous accelerations) and "spline" (smooth ones); "auto" takes
            "linear" where limits need it, or torques rule on 24 intervals or more, and
            else, where speeds rule and with several segments, "constant".
        objective: "time" for the fastest motion, or "feasible" for the first one that
            keeps all constraints, in its replay too; its time is not minimised.
        effort: How far the best motion is looked for, rather than the nearest: "quick"
            (one descent), "standard" (a few more on coarse grids, where a faster motion
            may exist and they take little time), or "thorough" (many more, of all
            kinds, and for as long as ``max_planning_time`` lasts if that is given).
            More effort makes the attempts of less, and then others.
        energy_weight: Weight k of the energy, in 1/(N^2 m^2) or s/J as ``energy`` says:
            what is least is then T + k times the energy; 0 for time alone.
        energy: Which energy: "torque_squared", the integral of the squared torques of
            all motors over time [N^2 m^2 s], forces of joints that slide [N] among
            them, which is what motors waste by heat; or "work", the mechanical work
            that all motors do [J], each by itself: what they take up by braking is
            neither given back nor counted.
        slack: Share of T to give away for quiet torques: the motion that was found is
            handed to :func:`tominpmp.smooth`. None leaves it as it is.
        refine: What follows the first solve: "auto" (intervals of the best motion are
            halved where its controls bend, as long as that promises 0.3 % of T; not for
            "adjoint" and "penalty"); None, for a motion on the grid of the search;
            "grid" (the same, as long as that promises 0.03 % of T); "switching"
            (the instants at which torques switch are placed exactly, for small arms,
            and other orders of the switches are looked for unless ``starts`` is 1).
        smoothing: Weight of the total variation of the controls in the objective, in s
            per full range: it makes those controls quiet that the minimum time leaves
            free. None takes 1e-4 T for "inverse" and "collocation" in free space, but
            none on fine grids, where it costs 0.1 % of T; the same weight on the
            squares of the jumps among obstacles; and 0 for "adjoint".
        starts: Number of initial guesses; None lets the planner choose. More make the
            same attempts as fewer would and others after these, and while none has led
            to a motion, more are made in any case.
        seed: Seed of everything random.
        max_planning_time: Time limit [s], kept to 10 % and 0.2 s, from the call of the
            planner on; the best motion so far is returned, and verified in that time.
            By default it is that of the effort: 2 s for "quick", 10 s for "standard",
            60 s for "thorough"; infinity is no limit.
        max_iterations: Largest number of iterations a start.
        tolerance: Relative progress below which the iteration stops: when the last
            three iterations together brought less than this share of T.
        feasibility: Largest violation that counts as none: relative for torques and
            velocities, in m and rad for goals and clearances. A start that misses its
            goal by no more takes no time.
        goal_tolerance: Distance from the goal [rad or m] that the independent replay of
            a motion may end at, see :class:`Tolerances`.
        speed_tolerance: The same for the velocity at the end [rad/s or m/s].
        limit_tolerance: Relative excess over limits that the replay may have.
        contact_tolerance: Clearance that a pair may lack around a start or goal that is
            itself at the margin [m]; elsewhere nothing may be missing.
        trust_region: Initial radius of the trust region [rad].
        step_rule: For "adjoint": "adaptive", or "paper" (fixed steps, every step
            taken).
        control_step: Largest torque change an iteration with step_rule="paper", the
            paper's rho [N m].
        time_step: Largest change of T an iteration with step_rule="paper", the paper's
            epsilon [s].
        initial_duration: Duration of the initial guess at rest [s], the paper's T^0,
            for "adjoint", "penalty" and goals on frames; None lets the planner choose.
        initial_control: Initial torques for "adjoint" and "penalty", the paper's u^0,
            shape (n,) or (N, n) [N m]; None for zero.
        lp_solver: "highs" (dual simplex, warm started), "piqp" (interior point), the
            name of any other solver that qpsolvers knows, or "auto".
        control_period: Period of the controller that takes the motion as samples [s]:
            all knots and the duration become multiples of it, so that the polynomials
            by which the controller joins the samples are the motion itself, see
            :mod:`~tominpmp.transcription.grid`. At most a second; None leaves them
            where they are.
        processes: Number of processes that several starts are spread over, up to 256;
            no more are started than there are cores (or two), and the motion is the
            same for any number of them.
        callback: Called with an IterationRecord after every iteration; returning True
            stops the planning.
    """

    method: Method = "auto"
    intervals: int = 40
    grid: Grid = "cosine"
    control: Control = "auto"
    objective: Objective = "time"
    effort: Effort = "standard"
    energy_weight: float = 0.0
    energy: Energy = "torque_squared"
    slack: float | None = None
    refine: Refinement | None = "auto"
    smoothing: float | None = None
    starts: int | None = None
    seed: int = 0
    max_planning_time: float | None = None
    max_iterations: int = 100
    tolerance: float = 2e-4
    feasibility: float = 1e-6
    goal_tolerance: float = 1e-3
    speed_tolerance: float = 1e-2
    limit_tolerance: float = 5e-3
    contact_tolerance: float = 1e-5
    trust_region: float = 0.3
    step_rule: StepRule = "adaptive"
    control_step: float = 0.05
    time_step: float = 0.01
    initial_duration: float | None = None
    initial_control: Array | None = None
    lp_solver: str = "auto"
    control_period: float | None = None
    processes: int = 1
    callback: Callable[[IterationRecord], bool | None] | None = None

    def __post_init__(self) -> None:
        """Check every option."""
        for name, known in CHOICES.items():
            choice(getattr(self, name), known, name, error=OptionsError)
        for name, least in WHOLE.items():
            value, most = getattr(self, name), int(MOST[name])
            if value is not None or not self._is_optional(name):
                found = whole(value, name, least, most, error=OptionsError)
                self._keep(**{name: found})
        for name in POSITIVE:
            self._number(name, "a positive number", above=0.0)
        for name in ("smoothing", "slack"):
            self._number(name, "a number >= 0, or None")
        self._number("energy_weight", "a number >= 0 [1/(N^2 m^2) or s/J]")
        text(self.lp_solver, "lp_solver", "the name of a solver", OptionsError)
        if self.callback is not None and not callable(self.callback):
            raise wrong(self.callback, "callback", "a function", OptionsError)
        if self.initial_control is not None:
            control = array_or_nan(self.initial_control)
            shaped = control.ndim in (1, 2) and control.size > 0
            if not shaped or not np.all(np.isfinite(control)):
                expected = "finite torques, of shape (n,) or (N, n) [N m]"
                given = self.initial_control
                raise wrong(given, "initial_control", expected, OptionsError)
            self._keep(initial_control=control)

    @classmethod
    def _is_optional(cls, name: str) -> bool:
        """Whether an option may be left to the planner."""
        return getattr(cls, name) is None

    def _number(self, name: str, expected: str, above: float = -1.0) -> None:
        value, most = getattr(self, name), MOST.get(name, LARGEST)
        if value is None and self._is_optional(name):
            return
        endless = name == "max_planning_time" and number_or_nan(value) == np.inf
        most = np.inf if endless else most
        if number_or_nan(value) > most:
            expected = f"{expected}, at most {most:g}"
        error = OptionsError
        value = number(
            value, name, expected, 0.0, above, most, infinite=endless, error=error
        )
        self._keep(**{name: value})

    @property
    def time_limit(self) -> float:
        """Planning time that is allowed [s]; infinite without a limit."""
        if self.max_planning_time is None:
            return TIME_LIMITS[self.effort]
        return self.max_planning_time

    @property
    def tolerances(self) -> Tolerances:
        """What the replay of a motion may be off by."""
        return Tolerances(
            goal=self.goal_tolerance,
            speed=self.speed_tolerance,
            limits=self.limit_tolerance,
            contact=self.contact_tolerance,
        )

    @classmethod
    def of(cls, options: Options | None) -> Options:
        """The options that a caller gave; None for the defaults.

        Raises:
            ProblemError: If they are none.
        """
        if options is None:
            return cls()
        return instance(options, Options, "options", "Options or None")

    def changed(self, changes: Mapping[str, Any]) -> Options:
        """These options, some of them with other values.

        Args:
            changes: Values by name.

        Raises:
            OptionsError: If there is no option of such a name, or its value is wrong.
        """
        instance(changes, Mapping, "changes", "values of options by name")
        for name in changes:
            if name not in self.names():
                raise OptionsError(_unknown(name, self.names()), option=name)
        return replace(self, **changes) if changes else self

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Names of all options."""
        return tuple(item.name for item in fields(cls))


def _unknown(name: object, known: tuple[str, ...]) -> str:
    """Say that there is no option of a name, and which may be meant."""
    near = difflib.get_close_matches(name, known, n=1) if isinstance(name, str) else []
    hint = f"did you mean {near[0]!r}?" if near else f"there are: {', '.join(known)}"
    return f"there is no option {brief(name)}; {hint}"
