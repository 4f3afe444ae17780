"""Runs the command ``replay``: simulates a motion in MuJoCo, and reports."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np

from tominpmp.cli.options import ProblemOptions
from tominpmp.cli.problem import load_problem
from tominpmp.cli.report import json_text, plain, rows_text
from tominpmp.cli.terminal import NO_PLAN, PLANNED, say
from tominpmp.exceptions import OptionsError
from tominpmp.files.export import load_motion
from tominpmp.files.export_check import joined_samples
from tominpmp.physics.options import ReplayOptions
from tominpmp.physics.replay import PhysicsReplay, replay
from tominpmp.physics.robustness import REQUIRED, Disturbances, Robustness, robustness


def run_replay(
    source: str, changes: ProblemOptions, motion: Path | None, args: ReplayOptions
) -> int:
    """Replay a motion in MuJoCo, or try motions with torque reserves, and report.

    Args:
        source: Scenario file, or name or path of a robot.
        changes: Options that define the problem of the motion.
        motion: File that holds the motion; None if reserves are tried.
        args: Options of the command.

    Raises:
        TominpmpError: If a file is wrong, or the motion does not fit the problem.
    """
    if args.robustness and motion is not None:
        message = f"MOTION is {str(motion)!r}, but --robustness plans its own"
        raise OptionsError(message, "MOTION")
    problem, options = load_problem(source, changes)
    if args.robustness:
        names = [item.name for item in fields(Disturbances)]
        largest = {name: getattr(args, f"random_{name}") for name in names}
        trials = robustness(
            problem,
            options,
            disturbances=Disturbances(**largest),
            samples=args.samples,
            tolerance=args.tracking_tolerance,
            bandwidth=args.bandwidth,
            seed=args.seed,
        )
        say(json_text(trials) if args.json else _reserves_text(trials))
        return PLANNED if trials.reserve is not None else NO_PLAN
    if motion is None:
        raise OptionsError("a MOTION is missing; or give --robustness", "MOTION")
    trajectory = joined_samples(load_motion(motion), problem, motion).trajectory
    result = replay(problem, trajectory, step=args.step, tolerance=args.goal_tolerance)
    data = {"ok": result.ok, **plain(result)}
    say(json_text(data) if args.json else _text(result, motion))
    return PLANNED if result.ok else NO_PLAN


def _text(result: PhysicsReplay, path: Path) -> str:
    verdict = "ends at its goal" if result.ok else "does not end at its goal"
    rows = [("engine", f"{result.engine}, {result.integrator}")]
    runs = {"torques alone": result.open_loop, "with feedback": result.with_feedback}
    for name, run in runs.items():
        errors = f"{run.goal_error:.1e} off at the end, {run.tracking_error:.1e}"
        rows.append((name, f"{errors} at most (rad or m)"))
    rows.append(("torques differ", f"by {result.torque_difference:.1e} of the largest"))
    return rows_text(f"The motion in {path} {verdict}.", rows)


def _reserves_text(result: Robustness) -> str:
    rows = [("each trial", result.disturbances.message)]
    for k, reserve in enumerate(result.reserves.tolist()):
        text = f"T = {result.T[k]:.4f} s, {result.kept[k]:.0%} within"
        if np.isfinite(result.errors[k]):
            text += f", {REQUIRED:.0%} within {result.errors[k]:.2g}"
        failed = not np.isfinite(result.T[k])
        rows.append((f"reserve {reserve:.0%}", "no motion" if failed else text))
    message = result.message.replace("effort_scale=", "--effort-scale ")
    return rows_text(f"{message[:1].upper()}{message[1:]}.", rows)
