"""Pages with many motions show stills, and play one motion at a time."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs" / "extensions"))
sys.path.insert(1, str(ROOT))
import playback_pages  # noqa: E402
from test_browser import CHROMIUM, Browser  # noqa: E402

from tools import gallery, stills  # noqa: E402

NAMES = [item.name for item in gallery.ITEMS]


@pytest.mark.parametrize("name", NAMES)
def test_every_motion_of_the_gallery_has_a_still(name: str) -> None:
    assert name in stills.STILLS
    assert (ROOT / "docs" / "figures" / f"{name}.png").is_file()


def test_missing_still_is_an_error(tmp_path: Path) -> None:
    playback_pages.copy_stills(NAMES, tmp_path)
    assert len(list(tmp_path.iterdir())) == len(NAMES)
    with pytest.raises(FileNotFoundError, match="no_such"):
        playback_pages.copy_stills(["no_such"], tmp_path)


# Waits until the frame that is being loaded has replaced its still.
LOADED = """new Promise((done) => {
  const look = () => document.querySelector('.waiting') ? setTimeout(look, 5) : done();
  look();
})"""


def html(name: str, *, when_seen: bool = False) -> str:
    """HTML of the still of a motion in a page."""
    text = playback_pages.frame(name, name, "", when_seen=when_seen)
    return text.removeprefix("```{raw} html\n").removesuffix("```")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    found = Browser(tmp_path_factory.mktemp("home"))
    yield found
    found.close()


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
def test_one_motion_plays_at_a_time(browser: Browser, tmp_path: Path) -> None:
    static = ROOT / "docs" / "static"
    (tmp_path / "playback").mkdir()
    for name in ("first", "second"):
        (tmp_path / "playback" / f"{name}.html").write_text("<p>It moves.</p>")
    page = tmp_path / "page.html"
    page.write_text(
        f"<style>{(static / 'own.css').read_text('utf-8')}</style>"
        f"{html('first')}{html('second')}"
        f"<script>{(static / 'own.js').read_text('utf-8')}</script>"
    )
    opened = browser.open(page.as_uri())

    def playing() -> list[str]:
        frames = "Array.from(document.querySelectorAll('iframe'), (f) => f.title)"
        return list(opened.evaluate(frames))

    assert playing() == []
    click = "document.querySelector('a[title={}]').click()"
    opened.evaluate(click.format("first"))
    assert playing() == ["first"]
    opened.evaluate(click.format("second"))
    assert playing() == ["second"]
    # The first motion is a still again, in its place, and can be clicked again.
    shown = "document.querySelectorAll('.playback:not(.waiting)')"
    opened.evaluate(LOADED)
    assert opened.evaluate(f"Array.from({shown}, (e) => e.title)") == [
        "first",
        "second",
    ]
    # The still is visible until the frame is loaded.
    kinds = f"Array.from({shown}, (e) => e.tagName)"
    assert opened.evaluate(f"{click.format('first')}; {kinds}") == ["A", "A"]
    assert playing() == ["first"]
    opened.evaluate(LOADED)
    assert opened.evaluate(kinds) == ["IFRAME", "A"]
    assert opened.evaluate("document.querySelector('iframe').offsetHeight") > 100

    page.write_text(page.read_text().replace('"clicked"', '"seen"', 1))
    opened = browser.open(page.as_uri())
    opened.frames(10)
    assert playing() == ["first"]
