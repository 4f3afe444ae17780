"""Motion files: CSV for any program, NPZ for NumPy, YAML, JSON and MCAP for ROS.

All formats hold one row per instant: the time [s], then for every joint its position
[rad or m], velocity [rad/s or m/s], acceleration [rad/s^2 or m/s^2] and torque [N m or
N]. The columns of a CSV file are named ``time``, ``q_<joint>``, ``v_<joint>``,
``a_<joint>`` and ``u_<joint>``, without units, so that any program accepts the names;
motions of several segments have a last column ``segment`` with the segment numbers from
1. YAML and JSON files are messages of ROS 2, see :mod:`~tominpmp.files.ros`; MCAP files
are bags of them. Numbers are written with full precision, so that reading returns the
same bits; the times of ROS messages are whole nanoseconds, at which the motion is
evaluated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tominpmp.checks import TINY, choice, flag, instance
from tominpmp.description.fields import Field
from tominpmp.description.paths import (
    checked_ending,
    checked_path,
    read_bytes,
    write_file,
)
from tominpmp.description.yaml_reader import parse_yaml
from tominpmp.exceptions import ProblemError, ScenarioError, brief, warn_caller
from tominpmp.files import ros, tables
from tominpmp.motion.samples import INTERPOLATIONS, Interpolation, Samples
from tominpmp.motion.trajectory import Trajectory

# Largest files: the first holds tables up to the limits of
# :mod:`~tominpmp.files.tables`, the second messages with as many values as YAML may
# have [bytes].
MAX_BYTES, MAX_MESSAGE = 2**28, 2**26
# Ratios of velocities to the changes of positions for which the unit of the times is in
# doubt: milliseconds have 1e3, microseconds 1e6, and velocities in degrees 57.
MISMATCH = 300.0, 1e7
# Beginning of the message on other endings.
NOT_KEPT = "motions are not kept as"


def export(
    trajectory: Trajectory,
    path: str | Path,
    *,
    dt: float | None = None,
    with_effort: bool = False,
    message: str | None = None,
) -> Path:
    """Write a motion as CSV, NPZ or ROS message, by the ending of the path.

    An existing file is replaced once the new one is complete.

    Args:
        trajectory: The motion.
        path: File to write, ending in ``.csv``, ``.npz``, ``.yaml``, ``.json`` or
            ``.mcap``.
        dt: Time between rows [s], with the end of the motion as the last row in any
            case; None writes the nodes. At a node where acceleration or torque jump,
            the row holds the value just after it.
        with_effort: Whether ROS messages contain the torques: controllers that do not
            command efforts refuse such messages. CSV and NPZ always contain them.
        message: Type of the ROS message: "JointTrajectory" (the default), the goal of
            the action "FollowJointTrajectory", or MoveIt's "RobotTrajectory".

    Returns:
        The path.

    Raises:
        ProblemError: If the ending or the message is unknown, dt is not a positive
            number, an option does not apply to the ending, or the motion contains
            values that are not finite.
        ScenarioError: If the file cannot be written.
        MissingDependency: If a package for bags is not installed.
    """
    instance(trajectory, Trajectory, "trajectory")
    write = FORMATS[checked_ending(path, FORMATS, NOT_KEPT)].write
    check_options(path, with_effort, message)
    samples = file_samples(trajectory, path, dt, with_effort=with_effort)
    for key, fault in _not_finite(samples):
        raise ProblemError(f"{key} of the motion {fault}", key)
    which = [message or ros.MESSAGE] if is_message(path) else []
    return write_file(path, lambda file: write(samples, file, *which))


def is_message(path: str | Path) -> bool:
    """Whether the ending of a file is that of ROS messages."""
    return Path(path).suffix.lower() in OF_MESSAGES


def file_samples(
    trajectory: Trajectory,
    path: str | Path,
    dt: float | None,
    *,
    with_effort: bool = False,
) -> Samples:
    """Samples that a file of a motion contains; quantities that it omits are NaN.

    The format follows from the ending of the path; ``dt`` is the time between rows [s],
    None for the nodes.

    Raises:
        ProblemError: If dt is not a positive number.
    """
    if is_message(path):
        return ros.message_samples(trajectory, dt, with_effort)
    if dt is not None:
        return trajectory.sample(dt)
    t, a = trajectory.t, trajectory(trajectory.t).a
    q, v, u, ends = trajectory.q, trajectory.v, trajectory.u, trajectory.segment_ends
    return Samples(trajectory.joint_names, t, q, v, a, u, segment_ends=ends)


def check_options(path: str | Path, with_effort: bool, message: str | None) -> None:
    """Check that options of :func:`export` are known, and apply to the ending.

    Raises:
        ProblemError: If an option is unknown or does not apply.
    """
    flag(with_effort, "with_effort")
    choice(message, (None, *ros.MESSAGES), "message")
    for name, value in (("with_effort", with_effort), ("message", message)):
        if value and not is_message(path):
            known = ", ".join(OF_MESSAGES)
            fault = f"{name} is for ROS messages ({known}), not for {path}"
            raise ProblemError(fault, name)


def _not_finite(samples: Samples) -> Iterator[tuple[str, str]]:
    """Quantities with values that are not finite, and the first value, in a clause."""
    for key in ("t", *tables.known_quantities(samples)):
        values = getattr(samples, key)
        for row, *joint in np.argwhere(~np.isfinite(values)).tolist()[:1]:
            value, place = values[(row, *joint)], f"in row {row + 1}"
            for i in joint:  # a time has none
                name = brief(samples.joint_names[i])
                place += f", at {samples.t[row]:.6g} s, joint {name}"
            yield key, f"is {value} {place}: expected a finite number"


def load_motion(
    path: str | Path, *, interpolation: Interpolation | None = None
) -> Samples:
    """Read a motion that :func:`export` or another program wrote in one of its formats.

    Positions are required; velocities, accelerations and torques are optional.

    Args:
        path: CSV, NPZ, YAML, JSON or MCAP file, by its ending.
        interpolation: How the samples are interpolated between their times, see
            :class:`~tominpmp.motion.samples.Samples`; None takes "controller" for ROS
            messages and "auto" for other files.

    Returns:
        The samples, their times increasing; a quantity that the file lacks is NaN.

    Raises:
        ProblemError: If the ending or the interpolation is unknown.
        ScenarioError: If the file cannot be read or is wrong: the message names the
            place.
        MissingDependency: If the package for bags is not installed.
    """
    return read_motion(path, interpolation)[0]


def read_motion(
    path: str | Path, interpolation: Interpolation | None = None
) -> tuple[Samples, Any]:
    """Read a motion as :func:`load_motion` does, with the message that holds it.

    Returns:
        The samples; and the ROS message as plain values, None for other files.

    Raises:
        TominpmpError: As raised by :func:`load_motion`.
    """
    read = FORMATS[checked_ending(path, FORMATS, NOT_KEPT)].read
    choice(interpolation, (*INTERPOLATIONS, None), "interpolation")
    path, held = checked_path(path), is_message(path)
    try:
        content = read(read_bytes(path, MAX_MESSAGE if held else MAX_BYTES), path)
        whole = ros.read_message(Field(content, path)) if held else content
        samples = _checked(whole, Field(None, path))
    except ProblemError as error:  # the content is not valid samples
        raise ScenarioError(f"{path}: {error}", path, error.field) from error
    if interpolation is not None:
        samples = replace(samples, interpolation=interpolation)
    return samples, content if held else None


@np.errstate(all="ignore")  # numbers of a caller's file may overflow
def _checked(samples: Samples, file: Field) -> Samples:
    """Check the values of samples from a file; names and shapes are checked already."""
    for key, fault in _not_finite(samples):
        file.get(key).fail(fault)
    if not samples.t.size:
        file.fail("holds 0 rows, expected 1 or more")
    back = np.flatnonzero(np.diff(samples.t) < TINY)
    if back.size:
        k = int(back[0])
        file.get("time").fail(
            f"must increase, but is {samples.t[k]} s in row {k + 1} and "
            f"{samples.t[k + 1]} s in the next"
        )
    way = np.abs(np.diff(samples.q, axis=0)).sum()
    stated = (np.abs(samples.v[1:]) * np.diff(samples.t)[:, None]).sum()
    if stated > 1.0 and MISMATCH[0] < stated / way < MISMATCH[1]:
        warn_caller(
            f"{file.path}: its velocities are {stated / way:.0f} times as fast as its "
            "positions change: are its times in seconds?"
        )
    return samples


class Format(NamedTuple):
    """A format of motion files.

    Attributes:
        write: Writes samples to an open file.
        read: Makes samples of the content of a file and its path; or a message as plain
            values.
        message: Whether the files hold messages of ROS.
    """

    write: Callable[..., None]
    read: Callable[[bytes, Path], Any]
    message: bool = False


FORMATS: dict[str, Format] = {
    ".csv": Format(tables.write_csv, tables.read_csv),
    ".npz": Format(tables.write_npz, tables.read_npz),
    ".yaml": Format(ros.write_yaml, parse_yaml, message=True),
    ".yml": Format(ros.write_yaml, parse_yaml, message=True),
    ".json": Format(ros.write_json, ros.parse_json, message=True),
    ".mcap": Format(ros.write_bag, ros.parse_bag, message=True),
}
# Endings of files with messages.
OF_MESSAGES = tuple(ending for ending, kind in FORMATS.items() if kind.message)
