"""Replay: integration of the torques of a motion by an independent integrator.

Transcriptions have their own integrators, or need no integration; a motion is accepted
if an integration by SciPy, which knows only the start of the problem and the torques
over time, ends at the goal. The integration restarts where the torque may jump, and
where a joint with dry friction stops or is released, so that no step straddles a jump
of the acceleration.
"""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from scipy import integrate
from scipy.integrate import ODEintWarning, OdeSolver, odeint

from tominpmp.arrays import Array, FrozenArray, Record
from tominpmp.checks import choice
from tominpmp.motion.samples import subdivided
from tominpmp.motion.trajectory import Trajectory, torque_breaks
from tominpmp.robot.robot import Robot
from tominpmp.stopping import check
from tominpmp.verification.plant import STILL, Plant, Slope
from tominpmp.verification.polynomials import Pieces

# Relative and absolute tolerance of the integration [rad, m, rad/s, m/s].
RTOL, ATOL = 1e-9, 1e-11
# Factor by which the tolerances of LSODA are tighter. It costs no more evaluations, as
# LSODA restarts with short steps at every jump.
LSODA_TIGHTNESS = 1000.0
# Errors at the end of a replay, as shares of RTOL times the growth of errors along the
# motion, see docs/verification.md.
ERRORS: dict[str, float] = {"DOP853": 0.02, "LSODA": 0.02, "Radau": 1.0}
# Largest time between two rows of a replay [s].
TIME_STEP = 1e-3
# Least number of rows, about, and largest number: shorter motions have a smaller time
# between rows, longer ones a larger time.
FEWEST_ROWS, MOST_ROWS = 200, 200_000
# Ratio of the first step of a piece to the last step of the piece before.
GROWTH = 1.5
# Largest number of steps of LSODA between two rows.
LSODA_STEPS = 20_000
# Events closer to the end of a piece are neglected: no solver can step over this time
# [spacings of floating-point numbers].
NEGLECTED = 100.0
# Largest number of evaluations before an integration is given up.
MAX_EVALUATIONS = 500_000
# Number of evaluations between checks of the deadline.
WATCH = 256
# LSODA of SciPy before 1.17 and the filters of warnings have one state for all threads.
AT_WORK = threading.Lock()
# Velocity beyond which an integration has failed. Positions do not tell: a continuous
# joint may have made any number of turns.
MAX_SPEED = 1e6

Integrator: TypeAlias = Literal["DOP853", "LSODA", "Radau"]


@dataclass(frozen=True, eq=False)
class Replay(Record):
    """The motion of a robot under prescribed torques.

    Attributes:
        joint_names: Names of the joints, in column order.
        t: Times [s], all nodes included, at most a millisecond apart unless the motion
            is longer than some minutes, and less if it is short, see FEWEST_ROWS,
            shape (m,).
        q: Positions [rad or m], shape (m, n).
        v: Velocities [rad/s or m/s], shape (m, n).
        u: Torques [N m or N], at a jump the torques just after it, shape (m, n).
        way: Sliding directions of joints with dry friction, halfway between two times:
            1, -1, or 0 for joints that friction holds, shape (m - 1, n).
        integrator: "DOP853", "LSODA" or "Radau", or "planned" for samples of a plan,
            without an integration.
        evaluations: Number of evaluations of the dynamics.
        complete: Whether the end of the motion was reached; otherwise the rows end
            where the integration failed.
    """

    joint_names: tuple[str, ...]
    t: FrozenArray
    q: FrozenArray
    v: FrozenArray
    u: FrozenArray
    way: FrozenArray
    integrator: str
    evaluations: int
    complete: bool

    @property
    def duration(self) -> float:
        """Time of the last row [s]."""
        return float(self.t[-1])

    def between(self, begin: float, end: float) -> Replay:
        """The rows from one time to another [s], both included."""
        kept = np.flatnonzero((self.t >= begin) & (self.t <= end))
        t, q, v, u = (rows[kept] for rows in (self.t, self.q, self.v, self.u))
        way = self.way[kept[:-1]]
        return replace(self, t=t, q=q, v=v, u=u, way=way)


def torque_pieces(robot: Robot, trajectory: Trajectory) -> Pieces:
    """Torques of a trajectory as polynomials of time, with jumps between the pieces."""
    breaks = torque_breaks(trajectory, robot.friction)
    return Pieces.of(lambda times: trajectory(times).u, breaks)


def planned(
    trajectory: Trajectory,
    time_step: float | None = None,
    torque: Pieces | None = None,
) -> Replay:
    """Samples of a planned motion in the form of a replay, without an integration.

    Args:
        trajectory: The motion.
        time_step: Largest time between two rows [s]; None for that of a replay.
        torque: Torques of the motion, whose jumps have rows like those of a replay;
            None for rows at the nodes only.
    """
    nodes = trajectory.t if torque is None else torque.t
    step = _row_step(trajectory.duration) if time_step is None else time_step
    t = subdivided(nodes, step)
    q, v, _, u = trajectory(t)
    way = trajectory.turns.at(0.5 * (t[1:] + t[:-1]))
    return Replay(
        trajectory.joint_names, t, q, v, u, way, "planned", evaluations=0, complete=True
    )


