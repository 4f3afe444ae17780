"""The paper's example by all methods: a table, the figures and an animated page.

Plans the planar three-joint arm from (0.5, 1.7, -1.7) to the point (4, 1), with control
limits only and with joint limits and the obstacle, with gravity along -y and without,
by the adjoint method (the paper's), collocation, inverse dynamics and the exterior
penalty method. Writes to out/: counterparts of the paper's figures 2 to 7, the
convergence of the methods and one page with the motion around the obstacle, which plays
offline.

    python examples/paper_demo.py [--out FOLDER] [--intervals 75] [--seconds 20]
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import ascii_lowercase
from typing import cast

import numpy as np
from matplotlib.patches import Circle
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

import tominpmp as tm
from tominpmp.options import Method
from tominpmp.viz import figures
from tominpmp.viz.plots import curve_states
from tominpmp.viz.skeleton import skeleton

METHODS = ("adjoint", "collocation", "inverse", "penalty")
CASES = ("control limits only", "joint limits + obstacle")
GRAVITIES = {"along -y": (0.0, -9.81, 0.0), "none": (0.0, 0.0, 0.0)}
# T* [s] in the paper, for its method and for the penalty method.
PAPER = {CASES[0]: (0.884, 0.983), CASES[1]: (1.207, 1.221)}
START = (0.5, 1.7, -1.7)
GOAL = tm.PositionGoal("tip", (4.0, 1.0, 0.0))
OBSTACLE = tm.Scene([tm.Sphere("O", radius=0.8, position=(4.0, 0.0, 0.0))])
# Joint limits wide enough never to be active stand for no limits.
FREE = 20.0

Key = tuple[str, str, str]  # case, gravity, method


def problem(case: str, gravity: str) -> tm.Problem:
    """The paper's problem in one of its variants."""
    robot = tm.load_robot("planar3r", gravity=GRAVITIES[gravity])
    if case == CASES[0]:
        robot = robot.with_changes(position_lower=-FREE, position_upper=FREE)
        return tm.Problem(robot, START, GOAL)
    return tm.Problem(robot, START, GOAL, scene=OBSTACLE)


# T^0 [s]: that of the paper for methods that begin with torques; others begin at
# rest.
FIRST_DURATIONS = {"adjoint": 1.5, "penalty": 1.5, "collocation": 1.0, "inverse": 1.0}


def options(method: str, intervals: int, seconds: float) -> tm.Options:
    """Options of a method: no smoothing, a uniform grid, one start, as in the paper."""
    return tm.Options(
        method=cast(Method, method),
        intervals=intervals,
        grid="uniform",
        smoothing=0.0,
        starts=1,
        initial_duration=FIRST_DURATIONS[method],
        max_iterations=1000,
        max_planning_time=seconds,
        # The penalty method ends slightly outside the feasible set; this is accepted.
        feasibility=1e-3 if method == "penalty" else 1e-6,
    )


def plan_all(
    console: Console, intervals: int, seconds: float
) -> dict[Key, tm.Solution]:
    """Plan every case by every method, with progress on the console."""
    keys = [(c, g, m) for g in GRAVITIES for c in CASES for m in METHODS]
    solutions = {}
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("planning", total=len(keys))
        for key in keys:
            case, gravity, method = key
            label = f"{case}, gravity {gravity}, {method}"
            progress.update(task, description=label)
            if not console.is_terminal:
                console.print(f"planning: {label}")
            chosen = options(method, intervals, seconds)
            solutions[key] = tm.plan(problem(case, gravity), chosen)
            progress.advance(task)
    return solutions


# Statuses of plans that would have continued with more time.
CUT_OFF = (tm.Status.TIME_LIMIT, tm.Status.ITERATION_LIMIT)


def marks(solution: tm.Solution) -> str:
    """Marks of a motion: * if it violates goal or limits, + if it was cut off."""
    return "*" * (not solution.success) + "+" * (solution.status in CUT_OFF)


def label(method: str, solution: tm.Solution) -> str:
    """Name of a motion in figures, with its marks in words."""
    violates, cut = not solution.success, solution.status in CUT_OFF
    return method + ", goal or limits violated" * violates + ", cut off" * cut


def row(solution: tm.Solution) -> list[str]:
    """Cells of one method: T, iterations, seconds."""
    motion = solution.trajectory  # the best T so far, even without success
    duration = "none" if motion is None else f"{motion.duration:.4f}"
    cells = str(solution.iterations), f"{solution.planning_time:.2f}"
    return [duration + marks(solution), *cells]


# Motions whose final positions differ by more than this are different optima [rad].
APART = 0.5


