"""All limits of a motion as rows, of one segment after the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tominpmp.certificate.active_limits import Motion
from tominpmp.certificate.bulges import bulges
from tominpmp.certificate.clearances import clearances
from tominpmp.certificate.limit_rows import LimitRows
from tominpmp.certificate.state_limits import constraints
from tominpmp.certificate.stays import arrivals


def limits_of(motion: Motion, far: float, near: bool = True) -> list[LimitRows]:
    """Rows of all limits, of one segment after the other.

    Args:
        motion: The motion.
        far: Torques with more room than this to both limits are left out.
        near: Whether distances are looked at: for them all meshes are cut.
    """
    found: list[LimitRows] = arrivals(motion)
    pairs = asked = 0
    for part in motion.segments:
        for rows in part.own(part.efforts()):
            held = np.minimum(-rows.lower, rows.upper) < far
            whole = rows.kind != "effort" or not np.isfinite(far)
            found.append(rows if whole else rows.kept(np.flatnonzero(held)))
        found += part.own([*part.declared(), *bulges(part)])
        # Those of all segments are counted through.
        found += [
            replace(rows, subject=rows.subject + pairs)
            for rows in part.own(clearances(part) if near else [])
        ]
        found += [
            replace(rows, subject=rows.subject + asked)
            for rows in part.own(constraints(part))
        ]
        pairs += len(part.task.problem.checker.pairs) if near else 0
        asked += len(part.task.problem.constraints)
    return found
