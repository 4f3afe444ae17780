"""Stills and the animation of README and gallery, taken from playback pages.

    python -m tools.gallery build            # the pages
    python -m tools.stills build/extra/playback docs/figures

Needs a Chromium on the path and Pillow, which comes with matplotlib.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import tempfile
from pathlib import Path

from PIL import Image

from tominpmp.viz.shares import SPEED_COLOR, TORQUE_COLOR

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--virtual-time-budget=4000",
)
WIDTH, HEIGHT = 1080, 600
# Page and time [s] of each still.
STILLS = {
    "panda_shelf": 0.62,
    "ur5_post": 0.5,
    "two_ur5": 0.16,
    "pick_and_place": 0.5,
    "payload": 0.4,
    "spot_weld": 3.5,
    "conveyor": 0.3,
    "swinging_gate": 1.9,
    "handing_over": 0.4,
    "planar3r_obstacle": 0.5,
}
# The animation: its page, its times [s], and the duration of each picture [ms].
FILM, BEGIN, END, FRAMES, PAUSE = "payload", 0.0, 1.65, 34, 60
FILM_WIDTH, COLORS, LAST = 640, 96, 900
# Colours of the curves and of the path.
ACCENTS = (SPEED_COLOR, "#fbe3bd", TORQUE_COLOR, "#c9d8ea", "#f2a419", "#d6453a")


def picture(browser: str, page: Path, time: float, path: Path) -> None:
    """Take a picture of a page at a time of its motion."""
    with tempfile.TemporaryDirectory() as profile:
        subprocess.run(
            [
                browser,
                *FLAGS,
                f"--user-data-dir={profile}",
                f"--window-size={WIDTH},{HEIGHT}",
                f"--screenshot={path}",
                f"{page.resolve().as_uri()}#t={time}&still",
            ],
            check=True,
            capture_output=True,
        )


def reduced(path: Path, width: int) -> Image.Image:
    """A picture, smaller."""
    with Image.open(path) as image:
        height = round(image.height * width / image.width)
        return image.convert("RGB").resize((width, height), Image.Resampling.LANCZOS)


def palette(image: Image.Image, colors: int) -> Image.Image:
    """Palette of a picture that includes the colours of the curves, which are rare."""
    found = image.quantize(colors - len(ACCENTS), dither=Image.Dither.NONE)
    values = (found.getpalette() or [])[: 3 * (colors - len(ACCENTS))]
    for accent in ACCENTS:
        values += [int(accent[i : i + 2], 16) for i in (1, 3, 5)]
    chosen = Image.new("P", (1, 1))
    chosen.putpalette(values)
    return chosen


def of_few_colors(image: Image.Image, chosen: Image.Image) -> Image.Image:
    """A picture in the colours of a palette."""
    return image.quantize(palette=chosen, dither=Image.Dither.NONE)


def film(browser: str, page: Path, path: Path) -> None:
    """Write the animation."""
    with tempfile.TemporaryDirectory() as folder:
        pictures = []
        for number in range(FRAMES):
            time = BEGIN + (END - BEGIN) * number / (FRAMES - 1)
            shot = Path(folder) / f"{number}.png"
            picture(browser, page, time, shot)
            pictures.append(reduced(shot, FILM_WIDTH))
    # One palette for all pictures, so that the background does not flicker.
    chosen = palette(pictures[FRAMES // 4], COLORS)
    pictures = [of_few_colors(item, chosen) for item in pictures]
    pauses = [PAUSE] * (FRAMES - 1) + [LAST]
    first, *rest = pictures
    first.save(
        path, save_all=True, append_images=rest, duration=pauses, loop=0, optimize=True
    )


def main() -> int:
    """Take all pictures, or the named ones."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("names", nargs="*", metavar="NAME")
    arguments = parser.parse_args()
    for name in {*arguments.names} - {*STILLS, "film"}:
        parser.error(f"there is no {name!r}; there are: {', '.join(STILLS)}, film")
    browser = next((found for name in NAMES if (found := shutil.which(name))), None)
    if browser is None:
        parser.error(f"none of {', '.join(NAMES)} is on the path")
    for name, time in STILLS.items():
        if arguments.names and name not in arguments.names:
            continue
        path = arguments.out / f"{name}.png"
        picture(browser, arguments.pages / f"{name}.html", time, path)
        still = reduced(path, 900)
        of_few_colors(still, palette(still, 256)).save(path, optimize=True)
    if not arguments.names or "film" in arguments.names:
        film(browser, arguments.pages / f"{FILM}.html", arguments.out / "motion.gif")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
