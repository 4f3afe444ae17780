"""Programs that are solved again where joints with dry friction turn out to turn."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from tominpmp.arrays import Array
from tominpmp.attempts.attempt import STOPPED
from tominpmp.solvers.iterate import SlpResult
from tominpmp.transcription.adjoint import AdjointTranscription
from tominpmp.transcription.collocation import CollocationTranscription

# Solves with other signs of the velocities.
ROUNDS = 6

Held = TypeVar("Held", CollocationTranscription, AdjointTranscription)


def solve_turning(
    program: Held,
    z: Array,
    solve: Callable[[Held, Array, SlpResult | None], SlpResult],
) -> tuple[Held, SlpResult]:
    """Solve until joints move the way that the program takes them to move.

    Args:
        program: The program.
        z: Where to begin.
        solve: Solves a program from an iterate on, after a former result.

    Returns:
        The last program and its solution; those given where nothing has dry friction.
    """
    result = solve(program, z, None)
    for _ in range(ROUNDS):
        turned = None
        if result.status not in STOPPED:
            turned = program.turned(result.iterate.z)
        if turned is None:
            break
        program, z = turned
        result = solve(program, z, result)
    return program, result
