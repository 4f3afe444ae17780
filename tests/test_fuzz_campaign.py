"""The fuzzing campaign: a short run, and the detection of failures."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tominpmp.exceptions import ProblemError
from tools.fuzz.campaign import Tally, attempt, campaign, inputs_of, judge


def test_short_fuzzing_campaign_finds_no_failure() -> None:
    shares = {"files": 40, "arguments": 30, "signals": 1}
    assert not campaign(shares, seed=1, out=None)


# The sample robots of the readers are incomplete and cause warnings.
@pytest.mark.filterwarnings("ignore::tominpmp.exceptions.TominpmpWarning")
def test_fuzzed_inputs_are_determined_by_seed_and_number(tmp_path: Path) -> None:
    for family in ("files", "arguments", "options", "signals"):
        inputs = inputs_of(family, tmp_path)
        for number in range(5):
            one, other = (
                inputs.run(np.random.default_rng([3, number]))[0] for _ in range(2)
            )
            assert one == other


def foreign() -> None:
    raise ValueError("not of the library")


def refused() -> None:
    raise ProblemError("margin is -1, expected 0 or more", "margin")


def silent() -> None:
    raise ProblemError(" ")


def endless() -> None:
    while True:
        pass


def test_judge_distinguishes_success_rejection_and_failure() -> None:
    assert judge(lambda: None, 5.0) == ("taken", "")
    assert judge(refused, 5.0) == ("refused", "")
    for call, word in (
        (foreign, "ValueError"),
        (silent, "message"),
        (endless, "takes more than"),
    ):
        outcome, why = judge(call, 0.5)
        assert outcome == "failed"
        assert word in why


def test_input_that_kills_the_process_is_a_failure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import subprocess
    import sys

    opened = subprocess.Popen
    script = (
        'import os;print(\'{"number": 4, "label": "deadly"}\', flush=True); os._exit(3)'
    )
    monkeypatch.setattr(
        subprocess,
        "Popen",
        lambda _, **kw: opened([sys.executable, "-c", script], **kw),
    )
    tally = Tally(Counter(), [])
    assert attempt("files", 0, 4, 9, tally) == 5
    (failure,) = tally.failures
    assert failure["label"] == "deadly"
    assert "ended the process (3)" in failure["why"]
