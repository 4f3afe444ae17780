"""First programs: a transcription for a guess, and the guess as its iterate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.initial_guess.guess import Guess
from tominpmp.initial_guess.warm_start import WarmStart
from tominpmp.options import Options
from tominpmp.transcription.bspline import DEGREES, BSplineTranscription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.exchange import exchanged
from tominpmp.transcription.grid import (
    delayed_shares,
    segment_intervals,
    segmented_shares,
)
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

# Relative room of torques between the rows up to which a former motion rests on them.
NEARLY = 1e-2
# A timed guess lies on the limits; the grid rounds it. This much slower it is nearly
# admissible.
GUESS_STRETCH = 1.02
# The same for motions whose accelerations must not jump.
SMOOTH_STRETCH = 1.3
# Violation, in units of the rows, from which a guess on a grid of constant torques is
# no beginning, how often its intervals are halved at most, and what share of the
# violation may be left for that to help.
ASTRAY, HALVINGS, HELPS = 1.0, 3, 0.5

# A program, and where it begins.
Begun = tuple[NonlinearProgram, Array]


def rested(program: NonlinearProgram, z: Array) -> Begun:
    """Program with the rows between knots that are active at a warm start."""
    return exchanged(program, z, -NEARLY) or program, z


def first_program(system: ProblemFunctions, options: Options, guess: Guess) -> Begun:
    """Program for a guess, and the guess as its iterate."""
    grid = options.intervals, options.grid
    timed = GUESS_STRETCH if guess.timed else 1.0
    if options.method == "collocation":
        if isinstance(guess, WarmStart):
            return guess.lifted_program(system, *grid)
        return collocated(system, options, guess, timed * guess.duration)
    degree = DEGREES.get(options.control)
    if isinstance(guess, WarmStart) and not system.parts:
        if degree is not None:
            return guess.spline_program(system, *grid, degree)
        return rested(*guess.inverse_program(system, *grid))
    shares, ends = guess_grid(system, options, guess)
    of: BSplineTranscription
    if degree is None:
        of = InverseTranscription(system, shares, guess.duration, ends)
    else:
        of = BSplineTranscription(system, shares, degree, ends)
        timed = 1.0 if guess.solved else SMOOTH_STRETCH
    eta = np.full(shares.shape[1], timed * guess.duration)
    z = of.start(guess.position, guess.duration, eta)
    return NonlinearProgram.of(of).at(z), z


def collocated(
    system: ProblemFunctions, options: Options, guess: Guess, duration: float
) -> Begun:
    """Program in states and torques for a guess, on a grid that its dynamics bear.

    Torques that are constant over an interval drive an arm away from the guess. Where
    that is far, linear programs promise nothing, so that intervals are halved until it
    is not, some times at most.
    """

    def halved(halvings: int) -> tuple[NonlinearProgram, Array, float]:
        finer = replace(options, intervals=2**halvings * options.intervals)
        shares = guess_grid(system, finer, guess)[0].sum(axis=1, keepdims=True)
        lifted = CollocationTranscription(system, shares, guess.duration)
        nodes = np.concatenate([[0.0], np.cumsum(shares)])
        path = guess.position(nodes * guess.duration)
        start = lifted.start(path, np.array([duration]))
        program = NonlinearProgram.of(lifted).at(start)
        violation = program.rows.largest_violation(program.evaluate(start))
        return program, start, violation

    program, start, violation = halved(0)
    for halvings in range(1, HALVINGS + 1):
        if violation <= ASTRAY:
            break
        finer = halved(halvings)
        if not finer[2] <= HELPS * violation:
            break  # other limits are broken, whatever the intervals
        program, start, violation = finer
    return program, start


def guess_grid(
    system: ProblemFunctions, options: Options, guess: Guess
) -> tuple[Array, tuple[int, ...]]:
    """Grid for a guess.

    Returns:
        Lengths of the intervals by the durations, shape (N, m), and the number of
        intervals up to the end of each segment; empty after a delay.
    """
    smooth, sudden = options.control in DEGREES, system.sudden
    if guess.delay > 0.0:
        # The time before it sets out has intervals of its own.
        delay = guess.delay / guess.duration
        shares = delayed_shares(options.intervals, delay, sudden=sudden)
        return np.sum(shares, axis=1, keepdims=True) if smooth else shares, ()
    durations = guess.durations
    counts = segment_intervals(options.intervals, durations)
    shares = segmented_shares(options.grid, counts, durations, smooth, sudden=sudden)
    return shares, tuple(np.cumsum(counts).tolist())