def _row_step(duration: float) -> float:
    """Largest time between two rows of the replay of a motion [s].

    Args:
        duration: Duration of the motion [s].
    """
    return max(min(TIME_STEP, duration / FEWEST_ROWS), duration / MOST_ROWS)


class _GivenUp(Exception):
    """Raised to abort an integration that takes too many evaluations."""


class Integration:
    """Integration of the torques of a trajectory.

    Args:
        plants: The robots of the segments.
        trajectory: The motion.
        pieces: Torques of the motion, see :func:`torque_pieces`.
        integrator: "DOP853" (explicit), "LSODA" (Adams, or backward differences for
            stiff arms) or "Radau" (implicit); None for LSODA.
        tightness: Factor by which the tolerances are tighter than the defaults.

    Attributes:
        pieces: The torques.
        plants: The robots of the segments.
        integrator: Name of the integrator.
        error: Errors at the end, as a share of the growth of errors along the motion.
        evaluations: Number of evaluations of the dynamics so far.
        lsoda_tightness: Tightness of LSODA, see :data:`LSODA_TIGHTNESS`.
        long_first_step: Whether the first step of LSODA takes a whole piece; otherwise
            LSODA chooses a step that is short enough for any motion.
        atol: Absolute tolerance, see :data:`ATOL`.
    """

    lsoda_tightness, long_first_step, atol = LSODA_TIGHTNESS, False, ATOL

    def __init__(
        self,
        plants: Sequence[Plant],
        trajectory: Trajectory,
        pieces: Pieces,
        integrator: Integrator | None = None,
        tightness: float = 1.0,
    ) -> None:
        choice(integrator, (*get_args(Integrator), None), "integrator")
        self.plants, self._trajectory, self.pieces = plants, trajectory, pieces
        self._segment = trajectory.segment_at(0.5 * (pieces.t[1:] + pieces.t[:-1]))
        self.integrator: Integrator = integrator or "LSODA"
        self.error = RTOL * ERRORS[self.integrator]
        if self.integrator == "LSODA":
            tightness *= self.lsoda_tightness
        self._tolerance = RTOL / tightness, self.atol / tightness
        for plant in self.plants:
            plant.still = max(STILL, 10.0 * self._tolerance[1])
        self.evaluations = 0
        self._stride = np.inf

    def run(self, start: Array) -> Replay:
        """Integrate from a state of shape (2n,) to the end."""
        pieces, n = self.pieces, start.size // 2
        every = subdivided(pieces.t, _row_step(self._trajectory.duration))
        ends = np.searchsorted(every, pieces.t)
        parts, x = [(np.zeros(1), start[None], np.zeros((0, n)))], start
        for k in range(pieces.count):
            check()
            ticks = every[ends[k] : ends[k + 1] + 1]
            rows, way = self._piece(k, x, ticks)
            parts.append((ticks[1 : len(rows) + 1], rows, way))
            if len(rows) < ticks.size - 1:
                break
            x = rows[-1]
        t, path, way = map(np.concatenate, zip(*parts, strict=True))
        motion = t, path[:, :n], path[:, n:], pieces(t), way
        how = self.integrator, self.evaluations, bool(t[-1] == pieces.t[-1])
        return Replay(self._trajectory.joint_names, *motion, *how)

    def _watched(self, slope: Slope) -> Slope:
        """A state derivative that counts its evaluations, and aborts long integrations.

        A piece of a slow motion may take minutes: only a call from the integrator can
        interrupt it.
        """

        def watched(t: float, x: Array) -> Array:
            self.evaluations += 1
            if self.evaluations % WATCH == 0:
                check()
                if self.evaluations > MAX_EVALUATIONS:
                    raise _GivenUp
            return slope(t, x)

        return watched

    def defects(self) -> Array:
        """Defects of the intervals, each integrated from its first node.

        Returns:
            Differences of the final states from the next nodes, shape (N, 2n); NaN for
            failed integrations.
        """
        nodes = np.concatenate([self._trajectory.q, self._trajectory.v], axis=1)
        pieces, out = self.pieces, np.full_like(nodes[1:], np.nan)
        interval = np.searchsorted(self._trajectory.t, pieces.t[:-1], side="right") - 1
        for k in range(out.shape[0]):
            check()
            x = nodes[k]
            for piece in np.flatnonzero(interval == k).tolist():
                ticks = subdivided(pieces.t[piece : piece + 2], TIME_STEP)
                rows, _ = self._piece(piece, x, ticks)
                x = rows[-1] if len(rows) == ticks.size - 1 else np.full_like(x, np.nan)
            out[k] = x - nodes[k + 1]
        return out

    def _piece(self, k: int, x: Array, times: Array) -> tuple[Array, Array]:
        """Integrate over a piece of torque.

        Args:
            k: Index of the piece.
            x: State at the beginning of the piece, shape (2n,).
            times: Beginning of the piece, and times of rows up to the end of the piece
                [s], shape (m + 1,).

        Returns:
            States at the rows, shape (m, 2n), and directions of joints with dry
            friction before each row, shape (m, n); fewer rows after a failure.
        """
        begin, end = float(times[0]), float(times[-1])
        plant = self.plants[self._segment[k]]
        plant.load(begin, end, self.pieces.coefficients[k])
        rows, ways = np.empty((0, x.size)), np.empty((0, x.size // 2))
        if not np.all(np.isfinite(x)) or self.evaluations > MAX_EVALUATIONS:
            return rows, ways
        # Rows that are far apart may miss events of dry friction between them.
        dense = not plant.dry.any() or np.max(np.diff(times)) < 2.0 * TIME_STEP
        with AT_WORK, np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", ODEintWarning)
            if self.integrator == "LSODA" and dense:
                x = plant.settle(begin, x)
                states = self._fortran(plant, x, times)
                done = plant.unchanged(times, states)
                rows, ways = states[1 : done + 1], np.tile(plant.way, (done, 1))
                begin, x = float(times[done]), states[done]
                if done == times.size - 1 or self.evaluations > MAX_EVALUATIONS:
                    return rows, ways
                # A joint stops or is released, or odeint has refused the piece, for
                # which rounding suffices: the rest is integrated step by step.
            more, later = self._steps(plant, x, begin, times[len(rows) + 1 :])
        return np.vstack([rows, more]), np.vstack([ways, later])

    def _fortran(self, plant: Plant, x: Array, times: Array) -> Array:
        """States at times, by LSODA; after a failure only the first state."""
        # For a first step of zero, LSODA chooses the step.
        first = float(times[-1] - times[0]) if self.long_first_step else 0.0
        try:
            rows = odeint(
                self._watched(plant.slope),
                x,
                times,
                Dfun=plant.jacobian,
                tfirst=True,
                rtol=self._tolerance[0],
                atol=self._tolerance[1],
                h0=first,
                tcrit=times[-1:],  # no evaluation of the torque beyond the piece
                mxstep=LSODA_STEPS,
            )
        except (ODEintWarning, _GivenUp):
            return x[None]
        inside = np.all(np.abs(rows[:, x.size // 2 :]) < MAX_SPEED, axis=1)
        end = inside.size if inside.all() else int(np.argmin(inside))
        return np.asarray(rows[: max(end, 1)])

    def _steps(
        self, plant: Plant, x: Array, begin: float, ticks: Array
    ) -> tuple[Array, Array]:
        """Integrate step by step with an ``OdeSolver`` of SciPy.

        The integration restarts where a joint with dry friction stops or is released.
        """
        t, end, done, passed = begin, float(ticks[-1]), 0, 0
        middles = 0.5 * (ticks + np.concatenate([[begin], ticks[:-1]]))
        rows = np.empty((ticks.size, x.size))
        ways = np.zeros((ticks.size, x.size // 2))
        solver: OdeSolver | None = None
        with contextlib.suppress(_GivenUp):
            while t < end:
                if solver is None:
                    x = plant.settle(t, x)
                    solver = self._solver(plant, t, x, end)
                solver.step()
                lost = not np.all(np.abs(solver.y[x.size // 2 :]) < MAX_SPEED)
                if solver.status == "failed" or lost:
                    break
                t = solver.t
                if t < ticks[done] and not plant.dry.any():
                    continue
                curve = solver.dense_output()
                t = plant.changes(solver.t_old, t, curve)
                if end - t < NEGLECTED * np.spacing(end):
                    t = end
                behind = int(np.searchsorted(ticks, t, side="right"))
                rows[done:behind] = curve(ticks[done:behind]).T
                ways[passed:] = plant.way
                done, passed = behind, int(np.searchsorted(middles, t, side="right"))
                self._stride = GROWTH * float(solver.step_size)
                if t < solver.t:
                    x, solver = curve(t), None
                elif t == end:
                    rows[-1] = solver.y
        return rows[:done], ways[:done]

    def _solver(self, plant: Plant, t: float, x: Array, end: float) -> OdeSolver:
        """A solver of SciPy from a time to the end of a piece."""
        rtol, atol = self._tolerance
        # Newton's method has no initial guess in the first step.
        first = {"DOP853": min(end - t, self._stride), "Radau": 0.1 * (end - t)}
        settings: dict[str, Any] = {"first_step": first.get(self.integrator)}
        if self.integrator != "DOP853":
            settings["jac"] = plant.jacobian
        make: type[OdeSolver] = getattr(integrate, self.integrator)
        slope = self._watched(plant.slope)
        return make(slope, t, x, end, rtol=rtol, atol=atol, **settings)
