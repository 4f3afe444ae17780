"""Which way joints with dry friction move at the torque rows of splines."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tominpmp.arrays import Array
from tominpmp.transcription.exchange import Extra, SplineExtra
from tominpmp.transcription.spline import Spline
from tominpmp.transcription.spline_rows import Instants
from tominpmp.transcription.system import System
from tominpmp.transcription.ways import Ways, signs

States = Callable[[Array], tuple[Array, Array, Array]]


class SplineWays:
    """Torques at the rows, friction and all.

    Attributes:
        system: Dynamics and limits.
        at: Instants of the rows, m of them.
        ways: Which way joints move there; None until a motion was looked at.
    """

    def __init__(self, system: System, at: Instants, ways: Ways | None) -> None:
        self.system, self.at, self.ways = system, at, ways

    def loads(self, spline: Spline) -> Array:
        """Torques at the rows as shares of their limits, shape (m, n)."""
        share, friction = self._shares(spline), self.system.friction
        if friction is None:
            return share
        return np.asarray(share + self._given(spline, friction).load)

    def _shares(self, spline: Spline) -> Array:
        system = self.system
        tau = system.dynamics.inverse(*self.at.states(spline))
        return np.asarray((tau - system.effort_middle) / system.effort_half)

    def _given(self, spline: Spline, friction: Array) -> Ways:
        """Which way joints move at the rows: as in the first motion looked at."""
        if self.ways is None:
            self.ways = Ways.of(friction, _signs(spline, self.at))
        return self.ways

    def turned(self, spline: Spline, more: Instants, overload: float) -> Extra:
        """New rows of torques, and which way joints move at all of them.

        Args:
            spline: The motion.
            more: Instants that become rows.
            overload: Relative excess of torques that is let pass.
        """
        friction = self.system.friction
        if friction is None:
            return Extra(more)
        given, sign = self._given(spline, friction), _signs(spline, self.at)
        wrong = given.wrong(sign, self._shares(spline), overload)
        ways = given.turned(sign, wrong)
        ways = ways.joined(Ways.of(friction, _signs(spline, more)))
        return Extra(more, ways=ways, turned=int(wrong.sum()))


def _signs(spline: Spline, at: Instants) -> Array:
    """Which way joints move at instants, shape (m, n)."""
    middle = Instants(at.interval, np.full(at.size, 0.5))
    return signs(at.states(spline)[1], middle.states(spline)[1])


class CurveWays:
    """The same for curves of any form, whose states are functions of the share of T.

    Attributes:
        system: Dynamics and limits.
        nodes: Nodes of the curve, as shares of T.
        times: Instants of the rows, m of them.
        ways: Which way joints move there; None until a motion was looked at.
    """

    def __init__(
        self, system: System, nodes: Array, times: Array, ways: Ways | None
    ) -> None:
        self.system, self.nodes, self.times, self.ways = system, nodes, times, ways

    def given(self, states: States) -> Ways | None:
        """Which way joints with friction move: as in the first motion looked at."""
        friction = self.system.friction
        if friction is not None and self.ways is None:
            self.ways = Ways.of(friction, self._signs(states, self.times))
        return self.ways

    def turned(self, states: States, more: Array, overload: float) -> SplineExtra:
        """New rows of torques, and which way joints move at all of them.

        Args:
            states: Positions, velocities and accelerations at shares of T.
            more: Instants that become rows, as shares of T.
            overload: Relative excess of torques that is let pass.
        """
        given, system = self.given(states), self.system
        if given is None:
            return SplineExtra(torque=more)
        tau = system.dynamics.inverse(*states(self.times))
        share = (tau - system.effort_middle) / system.effort_half
        sign = self._signs(states, self.times)
        wrong = given.wrong(sign, share, overload)
        ways = given.turned(sign, wrong)
        ways = ways.joined(Ways.of(given.friction, self._signs(states, more)))
        return SplineExtra(torque=more, ways=ways, turned=int(wrong.sum()))

    def _signs(self, states: States, times: Array) -> Array:
        """Which way joints move at shares of T, shape (m, n)."""
        if not times.size:
            return np.zeros((0, self.system.n))
        last = self.nodes.size - 2
        inside = np.clip(np.searchsorted(self.nodes, times) - 1, 0, last)
        middle = 0.5 * (self.nodes[inside] + self.nodes[inside + 1])
        return signs(states(times)[1], states(middle)[1])
