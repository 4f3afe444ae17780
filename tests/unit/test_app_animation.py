"""The live page's animation: the instant of the motion that it shows."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import MagicMock

import pytest

from tominpmp.app.page import REST, Readout

T = 2.0
SHOWN = cast(Any, SimpleNamespace(T=T))


def new_readout() -> Any:
    controller: Any = SimpleNamespace(outcome=None, busy=True, shown=None)
    readout: Any = Readout(MagicMock(), controller)
    readout._playing.value, readout._speed.value = True, "real time"
    readout._slider = SimpleNamespace(value=0.0, max=T, visible=False)
    return readout


def test_animation_rests_at_both_ends_of_the_motion() -> None:
    readout = new_readout()
    assert [readout.time(SHOWN, 0.4 * REST) for _ in range(3)][:2] == [0.0, 0.0]
    readout.time(SHOWN, T - 0.2 * REST)
    assert readout.time(SHOWN, 0.5 * REST) == T
    assert readout.time(SHOWN, REST) == 0.0


def test_changed_playback_speed_continues_from_the_shown_instant() -> None:
    readout = new_readout()
    readout.time(SHOWN, REST)
    before = readout.time(SHOWN, 1.0)
    readout._speed.value = "a tenth"
    assert readout.time(SHOWN, 0.1) == pytest.approx(before + 0.01)


def test_paused_animation_continues_from_the_instant_of_the_slider() -> None:
    readout = new_readout()
    readout.time(SHOWN, REST + 1.0)
    readout._playing.value = False
    readout._pause()
    assert readout.time(SHOWN, 100.0) == readout._slider.value == 1.0
    readout._slider.value = 0.3
    assert readout.time(SHOWN, 5.0) == 0.3
    readout._playing.value = True
    readout._pause()
    assert readout.time(SHOWN, 0.1) == pytest.approx(0.4)
