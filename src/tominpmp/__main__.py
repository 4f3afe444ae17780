"""``python -m tominpmp`` is the command ``tominpmp``."""

from __future__ import annotations

from tominpmp.cli import main

if __name__ == "__main__":
    main()
