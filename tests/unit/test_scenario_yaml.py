"""The YAML reader: scalars, hostile and damaged files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from tominpmp.description import yaml_reader
from tominpmp.description.paths import read_bytes
from tominpmp.description.yaml_reader import parse_yaml, read_yaml
from tominpmp.exceptions import ScenarioError

HERE = Path("file.yaml")


@pytest.fixture(params=["C", "Python"], autouse=True)
def loader(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both parsers that PyYAML may have."""
    kind = "CSafeLoader" if request.param == "C" else "SafeLoader"
    if not hasattr(yaml, kind):
        pytest.skip("PyYAML was built without its parser in C")
    monkeypatch.setattr(yaml_reader, "_LOADER", getattr(yaml, kind))


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("1", 1),
        ("-0", 0),
        ("007", 7),
        ("0x1F", 31),
        ("0o17", 15),
        ("1.5", 1.5),
        ("1e-5", 1e-5),
        ("-1.5E+3", -1500.0),
        (".5", 0.5),
        ("5.", 5.0),
        ("-.inf", -math.inf),
        ("true", True),
        ("False", False),
        ("", None),
        ("~", None),
        ("null", None),
        # Words in YAML 1.2, though not in 1.1.
        ("on", "on"),
        ("no", "no"),
        ("1_000", "1_000"),
        ("12:30", "12:30"),
        ("0x", "0x"),
        ("1.2.3", "1.2.3"),
        ('"1"', "1"),
        ("'true'", "true"),
        ("panda_joint1", "panda_joint1"),
    ],
)
def test_scalars_follow_yaml_1_2(word: str, value: object) -> None:
    found = parse_yaml(f"key: {word}\n".encode(), HERE)["key"]
    assert found == value
    assert type(found) is type(value)


def test_nan_is_read_as_a_number() -> None:
    assert math.isnan(parse_yaml(b"[.nan]", HERE)[0])


def test_nested_values_and_empty_documents_are_read() -> None:
    text = b"a: {b: [1, {c: x}], 2: y}\nd:\n- - 1\n  - 2\n- {}\n- []\n"
    expected = {"a": {"b": [1, {"c": "x"}], "2": "y"}, "d": [[1, 2], {}, []]}
    assert parse_yaml(text, HERE) == expected
    assert parse_yaml(b"", HERE) is None


def test_aliases_are_resolved() -> None:
    text = b"a: &x {k: 1}\nb: *x\nc: &y word\nd: *y\n"
    value = parse_yaml(text, HERE)
    assert value == {"a": {"k": 1}, "b": {"k": 1}, "c": "word", "d": "word"}


def bomb(levels: int) -> bytes:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    for k in range(1, levels):
        lines.append(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]")
    return "\n".join(lines).encode()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (bomb(12), "more than .* values"),
        (b"[" * 100_000, "nest deeper|is not YAML: .* nesting"),
        (b"a: " * 10, "is not YAML"),
        (b"{a: 1", "is not YAML: .* mapping in line 1, column 1"),
        (b"\xff\xfe\xfa", "is not YAML"),
        (b"a: \x00", "is not YAML"),
        (b"a: 1\na: 2\n", "line 2: the key 'a' occurs twice"),
        (b"a: &x [*x]\n", "no anchor 'x'|is not YAML"),
        (b"a: *y\n", "no anchor 'y'|is not YAML"),
        (b"a: !!python/object/apply:os.system [echo]\n", "the tag .*python"),
        (b"a: !mine 1\n", "the tag '!mine'"),
        (b"? [1, 2]\n: 3\n", "not a single word"),
        (b"--- 1\n--- 2\n", "a second document"),
    ],
)
def test_hostile_yaml_is_rejected_with_a_short_message(
    content: bytes, words: str
) -> None:
    with pytest.raises(ScenarioError, match=words) as caught:
        parse_yaml(content, HERE)
    assert caught.value.path == HERE
    assert str(caught.value).startswith("file.yaml")
    assert len(str(caught.value)) < 600


def test_damaged_yaml_raises_only_scenario_error(rng: np.random.Generator) -> None:
    text = b"a: {b: [1, 'x', \"y\"], c: &z 1e-5}\nd:\n- - 1\n  - *z\n- |\n  text\n" * 1
    whole = np.frombuffer(text, dtype=np.uint8)
    refused = 0
    for case in range(300):
        damaged = whole.copy()
        damaged[rng.integers(len(whole), size=2)] = rng.integers(256, size=2)
        end = int(rng.integers(len(whole))) if case % 3 == 0 else len(whole)
        try:
            parse_yaml(damaged[:end].tobytes(), HERE)
        except ScenarioError:
            refused += 1
    assert 50 < refused < 300


def test_unreadable_files_are_rejected(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("x: 1")
    assert read_yaml(path) == {"x": 1}
    with pytest.raises(ScenarioError, match="more than the 3 it may have"):
        read_bytes(path, 3)
    with pytest.raises(ScenarioError, match="is a folder"):
        read_yaml(tmp_path)
    with pytest.raises(ScenarioError, match="there is no file"):
        read_yaml(tmp_path / "b.yaml")
    with pytest.raises(ScenarioError, match="not a regular file"):
        read_yaml(Path("/dev/null"))


def test_merge_keys_complete_a_table() -> None:
    """Regression: limits that a joint took from an anchor were left out."""
    text = b"a: &a {x: 1, y: 2}\nb: &b {y: 3, z: 4}\nc: {<<: *a, y: 5}\n"
    read = parse_yaml(text + b"d: {x: 6, <<: [*a, *b]}\ne: {'<<': 7}\n", HERE)
    assert read["c"] == {"x": 1, "y": 5}
    assert read["d"] == {"x": 6, "y": 2, "z": 4}
    assert read["e"] == {"<<": 7}


def test_aliases_of_a_key_are_keys() -> None:
    """Regression: an alias of ``<<`` as a key ended with an AttributeError."""
    read = parse_yaml(b"a: &a <<\n*a : {b: 1}\n", HERE)
    assert read == {"a": "<<", "<<": {"b": 1}}


@pytest.mark.parametrize("value", ["1", "[{a: 1}, 2]", "~"])
def test_merge_keys_take_tables_alone(value: str) -> None:
    with pytest.raises(ScenarioError, match=r"line 2: << merges .*, no table"):
        parse_yaml(f"a: 1\n<<: {value}\n".encode(), HERE)


def test_merged_values_count_as_if_written_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_reader, "MAX_VALUES", 60)
    rows = "".join(f"t{i}: {{<<: *a, own: {i}}}\n" for i in range(20))
    with pytest.raises(ScenarioError, match="more than 60 values"):
        parse_yaml(f"a: &a {{x: 1, y: 2, z: 3}}\n{rows}".encode(), HERE)
