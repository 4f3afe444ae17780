"""First programs: a transcription for a guess, and the guess as its iterate."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.initial_guess.guess import Guess
from tominpmp.initial_guess.segments import SegmentedGuess
from tominpmp.initial_guess.warm_start import WarmStart
from tominpmp.options import Options
from tominpmp.transcription.base import Transcription
from tominpmp.transcription.bspline import DEGREES, BSplineTranscription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.exchange import exchanged
from tominpmp.transcription.grid import (
    delayed_shares,
    interval_shares,
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
    former = guess if isinstance(guess, WarmStart) else None
    grid = options.intervals, options.grid
    timed = GUESS_STRETCH if guess.timed else 1.0
    transcription: Transcription[Any]
    if isinstance(guess, SegmentedGuess):
        return segmented_program(system, options, guess)
    if options.method == "collocation":
        if former is not None:
            return former.lifted_program(system, *grid)
        return collocated(system, options, guess, timed * guess.duration)
    shares = guess_shares(system, options, guess)
    if options.control in DEGREES:
        degree = DEGREES[options.control]
        if former is not None:
            return former.spline_program(system, *grid, degree)
        shares = np.sum(shares, axis=1, keepdims=True)
        transcription = smooth = BSplineTranscription(system, shares, degree)
        eta = np.array([SMOOTH_STRETCH * guess.duration])
        start = smooth.start(guess.position, guess.duration, eta)
    else:
        if former is not None:
            return rested(*former.inverse_program(system, *grid))
        transcription = jumping = InverseTranscription(system, shares, guess.duration)
        eta = np.full(shares.shape[1], timed * guess.duration)
        start = jumping.start(guess.position, guess.duration, eta)
    return NonlinearProgram.of(transcription).at(start), start


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
        shares = np.sum(guess_shares(system, finer, guess), axis=1, keepdims=True)
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


def segmented_program(
    system: ProblemFunctions, options: Options, guess: SegmentedGuess
) -> Begun:
    """Program for a guess of several segments, and the guess as its iterate."""
    smooth, durations = options.control in DEGREES, guess.durations
    sudden = system.sudden or not smooth
    counts = segment_intervals(options.intervals, durations)
    shares = segmented_shares(options.grid, counts, durations, smooth, sudden=sudden)
    ends = tuple(np.cumsum(counts).tolist())
    transcription: Transcription[Any]
    if smooth:
        transcription = spline = BSplineTranscription(
            system, shares, DEGREES[options.control], ends
        )
        time_scale = 1.0 if guess.solved else SMOOTH_STRETCH
    else:
        transcription = spline = InverseTranscription(
            system, shares, guess.duration, ends
        )
        time_scale = GUESS_STRETCH if guess.timed else 1.0
    eta = np.full(len(ends), time_scale * guess.duration)
    start = spline.start(guess.position, guess.duration, eta)
    return NonlinearProgram.of(transcription).at(start), start


def guess_shares(system: ProblemFunctions, options: Options, guess: Guess) -> Array:
    """Grid for a guess: intervals of their own for the time before it sets out."""
    if guess.delay > 0.0:
        delay = guess.delay / guess.duration
        return delayed_shares(options.intervals, delay, sudden=system.sudden)
    return interval_shares(options.grid, options.intervals, sudden=system.sudden)
