"""Motions that are wrong in one thing: the judges say of them what is stored.

All two hundred are judged by ``python -m benchmarks.spoilt``.
"""

from __future__ import annotations

import pytest

from benchmarks import spoilt

# Faults that are known: what does not find what it should.
KNOWN = spoilt.read()


@pytest.mark.parametrize("make", list(spoilt.quick()), ids=spoilt.label)
def test_judges_say_of_a_spoilt_motion_what_is_stored(make: spoilt.Maker) -> None:
    motion = make()
    found = spoilt.differences(spoilt.verdicts(motion), KNOWN.get(motion.name))
    assert not found, f"if that is meant: {spoilt.ACCEPT}"


def test_there_are_two_hundred_spoilt_motions_with_names_of_their_own() -> None:
    assert len(list(spoilt.everything())) >= 200
    assert len(KNOWN) == len(list(spoilt.everything()))


def test_verify_and_the_proof_miss_nothing() -> None:
    """What is known to be missed is of files, and of motions that are slow only."""
    missed = {name: row["missed"].split() for name, row in KNOWN.items()}
    for judge in ("verify", "prove"):
        assert [name for name, judges in missed.items() if judge in judges] == []


@pytest.mark.parametrize("control", ["constant", "collocation"])
def test_motions_that_are_not_spoilt_pass(control: str) -> None:
    for right in (spoilt.free(control), spoilt.fast(control)):
        row = spoilt.verdicts(spoilt.Spoilt(control, "nothing", 0.0, right, ()))
        assert {row[judge] for judge in spoilt.JUDGES} == {spoilt.OK}


def test_a_verdict_that_is_another_is_told_of() -> None:
    row = {name: "ok" for name in (*spoilt.JUDGES, "missed")} | {"excess": "0.1"}
    assert spoilt.differences(row, row) == []
    assert spoilt.differences(row, None) == ["is not stored"]
    other = row | {"verify": "goal", "excess": "0.2"}
    assert spoilt.differences(row, other) == [
        "verify: goal -> ok",
        "excess: 0.2 -> 0.1",
    ]
