"""Playback pages in the documentation: planned when it is built, shown in frames.

A line ``<!-- playback: NAME -->`` in a page becomes the still of this motion, which
plays when it is clicked, or, with ``NAME when seen``, as soon as it is visible; a line
``<!-- playback: gallery -->`` becomes one section for each motion of the gallery. A
page of stills opens at once, where ten animated pages would keep a weak machine busy
for minutes. Motions are planned once and kept in ``build/gallery`` until their sources
change.
"""

from __future__ import annotations

import importlib
import logging
import re
import shutil
import sys
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[1]
sys.path.insert(0, str(DOCS.parent))

PLACE = re.compile(r"^<!-- playback: (\w+)( when seen)? -->$", re.MULTILINE)
FOLDER = DOCS / "build" / "gallery"


def frame(name: str, title: str, root: str, *, when_seen: bool = False) -> str:
    """HTML of a still that ``static/own.js`` makes play.

    Without scripts it is a link to the playback page.

    Args:
        name: Name of the motion.
        title: Title of the motion.
        root: Path from the page to the root of the site, empty or ending in a slash.
        when_seen: Whether it plays as soon as it is visible, instead of when clicked.
    """
    where, when = f"{root}playback/{name}", "seen" if when_seen else "clicked"
    return (
        "```{raw} html\n"
        f'<a class="playback" href="{where}.html" data-play="{when}" title="{title}">'
        f'<img src="{where}.png" alt="{title}" loading="lazy">'
        "<span>\N{BLACK RIGHT-POINTING TRIANGLE} Play</span></a>\n"
        "```"
    )


def copy_stills(names: list[str], folder: Path) -> None:
    """Copy the stills of motions into the folder of their pages.

    Raises:
        FileNotFoundError: If a still is missing (``tools/stills.py`` takes it).
    """
    for name in names:
        shutil.copyfile(DOCS / "figures" / f"{name}.png", folder / f"{name}.png")


def setup(app: Any) -> dict[str, Any]:
    """Make the playback pages before pages are read."""
    gallery: Any = importlib.import_module("tools.gallery")

    def make(app: Any) -> None:
        if app.builder.format != "html":
            return
        logging.getLogger("tominpmp").setLevel(logging.WARNING)
        gallery.make_pages(FOLDER)
        pages = FOLDER / "extra" / "playback"
        copy_stills([item.name for item in gallery.ITEMS], pages)
        app.config.html_extra_path = [str(FOLDER / "extra")]

    def read(app: Any, name: str, source: list[str]) -> None:
        root = "../" * name.count("/")

        titles = {item.name: item.title for item in gallery.ITEMS}

        def shown(found: re.Match[str]) -> str:
            if found[1] != "gallery":
                title = titles[found[1]]
                return frame(found[1], title, root, when_seen=bool(found[2]))
            parts = [
                f"## {item.title}\n\n{item.text}\n\n"
                + frame(item.name, item.title, root)
                for item in gallery.ITEMS
            ]
            return "\n\n".join(parts)

        source[0] = PLACE.sub(shown, source[0])

    app.connect("builder-inited", make)
    app.connect("source-read", read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
