"""Reports as JSON."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Turn records, arrays and paths into types that JSON knows.

    Infinite numbers, and those that are none, are None. Of a record, fields that are
    not shown by ``repr`` are left out: they are too long for a report.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        items = (item.name for item in dataclasses.fields(value) if item.repr)
        return {name: plain(getattr(value, name)) for name in items}
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value if isinstance(value, str | int | None) else str(value)


def json_text(data: Any) -> str:
    """Write data as JSON for people and programs."""
    return json.dumps(plain(data), indent=2, allow_nan=False)
