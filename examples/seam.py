"""A UR5 follows a seam at constant speed: an S of two arcs, with a nozzle.

From home to the seam, along it within 1 mm, and home again, as one motion: the nozzle
arrives at the seam with the speed at which it follows it, and runs out beyond the end
before it brakes. On the seam it points down within 10 degrees and may spin, so that the
planner chooses its orientation. A speed limit is enough to make the speed constant, as
the fastest motion follows the seam at the limit. Writes to out/ a figure of the speed,
a page that plays offline, and the motion.

    python examples/seam.py [--out FOLDER] [--seed 0]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import tominpmp as tm
from tominpmp.kinematics import RobotKinematics
from tominpmp.viz import figures

HOME = np.array([-0.4, -1.6, 1.9, -1.9, -1.57, 0.0])
NOZZLE = "tool0"
HEIGHT, RADIUS = 0.15, 0.12  # of the seam, and of each of its arcs [m]
BEGIN = np.array([0.45, -2.0 * RADIUS, HEIGHT])  # its beginning [m]
SPEED, WITHIN = 0.25, 1e-3  # along it [m/s], and tolerated distance from it [m]
CONE = np.deg2rad(10.0)
RUN_OUT = 0.3  # beyond the end of the seam, along its last arc [rad]
SAMPLES = 1000


def seam() -> list[tm.ToolArc]:
    """Two half circles, one after the other, that make an S; the last runs out."""
    spoke = np.array([0.0, RADIUS, 0.0])
    arcs = [(BEGIN, -1, np.pi), (BEGIN + 2 * spoke, 1, np.pi + RUN_OUT)]
    return [
        tm.ToolArc(NOZZLE, begin + spoke, begin, (0, 0, turn), angle, WITHIN)
        for begin, turn, angle in arcs
    ]


def problem() -> tm.Problem:
    """Segments to the seam, along its two halves, out beyond it, and home."""
    robot = tm.load_robot("ur5", limits="urdf")
    plate = tm.Box("plate", size=(0.4, 0.8, 0.02), position=(0.5, 0.0, HEIGHT - 0.04))
    down = tm.KeepUpright(NOZZLE, axis=(0, 0, -1), tolerance=CONE)
    first, last = seam()
    slow = (down, tm.ToolSpeed(NOZZLE, SPEED))
    ends = [first.at(0.0), last.at(0.0), last.at(np.pi), last.at(np.pi + RUN_OUT)]
    goals = [tm.PositionGoal(NOZZLE, point) for point in ends]
    segments = [
        tm.Segment(goals[0]),
        tm.Segment(goals[1], constraints=(first, *slow)),
        tm.Segment(goals[2], constraints=(last, *slow)),
        tm.Segment(goals[3], constraints=(last, *slow)),
        tm.Segment(tm.JointGoal(HOME)),
    ]
    scene = tm.Scene([plate])
    return tm.Problem(robot, HOME, scene=scene, margin=0.01, segments=segments)


def speeds(solution: tm.Solution) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times, and the speed of the nozzle there."""
    kinematics = RobotKinematics(solution.problem.robot)
    times = np.linspace(0.0, solution.T, SAMPLES)
    every = solution.trajectory(times).q
    points = np.array([kinematics.placement(q, NOZZLE).translation for q in every])
    apart = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return 0.5 * (times[1:] + times[:-1]), apart / np.diff(times)


def tell(solution: tm.Solution) -> None:
    """Report times, speeds and distances of the nozzle on the seam."""
    times, speed = speeds(solution)
    begin, end = solution.segments[1].begin, solution.segments[2].end
    on_seam = (times >= begin) & (times <= end)
    slowest, fastest = speed[on_seam].min(), speed[on_seam].max()
    length = 2.0 * np.pi * RADIUS
    worst = solution.verification.worst["distance from its path of frame tool0"]
    print(f"  there {begin:.3f} s, on the seam {end - begin:.3f} s", end=" ")
    print(f"({length:.3f} m at {SPEED} m/s are {length / SPEED:.3f} s)", end=", ")
    print(f"home {solution.T - end:.3f} s")
    print(f"  speed on the seam {slowest:.4f} to {fastest:.4f} m/s", end=", ")
    print(f"at most {1e3 * (WITHIN + worst.amount):.2f} mm away from it")


def plot(solution: tm.Solution, path: Path) -> None:
    """The speed of the nozzle over time, the seam shaded."""
    times, speed = speeds(solution)
    begin, end, out = (solution.segments[k].end for k in (0, 2, 3))
    with figures.styled():
        figure = figures.new_figure(7.0, 3.0)
        axes = figure.subplots()
        axes.axvspan(begin, end, color="0.93", label="seam")
        axes.plot(times, speed, color=figures.color(0))
        look = {"label": "limit"} | figures.LIMIT_LOOK
        axes.plot([begin, out], [SPEED, SPEED], **look)
        axes.set(xlabel="time [s]", ylabel="speed of the nozzle [m/s]")
        axes.set(xlim=(0.0, solution.T), ylim=(0.0, None))
        figures.add_legend(figure, 2)
        figures.finish(figure, path)


def main() -> int:
    """Plan, report on the seam, write the figure, the page and the motion."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    # Five segments along narrow tubes may take longer than the usual limit.
    options = tm.Options(intervals=60, seed=arguments.seed, max_planning_time=120.0)
    solution = tm.plan(problem(), options)
    print(solution.message)
    if not solution.success:
        return 1
    tell(solution)
    arguments.out.mkdir(parents=True, exist_ok=True)
    plot(solution, arguments.out / "seam.png")
    solution.play(arguments.out / "seam.html", frame=NOZZLE)
    solution.export(arguments.out / "seam.csv", dt=0.001)
    for ending in ("png", "html", "csv"):
        print(arguments.out / f"seam.{ending}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
