"""Initial programs: a transcription that fits a guess, and the guess as its iterate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.initial_guess.guess import Guess
from tominpmp.initial_guess.warm_start import WarmStart
from tominpmp.options import Options
from tominpmp.problem.segments import Segment, arrival_window
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.exchange import CLOSE_VALUE, exchanged
from tominpmp.transcription.grid import (
    delayed_shares,
    segment_intervals,
    segmented_shares,
)
from tominpmp.transcription.layout import LIFTED, QUADRATIC, Layout
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

# A timed guess is at its limits, and breaks them as it is rounded to the grid. With its
# duration multiplied by this factor it is nearly feasible.
GUESS_TIME_SCALE = 1.02
# The same factor for motions with continuous accelerations.
SMOOTH_TIME_SCALE = 1.3
# A guess on a grid of constant torques is no suitable initial iterate if its violation
# exceeds LARGE_VIOLATION, in units of the rows. Its intervals are halved at most
# HALVINGS times, as long as the violation falls to the share REMAINING.
LARGE_VIOLATION, HALVINGS, REMAINING = 1.0, 3, 0.5

# A nonlinear program and its initial iterate.
InitialProgram = tuple[NonlinearProgram, Array]


def with_active_rows(program: NonlinearProgram, z: Array) -> InitialProgram:
    """Add the rows between knots that are nearly active at a warm start."""
    return exchanged(program, z, -CLOSE_VALUE) or program, z


def first_program(
    system: ProblemFunctions, options: Options, guess: Guess
) -> InitialProgram:
    """Nonlinear program for a guess, and the guess as its initial iterate."""
    system, lifted = system.passing(guess.ends), options.method == "collocation"
    degree = LIFTED if lifted else DEGREES.get(options.control, QUADRATIC)
    if isinstance(guess, WarmStart) and not system.parts:
        of, z = guess.iterate(system, options.intervals, options.grid, degree)
        program = NonlinearProgram.of(of).at(z)
        return (program, z) if lifted else with_active_rows(program, z)
    timed = GUESS_TIME_SCALE if guess.timed else 1.0
    if lifted:
        return _collocated(system, options, guess, timed * guess.duration)
    shares, ends = _guess_grid(system, options, guess)
    if degree != QUADRATIC:
        timed = 1.0 if guess.solved else SMOOTH_TIME_SCALE
    eta = np.full(shares.shape[1], guess.duration)
    layout = Layout(degree, shares, eta, ends)
    transcription = layout.transcription(system)
    if ends:
        eta = eta * _waiting_scales(system.problem.segments, timed * guess.durations)
    z = transcription.start(guess.position, guess.duration, timed * eta)
    return NonlinearProgram.of(transcription).at(z), z


def _waiting_scales(segments: Sequence[Segment], durations: Array) -> Array:
    """Time-scaling factors of segments that must not end before an earliest arrival.

    Steps change durations by shares: a segment that ends where it begins, of nearly no
    duration, would not become long enough.

    Args:
        segments: The segments; empty for a problem without segments.
        durations: Durations of the segments of a guess, without dwells, shape (k,) [s].

    Returns:
        Shape (k,), 1 for segments that are long enough.
    """
    scales, now = np.ones(durations.size), 0.0
    for k, segment in enumerate(segments):
        earliest, _ = arrival_window(segment)
        scales[k] = max(1.0, (earliest - now) / durations[k])
        now += scales[k] * durations[k] + segment.dwell
    return scales


def _collocated(
    system: ProblemFunctions, options: Options, guess: Guess, duration: float
) -> InitialProgram:
    """Collocation program for a guess, on a grid fine enough for its dynamics.

    Torques that are constant over an interval drive an arm away from the guess. If the
    deviation is large, the linearisation predicts no improvement; intervals are
    therefore halved, a limited number of times, until the violation is small.
    """
    least = np.inf
    for halvings in range(HALVINGS + 1):
        finer = replace(options, intervals=2**halvings * options.intervals)
        shares = _guess_grid(system, finer, guess)[0].sum(axis=1, keepdims=True)
        lifted = CollocationTranscription(system, shares, guess.duration)
        z = lifted.start(guess.position, guess.duration, np.array([duration]))
        program = NonlinearProgram.of(lifted).at(z)
        violation = program.rows.largest_violation(program.evaluate(z))
        if halvings and not violation <= REMAINING * least:
            break  # shorter intervals do not help: other limits are violated
        best, least = (program, z), violation
        if violation <= LARGE_VIOLATION:
            break
    return best


def _guess_grid(
    system: ProblemFunctions, options: Options, guess: Guess
) -> tuple[Array, tuple[int, ...]]:
    """Grid for a guess.

    Returns:
        Lengths of the intervals as shares of the m durations, shape (N, m), and the
        number of intervals up to the end of each segment, which is empty for guesses
        that begin with a delay.
    """
    smooth, sudden = options.control in DEGREES, system.sudden
    if guess.delay > 0.0:
        # The delay before the arm starts to move has intervals of its own.
        delay = guess.delay / guess.duration
        shares = delayed_shares(options.intervals, delay, sudden=sudden)
        return np.sum(shares, axis=1, keepdims=True) if smooth else shares, ()
    durations = guess.durations
    counts = segment_intervals(options.intervals, durations)
    shares = segmented_shares(options.grid, counts, durations, smooth, sudden=sudden)
    return shares, tuple(np.cumsum(counts).tolist())
