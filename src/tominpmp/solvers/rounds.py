"""Rounds: solve a program, look at the motion between its rows, solve on with more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import cast

from tominpmp.arrays import Array
from tominpmp.constraints.friction import OVERLOAD
from tominpmp.options import Options
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.restoration import cured
from tominpmp.status import STOPPED, Status
from tominpmp.transcription.exchange import revised
from tominpmp.transcription.program import NonlinearProgram
from tominpmp.verification.verification import LONGEST

# Rounds of adding rows at most, and iterations of each.
ROUNDS = 12
ROUND_ITERATIONS = 25
# Progress below which rows between the nodes are looked for while the duration still
# falls: rows that a finished motion breaks cost a new solve.
ROUGH = 1e-2
# Where rows are violated by so much, more of them between the nodes would not help.
FAR = 1e-2

Solve = Callable[[NonlinearProgram, Array, Options, SlpResult | None], SlpResult]


def solve_in_rounds(
    program: NonlinearProgram,
    z: Array,
    options: Options,
    solve: Solve,
    *,
    rough: bool = True,
    light: float = 0.0,
    over: Callable[[], bool] = lambda: False,
    overload: float = OVERLOAD,
) -> tuple[NonlinearProgram, SlpResult]:
    """Solve until the motion keeps its limits between the rows too.

    Args:
        program: The program.
        z: Where to begin.
        options: Options of the plan.
        solve: Solves a program from an iterate on, with options, after a former result.
        rough: Whether rows between the nodes are looked for early, where that is dear.
        light: Violations between the rows that are no larger than this are cured by
            slowing down.
        over: Tells whether what was solved is not gone on with.
        overload: Relative excess of torques between the rows that is let pass.

    Returns:
        The last program and its outcome.
    """
    first = options
    if rough and any(block.gradual for block in program.blocks):
        first = replace(options, tolerance=max(ROUGH, options.tolerance))
    few = replace(options, max_iterations=min(options.max_iterations, ROUND_ITERATIONS))
    result = solve(program, z, first, None)
    program = _last(program, result)
    settled = first is options
    for _ in range(ROUNDS):
        far = result.best is None and result.iterate.violation > FAR
        ended = result.status in STOPPED or over()
        if ended or (far and settled) or _too_long(result):
            break
        z = result.iterate.z
        if not far:
            changed = revised(program, z, overload)
            if changed is None and settled:
                break
            program, z = changed or (program, z)
            program = program.at(z)
            slower = _slower(program, z, result, light, options) if settled else None
            if slower is not None:
                result = slower
                continue
        result = solve(program, z, few if settled else options, result)
        program = _last(program, result)
        settled = True
    else:
        last = result.iterate.z
        if result.status is Status.CONVERGED and revised(program, last, overload):
            # It has settled on rows that are not all that it needs.
            result = replace(result, status=Status.ITERATION_LIMIT)
    return program, result


def _slower(
    program: NonlinearProgram,
    z: Array,
    result: SlpResult,
    light: float,
    options: Options,
) -> SlpResult | None:
    """A result whose motion is slowed down a little; None if that is no cure."""
    if light <= 0.0:
        return None
    iterate = result.iterate.on(program, z)
    slower = cured(program, iterate, light, options.feasibility)
    if slower is None:
        return None
    return replace(result, iterate=slower, best=slower, program=program)


def _last(program: NonlinearProgram, result: SlpResult) -> NonlinearProgram:
    """The program with the rows that joined it while it was solved."""
    return program if result.program is None else cast(NonlinearProgram, result.program)


def _too_long(result: SlpResult) -> bool:
    """Whether nobody will replay the motion: it is not looked at between its rows."""
    return bool(result.history) and result.history[-1].duration > LONGEST