def local_optima(
    solutions: Sequence[tm.Solution],
) -> tuple[list[str], dict[str, np.ndarray]]:
    """Letter of the local optimum of each motion.

    Returns:
        The letters, and the joint angles at the end by letters.
    """
    letters, ends = [], dict[str, np.ndarray]()
    for solution in solutions:
        motion, letter = solution.trajectory, ""
        if motion is not None:
            q = motion.q[-1]
            near = (k for k, end in ends.items() if np.abs(q - end).max() < APART)
            letter = next(near, ascii_lowercase[len(ends)])
            ends.setdefault(letter, q)
        letters.append(letter)
    return letters, ends


def print_table(
    console: Console, solutions: Mapping[Key, tm.Solution], limit: float
) -> None:
    """Print T, iterations and seconds of every method, and the paper's values of T."""
    table = Table(title="Planar three-joint arm: T in s (iterations, seconds)")
    for heading in ("case", "gravity", *METHODS, "paper", "paper, penalty"):
        numeric = heading not in ("case", "gravity")
        table.add_column(heading, justify="right" if numeric else "left")
    notes = []
    for gravity in GRAVITIES:
        for case in CASES:
            cells = []
            found = [solutions[case, gravity, method] for method in METHODS]
            letters, ends = local_optima(found)
            for solution, letter in zip(found, letters, strict=True):
                t, iterations, seconds = row(solution)
                mark = f" {letter}" if len(ends) > 1 else ""
                cells.append(f"{t}{mark} ({iterations}, {seconds})")
            if len(ends) > 1:
                told = (
                    f"{k} ends with joints at {q.round(2)}" for k, q in ends.items()
                )
                notes.append(f"{case}, gravity {gravity}: {', '.join(told)} rad")
            table.add_row(case, gravity, *cells, *(f"{t:.3f}" for t in PAPER[case]))
    console.print(table)
    if notes:
        console.print("Letters distinguish local optima of one problem:")
    for note in notes:
        console.print(f"  {note}", markup=False)
    failed = [s for s in solutions.values() if not s.success]
    if failed:
        worst = max(max(s.violations.values(), default=0.0) for s in failed)
        console.print(f"* ended with goal or limits violated, by {worst:.2g} at most")
    if any(s.status in CUT_OFF for s in solutions.values()):
        console.print(f"+ was cut off after {limit:g} s: T would change with more time")


