"""The command ``replay``: a motion in MuJoCo."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.cli.options import ProblemArguments
from tominpmp.cli.problem import load_problem
from tominpmp.cli.report import json_text, plain, rows_text
from tominpmp.cli.terminal import NO_PLAN, PLANNED, say
from tominpmp.exceptions import OptionsError
from tominpmp.files.export import load_motion
from tominpmp.motion.joining import join
from tominpmp.physics.options import ReplayOptions
from tominpmp.physics.replay import STEP, PhysicsReplay, replay
from tominpmp.physics.robustness import (
    WANTED,
    Disturbances,
    Robustness,
    robustness,
)


def run_replay(
    problem_args: ProblemArguments, motion: Path | None, args: ReplayOptions
) -> int:
    """Replay a motion in MuJoCo, or try motions with torque reserves, and report.

    Args:
        problem_args: Whose motion it is.
        motion: File that holds the motion; may be left out where reserves are tried.
        args: How.

    Raises:
        TominpmpError: If a file is wrong or they do not belong together.
    """
    problem, options = load_problem(problem_args)
    if args.robustness:
        found = robustness(
            problem,
            options,
            disturbances=Disturbances(
                payload=args.random_payload,
                friction=args.random_friction,
                delay=args.random_delay,
                noise=args.random_noise,
            ),
            samples=args.samples,
            tolerance=args.tracking_tolerance,
            bandwidth=args.bandwidth,
            seed=args.seed,
        )
        say(json_text(plain(found)) if args.json else _reserves_text(found))
        return PLANNED if found.reserve is not None else NO_PLAN
    if motion is None:
        raise OptionsError("a MOTION is missing; or give --robustness", "MOTION")
    trajectory = join(
        load_motion(motion),
        problem.robot,
        motion,
        start=problem.q_start,
        start_velocity=problem.v_start,
    ).trajectory
    step = STEP if args.step is None else args.step
    seen = replay(problem, trajectory, step=step, tolerance=args.goal_tolerance)
    say(json_text(_data(seen)) if args.json else _text(seen, motion))
    return PLANNED if seen.ok else NO_PLAN


def _data(found: PhysicsReplay) -> dict[str, Any]:
    runs = {"open_loop": found.open_loop, "with_feedback": found.with_feedback}
    numbers = ("goal_error", "tracking_error", "excess")
    return {
        "ok": found.ok,
        "engine": found.engine,
        "integrator": found.integrator,
        "torque_difference": found.torque_difference,
        **{k: {n: getattr(run, n) for n in numbers} for k, run in runs.items()},
    }


def _text(found: PhysicsReplay, path: Path) -> str:
    verdict = "ends where it is to" if found.ok else "does not end where it is to"
    rows = [("engine", f"{found.engine}, {found.integrator}")]
    for name, run in (
        ("torques alone", found.open_loop),
        ("with feedback", found.with_feedback),
    ):
        errors = (
            f"{run.goal_error:.1e} off at the end, {run.tracking_error:.1e} at most"
        )
        rows.append((name, f"{errors} (rad or m)"))
    rows.append(("torques differ", f"by {found.torque_difference:.1e} of the largest"))
    return rows_text(f"The motion in {path} {verdict}.", rows)


def _reserves_text(found: Robustness) -> str:
    rows = [("each trial", found.disturbances.message)]
    for k, reserve in enumerate(found.reserves.tolist()):
        kept = f"T = {found.T[k]:.4f} s, {found.kept[k]:.0%} within"
        if np.isfinite(found.errors[k]):
            kept += f", {WANTED:.0%} within {found.errors[k]:.2g}"
        none = not np.isfinite(found.T[k])
        rows.append((f"reserve {reserve:.0%}", "no motion" if none else kept))
    message = found.message.replace("effort_scale=", "--effort-scale ")
    return rows_text(f"{message[:1].upper()}{message[1:]}.", rows)
