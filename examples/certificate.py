"""Certify motions: is a motion time-optimal to first order, which limits are active?

Plans a motion of the paper's arm over an obstacle, computes its certificate, then slows
the motion down by 5 % and certifies it again. A certificate needs only a problem and a
motion: motions read from files can be certified as well.

    python examples/certificate.py [--out FOLDER]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tominpmp as tm
from tominpmp.dynamics import RobotDynamics


def slowed(problem: tm.Problem, motion: tm.Trajectory, factor: float) -> tm.Trajectory:
    """The same path at lower speed, with the torques that it requires."""
    inverse = RobotDynamics(problem.robot).inverse
    t, v, a = factor * motion.t, motion.v / factor, motion.a
    u = inverse(motion.q, v, motion(motion.t).a / factor**2)
    if a is not None:
        a = a / factor**2
    return tm.Trajectory(motion.joint_names, t, motion.q, v, u, a, inverse)


def main() -> None:
    """Plan, certify, slow down, certify again."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder")
    out = parser.parse_args().out

    robot = tm.load_robot("planar3r")
    scene = tm.Scene([tm.Sphere("O", radius=0.8, position=(4, 0, 0))])
    goal = tm.PositionGoal("tip", (4, 1, 0))
    problem = tm.Problem(robot, (0.5, 1.7, -1.7), goal, scene=scene)
    solution = tm.plan(problem)
    motion = solution.raise_if_failed().trajectory
    assert motion is not None

    certificate = solution.certificate
    assert certificate is not None
    print(f"T = {solution.T:.4f} s. {certificate.message}")
    for limit in certificate.active:
        held = float(np.sum(limit.end - limit.begin))
        print(f"  {limit.kind} of {limit.name}: {held:.3f} s")
    out.mkdir(parents=True, exist_ok=True)
    solution.plot_certificate(out / "certificate.png")

    spoilt = tm.certify(problem, slowed(problem, motion, 1.05))
    print(f"Slowed by 5 %. {spoilt.message}")


if __name__ == "__main__":
    main()
