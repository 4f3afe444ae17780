"""Automatic options: the method, control, solver and weights that fit a problem."""

from __future__ import annotations

from dataclasses import replace

from tominpmp.exceptions import OptionsError, ProblemError
from tominpmp.linear_programs.choice import make_solver
from tominpmp.options import Control, Options
from tominpmp.problem.joint_limits import need_smooth
from tominpmp.problem.problem import Problem
from tominpmp.solvers.loop import ITERATIONS
from tominpmp.solvers.objective import MinimumTime
from tominpmp.transcription.problem_functions import ProblemFunctions

# Weight of the jumps of the controls, as a share of the duration of the guess. With the
# total variation it costs less than 0.1 % of T in free space, and halves the iterations
# (benchmarks/random_goals.py). With squared jumps ten times this weight costs 0.1 % of
# T on problems of MotionBenchMaker; a tenth of it gains 0.05 %, and torques vary a
# quarter more.
JUMPS_SHARE = 1e-4
# Shooting methods: their torques are constant over the intervals of a fixed grid.
SHOOTING = ("adjoint", "penalty")
# Trust-region radius of a warm start, whose motion changes little, as a share of the
# usual one.
WARM_RADIUS = 0.3
# Least predicted gain for which a coarse motion is finished, a grid refined, a motion
# improved that the certificate accepts, or a joint turned further than to the nearest
# angle, as a share of T.
PROMISE = 3e-3


def resolve_options(problem: Problem, options: Options) -> Options:
    """Replace "auto" and None by values that fit the problem.

    Raises:
        OptionsError: If an option does not fit the problem.
        ProblemError: If no method plans motions of the problem.
    """
    robot = problem.robot
    method = options.method
    _check_combinations(problem, options)
    if method == "auto":
        method = "collocation" if robot.passive_joints else "inverse"
    control = _resolve_control(problem, options, method)
    lp_solver = options.lp_solver
    if lp_solver == "auto":
        # By measurement (docs/benchmarks.md).
        lp_solver = "highs" if method in SHOOTING else "piqp"
    make_solver(lp_solver)
    torque, shapes = options.initial_control, ((robot.n,), (options.intervals, robot.n))
    if torque is not None and torque.shape not in shapes:
        raise OptionsError(
            f"initial_control has shape {torque.shape}, expected {shapes[0]} or "
            f"{shapes[1]} for {options.intervals} intervals",
            "initial_control",
        )
    return replace(options, method=method, lp_solver=lp_solver, control=control)


def warm_start_options(options: Options) -> Options:
    """Options for a warm start near an optimum: small trust region, few iterations."""
    return replace(
        options,
        trust_region=WARM_RADIUS * options.trust_region,
        max_iterations=min(ITERATIONS, options.max_iterations),
    )


def minimum_time(
    system: ProblemFunctions, options: Options, duration: float
) -> MinimumTime:
    """The objective of minimum time, with a weight on the jumps of the controls.

    Without the weight, torques that the minimum time leaves free would chatter faster
    than a controller can follow. Among obstacles the squares of the jumps are weighted:
    programs are a third as large as with the total variation, and descents end sooner.
    Solvers of linear programs alone take the total variation there, too.
    In free space, where torques jump from one limit to the other, squared jumps would
    cost up to 0.3 % of T.

    Args:
        system: Functions of the problem.
        options: Options of the plan, which may set the weight of the total variation.
        duration: Duration of the motion [s].
    """
    if options.smoothing is not None:
        return MinimumTime.of(options, options.smoothing)
    squared = not system.in_free_space and make_solver(options.lp_solver).curved
    return MinimumTime.of(options, JUMPS_SHARE * duration, squared=squared)


def _check_combinations(problem: Problem, options: Options) -> None:
    """Refuse options that conflict with the problem or with each other.

    Raises:
        OptionsError: If there is a conflict.
        ProblemError: If a problem with segments has a joint without a motor.
    """
    robot, period, weight = problem.robot, options.control_period, options.energy_weight
    inverse, followed = ("auto", "inverse"), ("auto", "grid", None)
    if robot.passive_joints:
        passive = ", ".join(robot.passive_joints)
        if problem.segments:
            raise ProblemError(
                f"segments are given, and {passive} has no motor: expected a goal "
                "without segments, or a motor at every joint",
                "segments",
            )
        reason = f"{passive} has no motor to follow given accelerations, or samples"
        driven = ("auto", "collocation", *SHOOTING)
        _check_values(options, reason, control_period=(None,), method=driven)
    if period is not None:
        reason = f"control_period is {period:g} s, without switches between ticks"
        _check_values(options, reason, refine=followed)
    if problem.segments:
        reason = "the problem has several segments"
        _check_values(options, reason, method=inverse, refine=followed, slack=(None,))
    if weight:
        _check_values(
            options,
            f"energy_weight is {weight:g}",
            method=(*inverse, "collocation"),
            objective=("time",),
            control_period=(None,),
            slack=(None,),
        )
    if robot.kinematic:
        _check_values(
            options,
            "a kinematic robot has no torques",
            method=inverse,
            refine=followed,
            energy_weight=(0.0,),
            slack=(None,),
        )


def _check_values(options: Options, reason: str, **known: tuple[object, ...]) -> None:
    """Refuse values of options that are not among the allowed ones.

    Args:
        options: The options.
        reason: Why other values are refused.
        **known: The allowed values, by the names of their options.

    Raises:
        OptionsError: If an option has another value; the message has the reason.
    """
    for name, allowed in known.items():
        value = getattr(options, name)
        if value not in allowed:
            raise OptionsError(
                f"{name} is {value!r}, and {reason}: expected "
                f"{' or '.join(map(repr, allowed))}",
                name,
            )


def _resolve_control(problem: Problem, options: Options, method: str) -> Control:
    """Control parameterisation that fits the problem and the method.

    Raises:
        OptionsError: If no control parameterisation fits.
    """
    control = options.control
    smooth = need_smooth(problem.robot, problem.motion_limits)
    smooth = smooth or any(
        phase.motion_limits is not None and phase.motion_limits.continuous
        for phase in problem.phases
    )
    if method != "inverse" and (smooth or control not in ("auto", "constant")):
        raise OptionsError(
            f"method {method!r} has piecewise constant torques only: motion limits "
            "and controls 'linear' and 'spline' need method 'inverse' and all motors",
            "control",
        )
    if control == "constant" and smooth:
        raise OptionsError(
            "control is 'constant', and the motion limits of the problem need "
            "continuous accelerations: expected 'linear', 'spline' or 'auto'",
            "control",
        )
    if control != "auto":
        return control
    if smooth:
        return "linear"
    # Exact switches are read off piecewise constant accelerations, and motions of a
    # kinematic robot have these. Otherwise each descent resolves "auto" by its guess:
    # accelerations are linear if torque limits rule the motion.
    jumps = options.refine == "switching" or problem.robot.kinematic
    return "constant" if jumps or method != "inverse" else "auto"
