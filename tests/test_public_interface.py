"""What users see of the library is what is stored, until a change is accepted."""

from __future__ import annotations

from pathlib import Path
from unittest import mock

import pytest

from tests import public_interface as seen


@pytest.mark.parametrize("part", seen.PARTS)
def test_what_users_see_is_as_stored(part: str) -> None:
    lines = seen.difference(part)
    if lines:
        pytest.fail(
            f"The {part} that users see have changed:\n{lines}\n\n"
            f"If that is meant, and the changelog says so: {seen.ACCEPT}",
            pytrace=False,
        )


@pytest.mark.parametrize(
    ("before", "after", "line"),
    [
        ("old\nkept\n", "kept", "-old"),
        ("kept\n", "kept\nnew", "+new"),
        ("a(b=1)\n", "a(b=2)", "+a(b=2)"),
    ],
)
def test_a_difference_is_shown_line_by_line(
    before: str, after: str, line: str, tmp_path: Path
) -> None:
    (tmp_path / "names.txt").write_text(before)
    with (
        mock.patch.object(seen, "STORED", tmp_path),
        mock.patch.dict(seen.PARTS, names=lambda: after),
    ):
        lines = seen.difference("names").splitlines()
    assert line in lines


def test_a_difference_is_accepted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(seen, "STORED", tmp_path)
    monkeypatch.setattr(seen, "PARTS", {"names": lambda: "plan()"})
    monkeypatch.setattr("sys.argv", ["public_interface"])
    assert seen.main() == 1
    assert "+plan()" in capsys.readouterr().out
    monkeypatch.setattr("sys.argv", ["public_interface", "--accept"])
    assert seen.main() == 0
    assert (tmp_path / "names.txt").read_text() == "plan()\n"
    monkeypatch.setattr("sys.argv", ["public_interface"])
    assert seen.main() == 0
