"""A UR5 carries a glass on a tray from one side to the other: level, and tilting.

The glass is not fixed to the tray. It must neither slip (friction 0.3) nor tip over (a
foot of 35 mm, its centre of mass 80 mm up). On a level tray only friction accelerates
the glass; if the tray is tilted into the motion, gravity helps, as every waiter knows.
Writes to out/ a figure of both motions and a page of each that plays offline.

    python examples/waiter.py [--out FOLDER] [--seed 0]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tominpmp as tm
from tominpmp.kinematics import RobotKinematics
from tominpmp.viz import figures

FRAME = "tool0"
# The tray is level in both configurations, its centre on either side of the arm.
START = (-0.95776306, -1.19076644, 1.4913508, -1.87138069, 1.57079633, -0.61303327)
GOAL = (0.61303327, -1.19076644, 1.4913508, -1.87138069, 1.57079633, -2.1838296)
FRICTION, FOOT, HEIGHT = 0.3, 0.035, 0.08
TRAY, GLASS = 0.4, 0.3  # [kg]
LEVEL = 0.02  # tolerated tilt of a level tray [rad]
# The final grid from the start: motions on the verge of slipping gain little from the
# refinement of a coarse grid, which takes ten times as long.
OPTIONS = tm.Options(
    intervals=40,
    control="linear",
    effort="quick",
    refine=None,
    max_planning_time=60.0,
)


def robot() -> tm.Robot:
    """The arm with tray and glass as parts of its dynamics and collision checks."""
    # The origin of the frame is the top of the tray, on which the glass stands.
    tray = tm.Cylinder("tray", radius=0.14, length=0.01, position=(0, 0, -0.005))
    glass = tm.Cylinder(
        "glass", radius=FOOT, length=2.0 * HEIGHT, position=(0, 0, HEIGHT)
    )
    mass = TRAY + GLASS
    center = (GLASS * HEIGHT - TRAY * 0.005) / mass
    load = tm.Payload(
        mass, FRAME, com=(0, 0, center), geometry=[tray, glass], name="tray"
    )
    return tm.load_robot("ur5", limits="urdf").with_payload(load)


def problem(*, level: bool) -> tm.Problem:
    """From one side to the other, with the glass held on the tray."""
    glass = tm.StableContact(FRAME, (0, 0, HEIGHT), FRICTION, FOOT, mass=GLASS)
    held: list[tm.PathConstraint] = [glass]
    if level:
        held.append(tm.KeepUpright(FRAME, (0, 0, 1), (0, 0, 1), tolerance=LEVEL))
    return tm.Problem(robot(), START, tm.JointGoal(GOAL), constraints=tuple(held))


def tilts(solution: tm.Solution, times: np.ndarray) -> np.ndarray:
    """Angle between the axis of the tray and the vertical [deg], shape (m,)."""
    kinematics = RobotKinematics(solution.problem.robot)
    assert solution.trajectory is not None
    up = [
        kinematics.placement(q, FRAME).rotation[2, 2]
        for q in solution.trajectory(times).q
    ]
    return np.asarray(np.degrees(np.arccos(np.clip(up, -1.0, 1.0))))


def draw(solutions: dict[str, tm.Solution], path: Path) -> None:
    """Tilt of the tray, and the friction that the glass could still use, over time."""
    with figures.styled():
        figure = figures.new_figure(6.0, 4.5)
        angle, grip = figure.subplots(2, sharex=True)
        for k, (name, solution) in enumerate(solutions.items()):
            motion = solution.raise_if_failed().trajectory
            glass = solution.problem.ready_constraints[0]
            assert motion is not None and isinstance(glass, tm.StableContact)
            times = np.linspace(0.0, motion.duration, 400)
            state = motion(times)
            w = glass.wrenches(state.q, state.v, state.a)
            reserve = FRICTION * w[:, 2] - np.hypot(w[:, 0], w[:, 1])
            label, color = f"{name} (T = {solution.T:.3f} s)", figures.color(k)
            angle.plot(times, tilts(solution, times), color=color, label=label)
            grip.plot(times, reserve, color=color)
        angle.set(ylabel="tilt of the tray [deg]")
        grip.axhline(0.0, label="limit", **figures.LIMIT_LOOK)
        # From the verge of slipping to the glass at rest.
        grip.set(
            ylabel="reserve of friction [N]", ylim=(-0.05, FRICTION * GLASS * 9.81)
        )
        grip.set(xlabel="time [s]", xlim=(0.0, None))
        figures.add_legend(figure, 3)
        figures.finish(figure, path)


def main() -> int:
    """Plan both motions, report them, write the figure and the pages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    solutions: dict[str, tm.Solution] = {}
    for name in ("level", "tilting"):
        task = problem(level=name == "level")
        solutions[name] = solution = tm.plan(task, OPTIONS, seed=arguments.seed)
        print(f"{name}: {solution.message}")
        if not solution.success:
            return 1
        solution.play(arguments.out / f"waiter_{name}.html")
    level, tilting = (solution.T for solution in solutions.values())
    print(f"Tilting the tray takes {100 * (1 - tilting / level):.0f} % less time.")
    draw(solutions, arguments.out / "waiter.png")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
