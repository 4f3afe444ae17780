"""Batches on a local cluster of Dask, one worker of which is killed."""

from __future__ import annotations

import os
import signal
import warnings
from pathlib import Path

import pytest
from batch_samples import QUICK, problems

import tominpmp as tm

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # third parties, on their first import
    distributed = pytest.importorskip("distributed")
    joblib = pytest.importorskip("joblib")

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]


def test_batch_is_completed_after_a_worker_is_killed(tmp_path: Path) -> None:
    given = problems(tmp_path, 40)
    cluster = distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        local_directory=str(tmp_path),
    )
    with cluster, distributed.Client(cluster) as client:
        numbers = list(client.run(os.getpid).values())
        with joblib.parallel_config("dask"):
            stream = tm.plan_many(given, results=tmp_path / "results", **QUICK)
        found = [next(stream) for _ in range(4)]
        os.kill(numbers[0], signal.SIGKILL)
        found += stream
    assert [outcome.index for outcome in found] == list(range(40))
    assert all(outcome.success for outcome in found)
    alone = list(tm.plan_many(given[:4], workers=1, **QUICK))
    for one, other in zip(alone, found[:4], strict=True):
        assert one.solution is not None and other.solution is not None
        assert one.solution.trajectory == other.solution.trajectory
    assert len(tm.Dataset(tmp_path / "results")) == 40
