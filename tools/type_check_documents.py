"""Type-check the Python of the README and the examples as their readers would.

`make check` runs it: mypy, strict, with the configuration of the project.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GIVEN = "from __future__ import annotations\n\n"


def readme_module(text: str) -> str:
    """The Python blocks of a document, one after the other, as one module."""
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    if not blocks:
        raise SystemExit("README.md has no Python blocks")
    return GIVEN + "\n".join(blocks)


def main() -> int:
    """Check, and return what mypy returns."""
    with tempfile.TemporaryDirectory() as folder:
        module = Path(folder, "readme_blocks.py")
        module.write_text(readme_module((ROOT / "README.md").read_text("utf-8")))
        examples = sorted(ROOT.glob("examples/*.py"))
        command = [sys.executable, "-m", "mypy", "--strict", str(module)]
        return subprocess.call([*command, *map(str, examples)], cwd=ROOT)


if __name__ == "__main__":
    raise SystemExit(main())
