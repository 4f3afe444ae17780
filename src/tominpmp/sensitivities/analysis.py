r"""How the duration of a motion changes with every limit of its problem.

The duration is the minimum of a program whose limits :math:`g_i(z, p) \le 0` depend on
numbers p: speeds, torques, margins, masses. By the envelope theorem

.. math:: \frac{dT}{dp} = \sum_i \lambda_i \frac{\partial g_i}{\partial p}

at the optimum, with the motion z as it is: no plan is made again. The multipliers
:math:`\lambda_i` are those of the certificate.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tominpmp.arrays import Array
from tominpmp.blas_threads import on_one_thread
from tominpmp.certificate.active_limits import Motion
from tominpmp.certificate.dual_program import solve_dual_program
from tominpmp.certificate.stays import without_stays
from tominpmp.certificate.task import Task
from tominpmp.checks import instance
from tominpmp.exceptions import ProblemError
from tominpmp.kinematics import prismatic_joints
from tominpmp.motion.joining import checked_motion
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Tolerances
from tominpmp.problem import Problem
from tominpmp.sensitivities.limits import LimitValues
from tominpmp.sensitivities.places import PlaceValues
from tominpmp.sensitivities.records import Sensitivities, Sensitivity
from tominpmp.sensitivities.sections import Section, sections
from tominpmp.sensitivities.torques import TorqueWeights
from tominpmp.verification.stages import with_segments


@on_one_thread
def analyse(problem: Problem, trajectory: Trajectory | Samples) -> Sensitivities:
    """Say what holds a motion back: how T changes with each limit of its problem.

    Args:
        problem: What the motion solves.
        trajectory: The motion, of whatever origin; the nearer it is to an optimum the
            more the values mean, see :attr:`Sensitivities.promise`.

    Returns:
        The sensitivities; of several segments, what each limit is worth on all of them.

    Raises:
        ProblemError: If the motion is one of other joints, has no numbers or no
            multipliers, or has segments that arrive at given times, or stay where
            obstacles move.
    """
    instance(problem, Problem, "problem")
    given = checked_motion(trajectory, problem.robot, problem.q_start, problem.v_start)
    T = given.duration
    if problem.segments:
        problem, given = _moving(problem, given)
    if not given.duration:
        return Sensitivities(T, (), 0.0, np.zeros(6))
    found = None
    try:
        with np.errstate(all="ignore"):
            motion = Motion.of(Task.of(problem), given)
            found = solve_dual_program(motion)
    except np.linalg.LinAlgError:
        pass
    if found is None:
        raise ProblemError(
            f"trajectory of {given.duration:.4g} s has no multipliers, expected a "
            "motion whose linear program of small changes can be solved",
            "trajectory",
        )
    parts = [_read(section, T) for section in sections(motion, found)]
    return parts[0] if len(parts) == 1 else Sensitivities.of_segments(parts)


def _moving(problem: Problem, given: Trajectory) -> tuple[Problem, Trajectory]:
    """A motion of several segments without its stays, and the problem it solves."""
    for number, segment in enumerate(problem.segments, 1):
        if segment.arrival is not None:
            raise ProblemError(
                f"segment {number} has to arrive at given times, expected none: what "
                "they are worth is not known",
                f"segments[{number - 1}].arrival",
            )
    given = with_segments(problem, given, Tolerances())
    problem = problem.alternative_of(given)
    return without_stays(problem, given)


def _read(section: Section, T: float) -> Sensitivities:
    """Sensitivities of a motion of duration T from the multipliers of a segment."""
    motion, found, number = section
    torques = TorqueWeights.of(motion, found)
    places = PlaceValues(motion, found, torques, number)
    records = [
        *LimitValues(motion, found).records(),
        *_of_forces(motion, torques, places),
        *places.records(),
    ]
    # Multipliers are shares of the time without stays, which nothing changes.
    share = float(motion.changes.t[-1]) / T
    records = [item.scaled(share) for item in records]
    return Sensitivities(T, tuple(records), share * found.promise, share * places.base)


def _of_forces(
    motion: Motion, torques: TorqueWeights, places: PlaceValues
) -> Iterator[Sensitivity]:
    """Gravity, loads and friction."""
    robot = motion.task.problem.robot
    by_gravity = torques.by_gravity(robot)
    size = float(np.linalg.norm(robot.gravity))
    yield Sensitivity(
        "gravity",
        None,
        "",
        float(by_gravity @ robot.gravity) + places.by_gravity(),
        limit=size,
        limit_unit="m/s^2",
        vector=by_gravity,
    )
    for load in robot.payloads:
        worth = torques.by_mass(robot, load)
        heavy = load.mass > 0.0
        yield Sensitivity(
            "payload",
            None,
            load.name,
            worth * load.mass if heavy else worth,
            "" if heavy else "1/kg",
            load.mass,
            "kg",
        )
    slides = prismatic_joints(robot)
    viscous = np.where(slides, "N s/m", "N m s/rad").tolist()
    dry = np.where(slides, "N", "N m").tolist()
    for kind, given, torque, units in (
        ("damping", robot.damping, robot.damping * torques.v, viscous),
        ("friction", robot.friction, robot.friction * torques.way, dry),
    ):
        yield from _by_joint(kind, robot.joint_names, given, torques, torque, units)


def _by_joint(
    kind: str,
    names: tuple[str, ...],
    given: Array,
    torques: TorqueWeights,
    torque: Array,
    units: list[str],
) -> Iterator[Sensitivity]:
    """Records of joints that have some of a friction."""
    worth = torques.by_joint(torque)
    for joint in np.flatnonzero(given).tolist():
        name, value = names[joint], float(worth[joint])
        yield Sensitivity(
            kind, name, name, value, "", float(given[joint]), units[joint]
        )
