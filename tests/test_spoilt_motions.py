"""Motions with a single fault: the verdicts of all judges equal the stored verdicts.

``python -m benchmarks.spoilt`` checks all two hundred motions.
"""

from __future__ import annotations

import pytest

from benchmarks import spoilt

# They also name the judges that are known to miss a fault.
STORED_VERDICTS = spoilt.read()


@pytest.mark.parametrize("make", list(spoilt.quick()), ids=spoilt.label)
def test_verdicts_on_a_spoilt_motion_equal_the_stored_ones(make: spoilt.Maker) -> None:
    motion = make()
    found = spoilt.differences(
        spoilt.verdicts(motion), STORED_VERDICTS.get(motion.name)
    )
    assert not found, f"if the change is intended: {spoilt.ACCEPT}"


def test_two_hundred_spoilt_motions_have_unique_names() -> None:
    assert len(list(spoilt.everything())) >= 200
    assert len(STORED_VERDICTS) == len(list(spoilt.everything()))


def test_verification_and_clearance_proof_miss_no_fault() -> None:
    """Known misses concern exported files, and motions that are merely slow."""
    missed = {name: row["missed"].split() for name, row in STORED_VERDICTS.items()}
    for judge in ("verify", "prove"):
        assert [name for name, judges in missed.items() if judge in judges] == []


@pytest.mark.parametrize("control", ["constant", "collocation"])
def test_correct_motions_pass_all_judges(control: str) -> None:
    for right in (spoilt.free(control), spoilt.fast(control)):
        row = spoilt.verdicts(spoilt.Spoilt(control, "nothing", 0.0, right, ()))
        assert {row[judge] for judge in spoilt.JUDGES} == {spoilt.OK}


def test_changed_verdicts_are_reported() -> None:
    row = {name: "ok" for name in (*spoilt.JUDGES, "missed")} | {"excess": "0.1"}
    assert spoilt.differences(row, row) == []
    assert spoilt.differences(row, None) == ["is not stored"]
    other = row | {"verify": "goal", "excess": "0.2"}
    assert spoilt.differences(row, other) == [
        "verify: goal -> ok",
        "excess: 0.2 -> 0.1",
    ]
