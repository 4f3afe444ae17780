"""Goals whose configurations are hard to find by inverse kinematics.

Regression: the search from twenty starts missed the configuration of a pose that an
upright constraint restricts to a narrow cone.
"""

from __future__ import annotations

import warnings
from itertools import islice

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.initial_guess.guess import GuessRequest
from tominpmp.initial_guess.inverse_kinematics import REACHED, Target
from tominpmp.kinematics import RobotKinematics
from tominpmp.transcription.problem_functions import ProblemFunctions

FRAME = "panda_hand_tcp"
FINGERS = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
START = [2.3487331150765267, 0.6333651060391691, 2.6523878597252915]
START += [-0.618703866414074, -1.417824688076563, 3.3967208054222358]
START += [-1.3723327220492576]
END = [-0.5371880230607866, 1.3846172344920527, -0.6254938234626006]
END += [-1.2967824146657803, -2.130277789551306, 0.7808893877807688]
END += [2.782771934380834]


def panda() -> tm.Robot:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return tm.load_robot("panda", limits="urdf", locked_joints=FINGERS)


@pytest.mark.parametrize("seed", [0, 1])
def test_guess_reaches_a_pose_within_a_narrow_cone(seed: int) -> None:
    robot = panda()
    pose = RobotKinematics(robot).placement(np.array(END), FRAME)
    problem = tm.Problem(
        robot,
        START,
        tm.PoseGoal(FRAME, pose),
        constraints=[tm.KeepUpright(FRAME, tolerance=0.03)],
        self_collision=False,
    )
    system = ProblemFunctions.of(problem)
    # The first guess stays at the start.
    _, guess = islice(GuessRequest(np.random.default_rng(seed)).guesses(system), 2)
    reached = system.kinematics.placement(guess.q[-1], FRAME)
    assert np.allclose(reached.translation, pose.translation, atol=1e-5)


def test_goals_far_from_a_start_next_to_the_limits_are_reached() -> None:
    """Regression: the goal was refused, as all starts of the search lay on one side.

    The starts were within half a turn of the start of the motion.
    """
    robot = tm.load_robot("planar3r")
    robot = robot.with_changes(
        position_lower=np.maximum(robot.limits.position_lower, -2.9),
        position_upper=np.minimum(robot.limits.position_upper, 2.9),
    )
    end = np.array([0.3, -2.7, -2.7])
    pose = RobotKinematics(robot).placement(end, "tip")
    goal = tm.PoseGoal("tip", pose)
    problem = tm.Problem(robot, [2.76, 2.61, 2.61], goal, self_collision=False)
    target = Target(ProblemFunctions.of(problem), goal)
    found = target.configurations(20, np.random.default_rng(0))
    assert np.any([np.allclose(q, end, atol=1e-5) for q in found.free])


def test_search_finds_the_configurations_that_are_reached_soonest() -> None:
    """Compared with sixty random starts of the search.

    A search without starts near the start of the motion misses these configurations.
    """
    robot = panda()
    kinematics, limits = RobotKinematics(robot), robot.limits
    rng, ratios = np.random.default_rng(3), []

    def soonest(system: ProblemFunctions, found: list[np.ndarray]) -> float:
        ways = [np.abs(q - system.problem.q_start) / limits.velocity for q in found]
        return min(float(np.max(way)) for way in ways)

    for _ in range(8):
        start, there = rng.uniform(limits.position_lower, limits.position_upper, (2, 7))
        place = kinematics.placement(there, FRAME).translation
        goal = tm.PositionGoal(FRAME, place)
        system = ProblemFunctions.of(
            tm.Problem(robot, start, goal, self_collision=False)
        )
        few = Target(system, goal).configurations(20, np.random.default_rng(0)).free
        wide = list[np.ndarray]()
        for _ in range(60):
            q = rng.uniform(limits.position_lower, limits.position_upper)
            q, error = Target(system, goal).solve(q)
            wide += [q] if error < REACHED else []
        ratios.append(soonest(system, few) / soonest(system, wide))
    assert max(ratios) < 1.1
