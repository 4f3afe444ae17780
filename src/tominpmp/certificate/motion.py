"""A motion on the grid of its certificate."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.certificate.perturbations import (
    JUST_INSIDE,
    Perturbations,
    Shape,
    certificate_grid,
)
from tominpmp.constraints import States
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions

# Instants of an interval over which its mean torque is taken.
SAMPLES = 8
# Accelerations that jump by less than this share of the largest one are continuous.
SAME = 1e-6


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion on a grid, on which its limits are rows.

    Attributes:
        system: The functions of the problem, without padding of distances.
        trajectory: The motion.
        changes: Its small changes.
        span: First interval on which the problem holds, and the one after its last.
        sections: The same motion on each of its segments, with the functions of the
            segment; empty for one segment.
        number: Number of the segment, from 0; None for one segment.
    """

    system: ProblemFunctions
    trajectory: Trajectory
    changes: Perturbations
    span: tuple[int, int]
    sections: tuple[Motion, ...] = ()
    number: int | None = None

    @classmethod
    def of(cls, system: ProblemFunctions, trajectory: Trajectory) -> Motion:
        """Put a motion on a grid that suits it."""
        system = system.padded(0.0)
        t, joined = certificate_grid(trajectory)
        nodes = trajectory(t)
        changes = Perturbations(t, nodes.q, nodes.v, _shape(system, trajectory, joined))
        whole = cls(system, trajectory, changes, (0, changes.N))
        if trajectory.segment_ends is None:
            return whole
        places = [0, *np.searchsorted(t, trajectory.segment_ends).tolist()]
        each = zip(system.segments, itertools.pairwise(places), strict=True)
        sections = tuple(
            replace(whole, system=part, span=span, number=number)
            for number, (part, span) in enumerate(each)
        )
        return replace(whole, sections=sections)

    @cached_property
    def path(self) -> Trajectory:
        """The motion without its inverse dynamics, which take time."""
        return replace(self.trajectory, inverse_dynamics=None, segment_dynamics=())

    @property
    def segments(self) -> tuple[Motion, ...]:
        """The motion on each of its segments; the motion itself for one segment."""
        return self.sections or (self,)

    @property
    def constraints(self) -> list[Any]:
        """Constraints along the motion, of one segment after the other."""
        every = (one.system.problem.constraints for one in self.segments)
        return [item for items in every for item in items]

    @property
    def driven(self) -> IntArray:
        """Joints with a motor."""
        limits = self.system.problem.robot.limits
        return np.flatnonzero(limits.effort_upper > limits.effort_lower)

    # -- states ------------------------------------------------------------------------

    def instants(self, *shares: float) -> Instants:
        """The same shares of all intervals of its span."""
        return Instants.spread(self.changes.N, shares).within(*self.span)

    def _times(self, at: Instants) -> Array:
        """Times of instants [s], just inside of an interval at its ends."""
        share = np.clip(at.share, JUST_INSIDE, 1.0 - JUST_INSIDE)
        return self.changes.t[at.interval] + share * self.changes.h[at.interval]

    def ways(self, at: Instants) -> Array:
        """Directions of the joints at instants, 0 at rest, shape (m, n)."""
        return self.trajectory.turns.at(self._times(at))

    def torques(self, at: Instants) -> Array:
        """Torques of the motors at instants, shape (m, n) [N m or N]."""
        return np.asarray(self.trajectory(self._times(at)).u)

    def states(self, at: Instants) -> States:
        """States at instants; accelerations are those of torques that are given."""
        times = self._times(at)
        q, v, a, u = self.path(times)
        if self.trajectory.inverse_dynamics is None:
            dry = self.system.problem.robot.friction * self.ways(at)
            x = np.concatenate([q, v], axis=1)
            a = self.system.dynamics.forward(x, u - dry)[:, self.changes.n :]
        return States(times, q, v, a)

    # -- torques as shares of their limits ---------------------------------------------

    def _shares(self, *places: float) -> Array:
        """Torques at shares of all intervals, in shares of their limits, (N, k, n)."""
        found = []
        for one in self.segments:
            u = one.torques(one.instants(*places))
            shares = (u - one.system.effort_middle) / one.system.effort_half
            found.append(shares.reshape(-1, len(places), self.changes.n))
        return np.concatenate(found)

    @cached_property
    def loads(self) -> Array:
        """Torques at both ends of its intervals, shape (N, 2, n)."""
        return self._shares(0.0, 1.0)

    @cached_property
    def load(self) -> Array:
        """Mean torque of its intervals, shape (N, n)."""
        places = (np.arange(SAMPLES) + 0.5) / SAMPLES
        if self.changes.shape != "torques":
            return np.asarray(self.loads.mean(axis=1))
        return np.asarray(self._shares(*places.tolist()).mean(axis=1))

    @cached_property
    def inertia(self) -> tuple[Array, Array]:
        """Mean derivatives of torques by accelerations and by speeds, shape (n,)."""
        found = []
        for one in self.segments:
            state = one.states(one.instants(0.5))
            by = one.system.dynamics.inverse_jacobians(state.q, state.v, state.a)
            found.append([np.einsum("mii->mi", part) for part in (by.tau_a, by.tau_v)])
        mass, drag = map(np.vstack, zip(*found, strict=True))
        return np.maximum(mass.mean(axis=0), 1e-12), np.abs(drag).mean(axis=0)


def _shape(system: ProblemFunctions, trajectory: Trajectory, joined: bool) -> Shape:
    """The quantity that is constant on the intervals of a motion."""
    if system.motion_limits.continuous:
        return "ramps"
    if trajectory.inverse_dynamics is None or joined:
        return "torques"
    t, h = trajectory.t, np.diff(trajectory.t)
    before = trajectory(t[1:] - JUST_INSIDE * h).a[:-1]
    after = trajectory(t[:-1] + JUST_INSIDE * h).a
    jump = float(np.max(np.abs(after[1:] - before), initial=0.0))
    largest = float(np.max(np.abs(after), initial=0.0))
    return "ramps" if jump <= SAME * largest else "steps"
