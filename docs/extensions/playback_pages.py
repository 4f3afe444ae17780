"""Playback pages in the documentation: planned when it is built, shown in frames.

A line ``<!-- playback: NAME -->`` in a page becomes a frame with the motion of that
name, ``<!-- playback: gallery -->`` one section for each of the gallery. Motions are
planned once and kept in ``build/playback`` until what they are made of changes.
"""

from __future__ import annotations

import importlib
import logging
import re
import sys
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[1]
sys.path.insert(0, str(DOCS.parent))

PLACE = re.compile(r"^<!-- playback: (\w+) -->$", re.MULTILINE)
FOLDER = DOCS / "build" / "gallery"


def frame(name: str, height: int) -> str:
    """HTML that shows a page when it comes into view."""
    return (
        "```{raw} html\n"
        f'<iframe class="playback" src="{{root}}playback/{name}.html" loading="lazy"'
        f' style="height: {height}px" title="{name}"></iframe>\n'
        "```"
    )


def setup(app: Any) -> dict[str, Any]:
    """Make the pages before anything is read."""
    gallery: Any = importlib.import_module("tools.gallery")

    def make(app: Any) -> None:
        if app.builder.format != "html":
            return
        logging.getLogger("tominpmp").setLevel(logging.WARNING)
        gallery.make_pages(FOLDER)
        app.config.html_extra_path = [str(FOLDER / "extra")]

    def read(app: Any, name: str, source: list[str]) -> None:
        root = "../" * name.count("/")

        def shown(found: re.Match[str]) -> str:
            if found[1] != "gallery":
                return frame(found[1], 460).replace("{root}", root)
            parts = [
                f"## {item.title}\n\n{item.text}\n\n{frame(item.name, 460)}"
                for item in gallery.ITEMS
            ]
            return "\n\n".join(parts).replace("{root}", root)

        source[0] = PLACE.sub(shown, source[0])

    app.connect("builder-inited", make)
    app.connect("source-read", read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
