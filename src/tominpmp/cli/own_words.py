"""Hints of the library in the words of the command line: flags for arguments."""

from __future__ import annotations

import re

# Arguments that take values by joint name, and are flags that do.
_BY_JOINT = re.compile(
    r"\b(effort|velocity|position_lower|position_upper|damping|armature|friction)"
    r"=\{([^{}]*)\}"
)
_WORDS = {
    "self_collision=False": "--no-self-collision",
    "limits='datasheet'": "--limits datasheet",
    "package_dirs": "--package-dir",
}


def in_own_words(message: str) -> str:
    """A message with flags in the place of arguments of Python.

    What is said of a scenario file stays as it is: there they are keys.
    """
    if ".toml:" in message:
        return message

    def flag(found: re.Match[str]) -> str:
        values = re.sub(r"'([^']*)':\s*", r"\1=", found[2]).replace(", ", ",")
        return f"--{found[1].replace('_', '-')} {values}"

    message = _BY_JOINT.sub(flag, message)
    for words, own in _WORDS.items():
        message = re.sub(rf"(?<![\w.]){re.escape(words)}(?!\w)", own, message)
    return message
