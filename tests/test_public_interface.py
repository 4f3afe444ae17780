"""The public interface equals its stored texts, until a change is accepted."""

from __future__ import annotations

from pathlib import Path
from unittest import mock

import pytest

from tests import public_interface


@pytest.mark.parametrize("part", public_interface.PARTS)
def test_public_interface_equals_its_stored_texts(part: str) -> None:
    lines = public_interface.difference(part)
    if lines:
        pytest.fail(
            f"The public {part} have changed:\n{lines}\n\n"
            "If the change is intended, and in the changelog: "
            f"{public_interface.ACCEPT}",
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
def test_difference_is_shown_line_by_line(
    before: str, after: str, line: str, tmp_path: Path
) -> None:
    (tmp_path / "names.txt").write_text(before)
    with (
        mock.patch.object(public_interface, "STORED", tmp_path),
        mock.patch.dict(public_interface.PARTS, names=lambda: after),
    ):
        lines = public_interface.difference("names").splitlines()
    assert line in lines


def test_option_accept_stores_a_difference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(public_interface, "STORED", tmp_path)
    monkeypatch.setattr(public_interface, "PARTS", {"names": lambda: "plan()"})
    monkeypatch.setattr("sys.argv", ["public_interface"])
    assert public_interface.main() == 1
    assert "+plan()" in capsys.readouterr().out
    monkeypatch.setattr("sys.argv", ["public_interface", "--accept"])
    assert public_interface.main() == 0
    assert (tmp_path / "names.txt").read_text() == "plan()\n"
    monkeypatch.setattr("sys.argv", ["public_interface"])
    assert public_interface.main() == 0
