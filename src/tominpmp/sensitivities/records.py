"""Records of sensitivities: how the duration of a motion depends on its limits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.arrays import FrozenArray, Record, number_or_nan
from tominpmp.checks import instance, whole, wrong
from tominpmp.motion_limits import joint_kinds
from tominpmp.notebook import text_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Powers of the factor by which the same path takes longer: parameters are then smaller
# by these powers of it. The powers of kinds of joint limits are their orders.
POWERS = {"gravity": 2, "friction": 2, "damping": 1, "speed of effort curve": 1}
# Steps of the tables: one per cent of a limit, a millimetre, a milliradian or a gram.
SHARE, SMALL_UNIT = 0.01, 1e-3
# Quantity that a record of a body refers to, by kind.
SHOWN = {"payload": "mass", "obstacle": "position"}
# Effect, as a share of T, from which a record appears in tables and pictures.
LEAST = 1e-6
SMALL_NAMES = {"1/m": "1 mm", "1/rad": "1 mrad", "1/kg": "1 g"}


@dataclass(frozen=True, eq=False)
class Sensitivity(Record):
    """Sensitivity of the duration to a limit or another parameter of the problem.

    Attributes:
        kind: "velocity", "effort", "acceleration", "jerk", "effort rate", "effort over
            speed", "speed of effort curve", "upper position", "lower position",
            "clearance", "margin", "gravity", "payload", "damping", "friction", "goal",
            "obstacle", or the name of a constraint.
        joint: Name of the joint; None for parameters of other subjects.
        subject: Name of the subject: joint, obstacle, pair of links, payload, frame,
            or "goal" for a goal without a frame; empty for gravity and the margin.
        value: d ln T / d ln limit: change of T in per cent if the limit grows by 1 %;
            negative if a larger limit makes the motion faster. If the logarithm of the
            limit is not defined, d ln T / d limit.
        unit: Unit of the value: empty for d ln T / d ln limit, otherwise one over the
            unit of the limit or of the position: "1/m", "1/rad", "1/kg", ...
        limit: Value of the limit [SI]; None if it is not a number.
        limit_unit: Unit of the limit.
        vector: Derivatives of ln T with respect to the coordinates of a position in the
            world, shape (3,) [1/m], or of gravity [s^2/m]; the value of a position is
            the length of the vector. None for other parameters.
    """

    kind: str
    joint: str | None
    subject: str
    value: float
    unit: str = ""
    limit: float | None = None
    limit_unit: str = ""
    vector: FrozenArray | None = None

    @property
    def step(self) -> float:
        """Step of the tables: one per cent; a thousandth for values with a unit."""
        return SMALL_UNIT if self.unit else SHARE

    @property
    def more(self) -> str:
        """The step in words."""
        return SMALL_NAMES.get(self.unit, "1 %")

    @property
    def effect(self) -> float:
        """Change of T by one step of the tables, to first order, as a share of T."""
        return self.value * self.step

    def scaled(self, share: float) -> Sensitivity:
        """The sensitivity of a longer motion, of which this motion is a share."""
        vector = None if self.vector is None else share * self.vector
        return replace(self, value=share * self.value, vector=vector)

    @property
    def label(self) -> str:
        """Subject and kind, in words."""
        if self.subject == "" or names_subject(self.kind, self.subject):
            return self.kind
        return f"{self.subject}: {SHOWN.get(self.kind, self.kind)}"


def names_subject(kind: str, subject: str) -> bool:
    """Whether the name of a kind of limit has its subject: "speed of frame tip"."""
    return f" {subject} " in f" {kind} "


@dataclass(frozen=True, eq=False)
class Sensitivities(Record):
    """Sensitivities of the duration of a motion to all limits of its problem.

    An iterable of records, in the order of their effects, the largest first.

    Attributes:
        T: Duration of the motion [s].
        records: The records.
        promise: Predicted gain of small changes of the motion, as a share of T: the
            values are exact at an optimum, and less accurate the larger the gain is.
        base: Derivatives of ln T with respect to a displacement of the robot's base:
            three translations along the axes of the world [1/m] and three rotations
            about these axes through the world's origin [1/rad], shape (6,).
    """

    T: float
    records: tuple[Sensitivity, ...]
    promise: float
    base: FrozenArray

    def __post_init__(self) -> None:
        """Sort the records by their effects."""
        super().__post_init__()
        ordered = sorted(self.records, key=lambda item: -abs(item.effect))
        self._keep(records=tuple(ordered))

    def __iter__(self) -> Iterator[Sensitivity]:
        """Iterate over the records."""
        return iter(self.records)

    def __len__(self) -> int:
        """Number of records."""
        return len(self.records)

    def __getitem__(self, index: int) -> Sensitivity:
        """A record by its index."""
        return self.records[index]

    def __repr__(self) -> str:
        """Show the number of records, and the largest effect, on one line."""
        first = f", first {self.records[0].label}" if self.records else ""
        return f"<Sensitivities of T = {self.T:.6g} s: {len(self)} records{first}>"

    def of(
        self, kind: str | None = None, subject: str | None = None
    ) -> tuple[Sensitivity, ...]:
        """Records of a kind, or of a subject.

        Args:
            kind: Kind of the records; None for all kinds.
            subject: Name of a joint, an obstacle, ...; None for all subjects.

        Raises:
            ProblemError: If kind or subject is neither a text nor None.
        """
        for name, value in (("kind", kind), ("subject", subject)):
            instance(value, (str, type(None)), name, "a text or None")
        return tuple(
            item
            for item in self.records
            if kind in (None, item.kind) and subject in (None, item.subject)
        )

    def total(self, kind: str) -> float:
        """Sum of the values of a kind: its limits are changed by the same share."""
        return math.fsum(item.value for item in self.of(kind))

    @property
    def balance(self) -> float:
        """Residual of the time scaling identity, zero for a motion from rest to rest.

        S_velocity + 2 S_effort + 2 S_acceleration + 3 S_jerk + 3 S_effort-rate + 2
        S_gravity + S_damping + 2 S_friction = -1 (torque-speed curves add 2 S for their
        torque axis and S for their speed axis) if no other parameter depends on time:
        with speed limits twice as large, and torque limits and gravity four times as
        large, the same path takes half the time. Moving obstacles, velocities at the
        ends, dwells and constraints of other kinds add to the residual.
        """
        powers = {kind.name: kind.order for kind in joint_kinds().values()} | POWERS
        return 1.0 + math.fsum(
            power * self.total(kind) for kind, power in powers.items()
        )

    @classmethod
    def of_cycle(
        cls,
        parts: Iterable[Sensitivities],
        T: float | None = None,
        names: Sequence[str] | None = None,
    ) -> Sensitivities:
        """Sensitivities of a cycle of several motions, one after the other.

        Records of the same kind and subject are added.

        Args:
            parts: Sensitivities of each motion.
            T: Duration of the cycle [s], with the time between the motions; None for
                the sum of the durations of the motions.
            names: Names of the goals, one for each motion; None numbers the goals.

        Raises:
            ProblemError: If ``parts`` is empty or holds other objects, the duration of
                the cycle is less than the sum of the durations, or names are too few or
                too many.
        """
        expected = "Sensitivities of motions"
        each = instance(parts, Iterable, "parts", expected)
        items = [instance(item, Sensitivities, "parts", expected) for item in each]
        goals = [f"goal {k + 1}" for k in range(len(items))] if names is None else names
        total = math.fsum(item.T for item in items)
        whole = total if T is None else number_or_nan(T)
        if not items or not whole >= total * (1.0 - 1e-9):
            raise wrong(T, "T", f"at least {total:.4g} s, and at least one motion")
        if not isinstance(goals, Sequence) or len(goals) != len(items):
            raise wrong(names, "names", "a name for each motion")
        scaled = []
        longest = whole or 1.0  # all values of motions without duration are 0
        for part, goal in zip(items, goals, strict=True):
            for record in part:
                on_goal = record.kind == "goal" and record.joint is None
                named = replace(record, subject=goal) if on_goal else record
                scaled.append(named.scaled(part.T / longest))
        base = sum(item.base * (item.T / longest) for item in items)
        promise = math.fsum(item.promise * item.T for item in items) / longest
        return cls(whole, summed(scaled), promise, np.asarray(base))

    def table(self, most: int | None = None) -> str:
        """Table of the sensitivities, a line for each record, the largest first.

        Args:
            most: Largest number of lines; None for all records with an effect.

        Raises:
            ProblemError: If ``most`` is not a whole number, or negative.
        """
        if most is not None:
            most = whole(most, "most", expected="a number of lines or None")
        shown = [item for item in self.records if abs(item.effect) >= LEAST]
        rows = [_row(item, self.T) for item in shown[:most]]
        head = ("what", "limit", "more by", "changes T by", "d ln T / d ln")
        omitted = len(shown) - len(rows)
        more = f"\nand {omitted} more of less effect" if omitted else ""
        return text_table([head, *rows], left=2) + more

    def plot(self, path: str | Path | None = None, *, most: int = 20) -> Figure:
        """Draw the sensitivities as bars, the largest first.

        Args:
            path: File to write (PNG, PDF or SVG, by the file ending), if any.
            most: Largest number of bars.

        Returns:
            The figure.

        Raises:
            ProblemError: If the ending of the path is unknown, or ``most`` is not a
                positive whole number.
            MissingDependency: If matplotlib is not installed.
        """
        from tominpmp.viz.plots import plot_sensitivities

        return plot_sensitivities(self, path=path, most=most)


def summed(records: Iterable[Sensitivity]) -> tuple[Sensitivity, ...]:
    """Sum the records of several motions by kind, subject and unit."""
    sums: dict[tuple[str, str, str], Sensitivity] = {}
    for item in records:
        key = item.kind, item.subject, item.unit
        sums[key] = _added(sums[key], item) if key in sums else item
    return tuple(sums.values())


def _added(sum_: Sensitivity, item: Sensitivity) -> Sensitivity:
    """Sum of a record and the same record of another motion."""
    value, vector = item.value, item.vector
    if item.limit != sum_.limit:
        # The sum applies to limits of different values, changed by the same share.
        sum_ = replace(sum_, limit=None)
    if vector is not None and sum_.vector is not None:
        vector = vector + sum_.vector
        if item.kind in ("goal", "obstacle"):
            return replace(sum_, value=float(np.linalg.norm(vector)), vector=vector)
    return replace(sum_, value=sum_.value + value, vector=vector)


def _row(item: Sensitivity, T: float) -> Sequence[str]:
    """Cells of a table line: label, limit, step, change of T, and value."""
    limit = "" if item.limit is None else f"{item.limit:.4g} {item.limit_unit}".strip()
    change = f"{1e3 * item.effect * T:+.3g} ms"
    value = f"{item.value:+.4f} {item.unit}".strip()
    return item.label, limit, item.more, change, value
