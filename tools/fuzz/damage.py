"""Files that are damaged, swapped or hostile, for every reader."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import tominpmp as tm
from tests.test_fuzz_readers import WORDS, Reader, make_readers

# Words inserted anywhere in a text: signs of the formats, and odd numbers.
SIGNS = (b"[", b"]", b"{", b"}", b"<", b">", b"&", b"*", b":", b",", b'"', b"'", b"\n")


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """A version of a file that is cut, overwritten, shuffled, or has odd words."""
    for _ in range(int(rng.integers(1, 4))):
        content = _once(content, rng)
    return content


def _once(content: bytes, rng: np.random.Generator) -> bytes:
    size = len(content)
    if size < 4:
        return content + b"\0" * 4
    a, b, c = np.sort(rng.integers(size + 1, size=3)).tolist()
    kind = int(rng.integers(7))
    if kind == 0:
        return content[:a]
    if kind == 1:
        spoilt = bytearray(content)
        for place in rng.integers(size, size=int(rng.integers(1, 4))):
            spoilt[place] = int(rng.integers(256))
        return bytes(spoilt)
    if kind == 2:
        return content[:a] + content[b:c] + content[a:b] + content[c:]
    if kind == 3:
        return content[:a] + content[a:b] * int(rng.choice([0, 2, 30])) + content[b:]
    if kind == 4:
        return content[:a] + SIGNS[rng.integers(len(SIGNS))] + content[a:]
    if kind == 5:
        # One bit, as disks and networks do.
        spoilt = bytearray(content)
        spoilt[a % size] ^= 1 << int(rng.integers(8))
        return bytes(spoilt)
    words = [m.span() for m in re.finditer(rb"[-+.\w]+", content)]
    begin, end = words[rng.integers(len(words))] if words else (a, b)
    return content[:begin] + WORDS[rng.integers(len(WORDS))] + content[end:]


class Damage:
    """Damaged files, by number."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.table: dict[str, Reader] = make_readers(folder, tm.load_robot("planar3r"))
        self.names = sorted(self.table)

    def run(self, rng: np.random.Generator) -> tuple[str, Callable[[], Any]]:
        """Choose a file and a reader.

        Returns:
            What it is, and the call that reads it.
        """
        name = self.names[rng.integers(len(self.names))]
        reader = self.table[name]
        source = name
        if rng.random() < 0.1:
            source = self.names[rng.integers(len(self.names))]
        path = self.folder / name
        path.write_bytes(damaged(self.table[source].content, rng))
        return f"{name} from {source}", lambda: reader.read(path)
