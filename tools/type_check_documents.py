"""Type-check the Python that readers copy: README, the page of all names, examples.

`make check` runs it: mypy, strict, with the configuration of the project.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# The second uses every public name.
PAGES = ("README.md", "docs/reference/examples.md")
GIVEN = "from __future__ import annotations\n\n"


def readme_module(text: str) -> str:
    """The Python blocks of a document, one after the other, as one module."""
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    if not blocks:
        raise SystemExit("a page has no Python blocks")
    return GIVEN + "\n".join(blocks)


def main() -> int:
    """Check, and return what mypy returns."""
    with tempfile.TemporaryDirectory() as folder:
        modules = []
        for number, page in enumerate(PAGES):
            modules.append(Path(folder, f"blocks_{number}.py"))
            modules[-1].write_text(readme_module((ROOT / page).read_text("utf-8")))
        examples = sorted(ROOT.glob("examples/*.py"))
        command = [sys.executable, "-m", "mypy", "--strict"]
        return subprocess.call([*command, *map(str, (*modules, *examples))], cwd=ROOT)


if __name__ == "__main__":
    raise SystemExit(main())
