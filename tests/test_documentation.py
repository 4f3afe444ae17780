"""The code blocks of the documentation run, and the names in it exist."""

from __future__ import annotations

import inspect
import re
import sys
import warnings
from dataclasses import Field, fields, is_dataclass
from pathlib import Path
from typing import Any, get_args, get_origin

import pytest

import tominpmp as tm
from tominpmp import exceptions
from tominpmp.arrays import Converted, field_type
from tominpmp.cell.tours.tour_file import load_tour
from tominpmp.description.files import robot_names

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tools"))
sys.path.insert(1, str(ROOT / "docs" / "extensions"))
import doc_blocks  # noqa: E402
import from_the_code  # noqa: E402

PAGES = doc_blocks.pages()
WITH_CODE = [page for page in PAGES[1:] if list(doc_blocks.blocks(page))]


def label(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.skipif("panda" not in robot_names(), reason="needs example-robot-data")
@pytest.mark.parametrize("page", WITH_CODE, ids=label)
def test_code_blocks_of_a_page_run(page: Path, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        # TOPP-RA has strings with invalid escape sequences.
        warnings.filterwarnings("ignore", "invalid escape sequence")
        names = doc_blocks.run_page(page, tmp_path)
    left_out = all(block.left_out(slow=False) for block in doc_blocks.blocks(page))
    assert left_out or len(names) > 2


def test_error_in_a_code_block_has_its_line_of_the_page(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A page\n\n```python\na = 1\nb = missing\n```\n", "utf-8")
    with pytest.raises(NameError, match="missing") as caught:
        doc_blocks.run_page(page, tmp_path / "folder")
    lines = [(entry.path, entry.lineno + 1) for entry in caught.traceback]
    assert (page, 5) in [(Path(str(path)), line) for path, line in lines]


FENCED = re.compile(r"^(`{3,})[^\n]*\n.*?^\1 *$|<!--.*?-->", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"^ {4}(?! |tominpmp).*\b(?:tm|np|solution|robot)\.\w.*$", re.M)


def test_python_of_pages_is_in_blocks_that_run() -> None:
    """Regression: indented Python of seven pages was never run."""
    found = [
        f"{label(page)}: {line}"
        for page in PAGES
        for line in INDENTED.findall(FENCED.sub("", page.read_text("utf-8")))
    ]
    assert found == []


def test_comments_mark_blocks_slow_needing_modules_or_left_out(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "<!-- before\nfound = [0]\n-->\n\n```python\nfound.append(1)\n```\n"
        "<!-- slow -->\n```python\nfound.append(2)\n```\n"
        "<!-- needs no_such_module -->\n```python\nfound.append(3)\n```\n"
        "<!-- left out: it has no end -->\n```python\nfound.append(4)\n```\n"
        "```{code-cell} python\n:tags: [a]\n\nfound.append(5)\n```\n",
        "utf-8",
    )
    assert doc_blocks.run_page(page, tmp_path / "a")["found"] == [0, 1, 5]
    slow = doc_blocks.run_page(page, tmp_path / "b", slow=True)
    assert slow["found"] == [0, 1, 2, 5]


def test_commands_are_run_for_named_pages_only(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Regression: without pages, `tominpmp app` of a page ran for ever."""
    monkeypatch.setattr(sys, "argv", ["doc_blocks.py", "--commands"])
    with pytest.raises(SystemExit):
        doc_blocks.main()
    assert "--commands needs PAGE" in capsys.readouterr().err


OBJECTS: dict[str, Any] = {
    "tm": tm,
    "solution": tm.Solution,
    "problem": tm.Problem,
    "robot": tm.Robot,
    "certificate": tm.Certificate,
    "verification": tm.Verification,
}
ATTRIBUTE = re.compile(rf"\b({'|'.join(OBJECTS)})\.(\w+)\b")
FILE_ENDINGS = ("csv", "html", "md", "npz", "png", "py", "toml", "yaml")
CALL = re.compile(r"\btm\.plan\(([^()]*)\)")
COMMAND = re.compile(r"^ {4}tominpmp (\w+)((?:.*\\\n)*.*)$", re.MULTILINE)


def has(owner: Any, name: str) -> bool:
    if owner is tm:
        return name in {*tm.__all__, "__version__"}
    return hasattr(owner, name) or name in {item.name for item in fields(owner)}


def test_attributes_named_in_pages_are_public() -> None:
    wrong = [
        f"{label(page)}: {owner}.{name}"
        for page in PAGES
        for owner, name in ATTRIBUTE.findall(page.read_text("utf-8"))
        # A file's name is no attribute.
        if name not in FILE_ENDINGS and not has(OBJECTS[owner], name)
    ]
    assert wrong == []


def test_options_of_plans_in_pages_exist() -> None:
    known = {*tm.Options.names(), "start"}
    wrong = [
        f"{label(page)}: {arguments}"
        for page in PAGES
        for arguments in CALL.findall(page.read_text("utf-8"))
        if not set(re.findall(r"(\w+)=", arguments)) <= known
    ]
    assert wrong == []


def test_flags_of_commands_in_pages_exist() -> None:
    from tominpmp.cli.front import COMMANDS
    from tominpmp.cli.parser import new_app

    app = new_app()
    known = {
        name: {
            flag
            for item in app[name].assemble_argument_collection()
            for flag in (*item.names, *item.negatives)
        }
        | {"--help", "-h"}
        for name in COMMANDS
    }
    wrong = [
        f"{label(page)}: {name} {arguments}"
        for page in PAGES
        for name, arguments in COMMAND.findall(page.read_text("utf-8"))
        if not set(re.findall(r"(?<=\s)--?[a-z][\w-]*", arguments))
        <= known.get(name, set())
    ]
    assert wrong == []


def test_patterns_find_wrong_names() -> None:
    """The patterns of the previous tests match wrong names."""
    assert not has(tm, "plam")
    assert not has(tm.Solution, "gapp")
    assert ATTRIBUTE.findall("a `solution.gapp` of tm.plam()") == [
        ("solution", "gapp"),
        ("tm", "plam"),
    ]
    assert COMMAND.findall("    tominpmp plan a \\\n        --no-such 1\n") == [
        ("plan", " a \\\n        --no-such 1")
    ]


def test_generated_reference_is_complete() -> None:
    contents = {name: make() for name, make in from_the_code.CONTENTS.items()}
    assert [name for name, lines in contents.items() if len(lines) <= 4] == []
    # A row whose last cell is empty is a field without a text in its docstring.
    lines = [line for lines in contents.values() for line in lines]
    assert [line for line in lines if line.endswith("|  |")] == []


def test_generated_exceptions_are_public() -> None:
    lines = from_the_code.CONTENTS["errors"]()
    named = {line[4:-1] for line in lines if line.startswith("## ")}
    assert named <= set(tm.__all__) and "FrameNotFound" in named
    assert [line for line in lines if line.startswith("A `_")] == []


def test_generated_keys_of_scenarios_are_those_of_files() -> None:
    lines = from_the_code.CONTENTS["scenario_keys"]()
    text = "\n".join(lines)
    goal = text.partition("— `JointGoal`")[2].partition("###")[0]
    assert set(re.findall(r"^\| `(\w+)` ", goal, re.MULTILINE)) == {
        *("q", "v", "state", "wrap"),
    }
    options = text.partition("## `[options]`")[2].partition("## ")[0]
    assert "`control_period`" in options and "callback" not in options


@pytest.mark.parametrize(
    ("name", "load"),
    [("scenario_example", tm.load_scenario), ("tour_keys", load_tour)],
    ids=lambda item: getattr(item, "__name__", item),
)
@pytest.mark.skipif("panda" not in robot_names(), reason="needs example-robot-data")
def test_generated_example_files_are_read(name: str, load: Any, tmp_path: Path) -> None:
    text = "\n".join(from_the_code.CONTENTS[name]())
    path = tmp_path / "example.toml"
    path.write_text(text.partition("```toml\n")[2].partition("```")[0])
    found = load(path)
    robot = found["robot"] if name == "tour_keys" else found.problem.robot
    assert f'name = "{robot.name}"' in text


def test_pages_include_every_generated_part() -> None:
    included = {
        name
        for page in PAGES
        for name in from_the_code.PLACE.findall(page.read_text("utf-8"))
    }
    assert included == set(from_the_code.CONTENTS)


def test_every_exception_documents_its_cure() -> None:
    for name in (item for item in tm.__all__ if hasattr(exceptions, item)):
        kind = getattr(exceptions, name)
        if kind not in (tm.TominpmpError, tm.TominpmpWarning):
            assert "Cure: " in kind.__doc__, name


def test_every_public_name_has_a_docstring() -> None:
    for name in tm.__all__:
        value = getattr(tm, name)
        assert (value.__doc__ or "").strip(), name


def test_every_public_name_is_used_in_an_example() -> None:
    unused = [name for name in tm.__all__ if not from_the_code.examples_of(name)]
    assert unused == []


def test_reference_lists_every_public_name_once() -> None:
    found = [
        name for page in from_the_code.PARTS for name in from_the_code.names_of(page)
    ]
    raised = {item for item in tm.__all__ if hasattr(exceptions, item)}
    assert sorted(found) == sorted(set(tm.__all__) - raised)


def test_public_functions_document_their_arguments() -> None:
    undocumented = []
    for name in tm.__all__:
        function = getattr(tm, name)
        if inspect.isfunction(function):
            documented = from_the_code.entries(function.__doc__, "Args")
            parameters = inspect.signature(function).parameters.values()
            undocumented += [
                f"{name}: {item.name}"
                for item in parameters
                if item.kind is not item.VAR_KEYWORD and item.name not in documented
            ]
    assert undocumented == []


def stored_type(kind: type, item: Field[Any]) -> str:
    """The type in which a field is stored."""
    converted = getattr(field_type(kind, item.name), "__origin__", None)
    if get_origin(converted) is not Converted:
        return str(item.type)
    return str(get_args(converted)[1]).replace("ndarray", "Array")


def test_array_fields_of_public_classes_document_their_shapes() -> None:
    undocumented = []
    for name in tm.__all__:
        kind = getattr(tm, name)
        if not is_dataclass(kind):
            continue
        documented: dict[str, str] = {}
        for base in reversed(kind.__mro__):
            documented |= from_the_code.entries(base.__doc__, "Attributes")
        head = kind.__doc__.partition("Attributes:")[0]
        undocumented += [
            f"{name}.{item.name}"
            for item in fields(kind)
            if "Array" in stored_type(kind, item)
            and "shape" not in f"{head} {documented[item.name]}"
        ]
    assert undocumented == []


def test_each_page_is_in_one_table_of_contents() -> None:
    text = (ROOT / "docs" / "index.md").read_text("utf-8")
    bodies = re.findall(r"```\{toctree\}\n(.*?)```", text, re.DOTALL)
    listed = [line for body in bodies for line in body.split("\n")]
    listed = [line for line in listed if line and not line.startswith(":")]
    assert sorted(set(listed)) == sorted(listed)


def test_directive_options_are_on_separate_lines() -> None:
    several = re.compile(r"^:[\w-]+: .* :[\w-]+: ", re.MULTILINE)
    assert several.search(":link: start :link-type: doc From a file")
    assert [p for p in PAGES if several.search(p.read_text("utf-8"))] == []
