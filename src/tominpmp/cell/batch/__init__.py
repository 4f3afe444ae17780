"""Batches: many plans, on several processes or a cluster, kept as a dataset."""

from __future__ import annotations

from tominpmp.cell.batch.dataset import Dataset, Outcome
from tominpmp.cell.batch.plan_many import Progress, plan_many

__all__ = ["Dataset", "Outcome", "Progress", "plan_many"]
