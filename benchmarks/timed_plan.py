"""A plan with its processor time, as columns of a table."""

from __future__ import annotations

import math
import time
from typing import Any

import tominpmp as tm


def timed_plan(problem: tm.Problem, **options: Any) -> dict[str, Any]:
    """Plan a problem; status, success, T [s] and processor time [s]."""
    begin = time.process_time()
    solution = tm.plan(problem, tm.Options(**options))
    return {
        "status": solution.status.name,
        "success": solution.success,
        "T": solution.T if solution.success else math.nan,
        "seconds": time.process_time() - begin,
    }
