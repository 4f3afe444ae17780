"""The left side of the page: T, bound, bars, curves, what holds the motion back."""

from __future__ import annotations

from typing import Any

from tominpmp.app import pictures
from tominpmp.app.controller import Controller
from tominpmp.app.outcome import Outcome, Shown

SPEEDS = {"real time": 1.0, "half": 0.5, "a quarter": 0.25, "a tenth": 0.1}


class Readout:
    """What was found.

    Args:
        server: Viser's server.
    """

    def __init__(self, server: Any) -> None:
        gui = server.gui
        self._panel = gui.add_panel()
        with self._panel.add_tab("Motion"):
            self._headline = gui.add_html(pictures.headline(None, True))
            self._notice = gui.add_html("")
            self._playing = gui.add_checkbox("Play", True)
            self._speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value="half")
            self._slider = gui.add_slider("Time", 0.0, 1.0, 0.005, 0.0)
            self._slider.visible = False
            self._bars = gui.add_html("")
            with gui.add_folder("Over time"):
                self._curves = gui.add_html("")
            with gui.add_folder("What holds it back"):
                self._held = gui.add_html("")
        self._panel.dock_left()
        self._panel.set_width(340)
        self._playing.on_update(lambda _: self._pause())
        self._share = 0.0
        self._outcome: Outcome | None = None

    def _pause(self) -> None:
        self._slider.visible = not self._playing.value
        if not self._playing.value:
            self._slider.value = round(self._share, 3)

    def time(self, shown: Shown, since: float, rest: float) -> float:
        """The instant to show [s].

        Args:
            shown: The motion.
            since: Time since it began to play [s].
            rest: How long it rests at either end [s].
        """
        if not self._playing.value:
            return float(self._slider.value) * shown.T
        scaled = since * SPEEDS[self._speed.value]
        at = scaled % (shown.T + 2.0 * rest) - rest
        now = min(max(at, 0.0), shown.T)
        self._share = now / shown.T if shown.T > 0.0 else 0.0
        return now

    def show(self, outcome: Outcome, busy: bool, goes_on: bool) -> None:
        """Show an outcome.

        Args:
            outcome: The outcome.
            busy: Whether planning goes on.
            goes_on: Whether there is a motion before it, which goes on playing.
        """
        self._outcome = outcome
        self._headline.content = pictures.headline(outcome, busy, goes_on)
        if outcome.shown is None:
            return
        self._curves.content = pictures.curves(outcome.shown)
        held, told = outcome.shown.held, outcome.shown.optimality
        self._held.content = pictures.held_back(held, told)

    def busy(self, controller: Controller) -> None:
        """Say that planning goes on."""
        if self._outcome is not None and self._outcome.shown is not None:
            self._headline.content = pictures.headline(self._outcome, controller.busy)

    def show_bars(self, shown: Shown, time: float) -> None:
        """Show speeds and torques at a time [s]."""
        content = pictures.bars(shown, time)
        if content != self._bars.content:
            self._bars.content = content

    def tell(self, text: str, *, bad: bool = False) -> None:
        """Show a sentence; nothing takes it away."""
        content = pictures.notice(text, bad=bad)
        if content != self._notice.content:
            self._notice.content = content
