"""Problems that several benchmarks share: random joint goals, and the examples."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import tominpmp as tm
from benchmarks.random_goals import load_arm, sample_problems

SCENARIOS = Path(__file__).parents[1] / "examples" / "scenarios"


def random_goals(
    robots: str, count: int, seed: int
) -> Iterator[tuple[str, tm.Problem]]:
    """Random joint goals of robots, whose names are separated by commas."""
    for name in robots.split(","):
        robot = load_arm(name)
        for number, (q_start, q_goal) in enumerate(sample_problems(robot, count, seed)):
            # Like the rivals, which have no self-collision.
            yield (
                f"{name} {number}",
                tm.Problem(robot, q_start, tm.JointGoal(q_goal), self_collision=False),
            )


def scenarios() -> Iterator[tuple[str, tm.Problem]]:
    """The scenarios of the examples."""
    for path in sorted(SCENARIOS.glob("*.toml")):
        yield path.stem, tm.load_scenario(path).problem