def write_table(path: Path, solutions: Mapping[Key, tm.Solution]) -> None:
    """Write the table as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["case", "gravity", "method", "T", "iterations", "seconds"])
        for key, solution in solutions.items():
            writer.writerow([*key, *row(solution)])


def plot_controls(
    task: tm.Problem, motions: Mapping[str, tm.Trajectory], path: Path
) -> None:
    """Plot the torques of motions by their labels, one panel for each joint."""
    limits = task.robot.limits
    with figures.styled():
        figure = figures.new_figure(6.2, 4.75)
        panels = figure.subplots(task.robot.n, 1, sharex=True)
        for k, (name, motion) in enumerate(motions.items()):
            times, state = curve_states(motion)
            for panel, torque in zip(panels, state.u.T, strict=True):
                # Later curves are thinner, so that those below them stay visible.
                (curve,) = panel.plot(times, torque, color=figures.color(k))
                curve.set(linewidth=max(2.2 - 0.7 * k, 0.8))
                curve.set_label(f"{name} (T = {motion.duration:.4g} s)")
        for i, panel in enumerate(panels):
            panel.axhline(limits.effort_lower[i], label="limit", **figures.LIMIT_LOOK)
            panel.axhline(limits.effort_upper[i], **figures.LIMIT_LOOK)
            panel.set(title=task.robot.joint_names[i], ylabel=f"u{i + 1} [N m]")
        panels[-1].set_xlabel("time [s]")
        panels[-1].set_xlim(0.0, max(motion.duration for motion in motions.values()))
        figures.add_legend(figure, 4)
        figures.finish(figure, path)


# Instants at which the arm is drawn, and opacity at the first of them.
INSTANTS, LIGHTEST = 15, 0.16
ARM_COLOR, OBSTACLE_COLOR, GOAL_COLOR = "#12375f", "#d6453a", "#1d8a50"


def plot_motions(
    task: tm.Problem, motions: Mapping[str, tm.Trajectory], path: Path
) -> None:
    """Plot the arm at several instants, from light to dark, side by side by label."""
    with figures.styled():
        figure = figures.new_figure(0.5 + 4.2 * len(motions), 4.9)
        panels = figure.subplots(1, len(motions), sharex=True, sharey=True)
        shades = np.linspace(LIGHTEST, 1.0, INSTANTS)
        # In the legend the line of the first instant would be too light.
        labels = {INSTANTS // 4: "start", INSTANTS - 1: "end"}
        for panel, (name, motion) in zip(panels, motions.items(), strict=True):
            q = motion(np.linspace(0.0, motion.duration, INSTANTS)).q
            for i, joints in enumerate(skeleton(task.robot, q, "tip").points):
                look = {"color": ARM_COLOR, "alpha": shades[i], "lw": 1.2, "ms": 2.2}
                look |= {"mew": 0.0, "label": labels.get(i)}
                panel.plot(*joints[:, :2].T, "o-", **look)
            q = curve_states(motion)[1].q
            path_of_tip = skeleton(task.robot, q, "tip").points[:, -1, :2]
            look = {"color": figures.color(1), "lw": 1.1, "label": "path of the end"}
            panel.plot(*path_of_tip.T, **look)
            look = {"color": GOAL_COLOR, "ms": 8.0, "mew": 2.0, "ls": ""}
            panel.plot(*GOAL.position[:2], marker="x", label="goal", **look)
            for ball in task.scene:
                assert isinstance(ball, tm.Sphere)
                look = {"color": OBSTACLE_COLOR, "alpha": 0.25, "label": "obstacle"}
                x, y, _ = ball.position
                panel.add_patch(Circle((x, y), ball.radius, **look))
            panel.set(title=f"{name}: T = {motion.duration:.4g} s", xlabel="x [m]")
            panel.set_aspect("equal")
        panels[0].set_ylabel("y [m]")
        figures.add_legend(figure, 5)
        figures.finish(figure, path)


LINE_STYLES = {"adjoint": "-", "collocation": "--", "inverse": "-.", "penalty": ":"}
# Least violation that is drawn, as the axis is logarithmic; and marks of iterations.
LEAST_VIOLATION = 1e-12
ITERATIONS = (0, 2, 5, 10, 20, 50, 100, 200, 500, 1000)


def plot_convergence(
    histories: Mapping[str, Sequence[tm.IterationRecord]], path: Path
) -> None:
    """Plot T and the largest violation over the iterations of each method."""
    with figures.styled():
        figure = figures.new_figure(6.4, 4.6)
        above, below = figure.subplots(2, 1, sharex=True)
        for k, (method, records) in enumerate(histories.items()):
            look = {"color": figures.color(k), "linestyle": LINE_STYLES[method]}
            above.plot([r.duration for r in records], label=method, **look)
            below.plot([max(r.violation, LEAST_VIOLATION) for r in records], **look)
        above.set_ylabel("T [s]")
        below.set(ylabel="largest violation (scaled)", xlabel="iteration", yscale="log")
        below.yaxis.set_major_formatter("{x:.0e}")
        # Linear to 10, then logarithmic: methods differ by hundreds of iterations.
        below.set_xscale("symlog", linthresh=10.0)
        longest = max(map(len, histories.values()))
        shown = [number for number in ITERATIONS if number < longest]
        below.set_xticks(shown, map(str, shown))
        below.minorticks_off()
        below.set_xlim(left=-0.4)
        figures.add_legend(figure, 4)
        figures.finish(figure, path)


def draw(folder: Path, solutions: Mapping[Key, tm.Solution]) -> list[Path]:
    """Write the figures and the page; returns their paths."""
    gravity = next(iter(GRAVITIES))
    paths = []

    def path(name: str) -> Path:
        paths.append(folder / name)
        return paths[-1]

    first = solutions[CASES[1], gravity, "adjoint"]
    starts = {
        "adjoint": first.initial,
        "penalty": solutions[CASES[1], gravity, "penalty"].initial,
    }
    plot_controls(first.problem, starts, path("figure_2_initial_controls.png"))
    plot_motions(first.problem, starts, path("figure_3_initial_motion.png"))
    for case, controls, motion in (
        (CASES[0], "figure_4_controls_unconstrained", "figure_5_motion_unconstrained"),
        (CASES[1], "figure_6_controls_constrained", "figure_7_motion_constrained"),
    ):
        found = {m: solutions[case, gravity, m] for m in ("adjoint", "penalty")}
        motions = {label(m, s): s.trajectory for m, s in found.items()}
        plot_controls(found["adjoint"].problem, motions, path(f"{controls}.png"))
        plot_motions(found["adjoint"].problem, motions, path(f"{motion}.png"))
    # Only the first start: refinements count their iterations from zero.
    histories = {
        m: [r for r in solutions[CASES[1], gravity, m].history if r.start == 0]
        for m in METHODS
    }
    plot_convergence(histories, path("convergence.png"))
    best = min(
        (solutions[CASES[1], gravity, m] for m in METHODS if m != "penalty"),
        key=lambda solution: solution.T if solution.success else float("inf"),
    )
    best.play(path("motion_constrained.html"))
    return paths


def main() -> None:
    """Plan, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--intervals", type=int, default=75)
    parser.add_argument("--seconds", type=float, default=20.0, help="for each method")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    console = Console(width=None if Console().is_terminal else 160)
    solutions = plan_all(console, arguments.intervals, arguments.seconds)
    print_table(console, solutions, arguments.seconds)
    write_table(arguments.out / "paper_demo.csv", solutions)
    console.print("Drawing the figures ...")
    for path in draw(arguments.out, solutions):
        console.print(f"  {path}")


if __name__ == "__main__":
    main()
