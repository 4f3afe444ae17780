"""Batches of problems: motions do not depend on the workers, and results are kept."""

from __future__ import annotations

import json
import math
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import batch_samples
import numpy as np
import pytest
import trimesh
from batch_samples import QUICK, Deadly, Unsendable, problems, rail
from command_line import invoke

import tominpmp as tm
from tominpmp.cell import running
from tominpmp.cell.batch.dataset import Entry
from tominpmp.cell.batch.executor import Executor
from tominpmp.cell.batch.neighbours import rounds_of
from tominpmp.cell.batch.plan_many import Progress


def motions(outcomes: list[tm.Outcome]) -> list[tm.Trajectory]:
    found = [outcome.solution for outcome in outcomes]
    return [s.trajectory for s in found if s is not None and s.trajectory is not None]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("batch")


@pytest.fixture(scope="module")
def alone(folder: Path) -> list[tm.Outcome]:
    """Planned in this process."""
    return list(tm.plan_many(problems(folder), workers=1, **QUICK))


def test_batch_plans_the_same_motions_as_plan(
    folder: Path, alone: list[tm.Outcome]
) -> None:
    assert [outcome.index for outcome in alone] == list(range(6))
    assert all(outcome.success and outcome.verified for outcome in alone)
    for problem, outcome in zip(problems(folder), alone, strict=True):
        solution = tm.plan(problem, seed=outcome.seed, **QUICK)
        assert outcome.solution is not None
        assert outcome.solution.trajectory == solution.trajectory
        assert outcome.T == solution.T and outcome.gap == solution.gap
    assert len({outcome.seed for outcome in alone}) == 6
    assert pickle.loads(pickle.dumps(alone)) == alone


@pytest.mark.parametrize(
    "how",
    [
        {"workers": 2},
        {"backend": "threading", "workers": 3, "ordered": False},
    ],
)
def test_workers_and_threads_plan_bit_identical_motions(
    folder: Path, alone: list[tm.Outcome], how: dict[str, Any]
) -> None:
    found = list(tm.plan_many(problems(folder), **how, **QUICK))
    found.sort(key=lambda outcome: outcome.index)
    assert motions(found) == motions(alone)
    assert [one.seed for one in found] == [one.seed for one in alone]


def test_problems_are_taken_lazily_from_their_iterator(folder: Path) -> None:
    taken = []

    def endless() -> Iterator[tm.Problem]:
        for problem in 1000 * problems(folder, 2):
            taken.append(problem)
            yield problem

    stream = tm.plan_many(endless(), workers=1, **QUICK)
    assert not taken
    assert next(stream).index == 0 and next(stream).index == 1
    assert len(taken) < 10
    stream.close()


def test_invalid_problems_become_outcomes_with_status_broken(folder: Path) -> None:
    broken = folder / "broken.toml"
    broken.write_text("[robot]\nname = 3\n")
    far = tm.Problem(rail(folder), [0.0], tm.JointGoal([1.0]))
    gone = "gone\udcff"  # names of files may have bytes that are not UTF-8
    given = [far, 17, (gone, folder / "none.toml"), broken, Unsendable(), far]
    found = list(tm.plan_many(given, workers=1, **QUICK))
    assert [outcome.success for outcome in found] == [True, *[False] * 4, True]
    assert [outcome.status for outcome in found[1:5]] == ["BROKEN"] * 4
    assert "expected a Problem" in found[1].message
    assert found[2].name == gone and "none.toml" in found[2].message
    assert found[3].name == "broken" and "robot.name" in found[3].message
    assert "a lock is in it" in found[4].message
    assert math.isinf(found[1].T) and not found[1]


@pytest.mark.slow
def test_only_the_problem_that_kills_its_process_is_lost(folder: Path) -> None:
    one = problems(folder, 1)[0]
    given = [one, ("deadly", Deadly()), one]
    found = list(tm.plan_many(given, workers=2, **QUICK))
    statuses = [outcome.status for outcome in found]
    assert statuses == ["CONVERGED", "LOST", "CONVERGED"]
    assert found[1].name == "deadly" and "killed" in found[1].message


def test_interrupted_batch_resumes_from_its_results(
    folder: Path, alone: list[tm.Outcome]
) -> None:
    results = folder / "results"
    how = {"results": results, "workers": 1, **QUICK}
    stream = tm.plan_many(problems(folder), **how)
    first = [next(stream) for _ in range(3)]
    stream.close()
    files = tm.Dataset(results).files
    assert len(files) >= 3 and first[0].path == files[0]
    files[1].write_bytes(b"half a file")
    found = list(tm.plan_many(problems(folder), **how))
    assert [outcome.resumed for outcome in found[:3]] == [True, False, True]
    assert motions(found) == motions(alone)
    again = list(tm.plan_many(problems(folder), **how))
    assert all(outcome.resumed for outcome in again)
    assert [one.T for one in again] == [one.T for one in alone]
    assert again[0].solution is not None
    state = again[0].solution.trajectory(0.3)
    np.testing.assert_array_equal(state, alone[0].solution.trajectory(0.3))
    other = list(tm.plan_many(problems(folder), **{**how, "intervals": 10}))
    assert not any(outcome.resumed for outcome in other)


def test_results_are_reused_at_another_position_in_the_list(folder: Path) -> None:
    """A scenario that is added or removed in front shifts the indices of the rest."""
    results, given = (
        folder / "shifted",
        dict(zip("abcd", problems(folder), strict=False)),
    )

    def planned(names: str) -> dict[str, tuple[bool, float]]:
        chosen = [(name, given[name]) for name in names]
        found = list(tm.plan_many(chosen, results=results, workers=1, **QUICK))
        data = tm.Dataset(results)
        assert data.files == [outcome.path for outcome in found] and len(data) == len(
            found
        )
        read = [(e.about["index"], e.about["name"], e.T) for e in data]
        assert read == [(k, name, found[k].T) for k, name in enumerate(names)]
        assert [outcome.index for outcome in found] == list(range(len(names)))
        return {outcome.name: (outcome.resumed, outcome.T) for outcome in found}

    first = planned("bcd")
    more = planned("abcd")
    assert more == {"a": (False, more["a"][1])} | {
        k: (True, first[k][1]) for k in "bcd"
    }
    assert all(resumed for resumed, _ in planned("dc").values())
    # A result is not reused for another problem with the same name.
    given["c"] = given["a"]
    assert {k: resumed for k, (resumed, _) in planned("cd").items()} == {
        "c": False,
        "d": True,
    }
    # The dataset of an interrupted batch has the results that belong to this batch.
    stream = tm.plan_many(
        [("b", given["b"]), ("a", given["a"])], results=results, **QUICK
    )
    assert next(stream).resumed and len(tm.Dataset(results)) < 3
    assert tm.Dataset(results).files[0].name.startswith("b_")
    stream.close()


@pytest.mark.parametrize("text", ["0 a.npz\n\n", "0 a 1 b\n", "x\0\n", "0 \xe4\n"])
def test_damaged_list_of_results_is_named_in_the_error(folder: Path, text: str) -> None:
    results = folder / "damaged"
    list(tm.plan_many(problems(folder, 1), results=results, workers=1, **QUICK))
    (results / "results.txt").write_text(text, encoding="utf-8")
    with pytest.raises(tm.ScenarioError, match=r"results\.txt is damaged .*deleted"):
        list(tm.Dataset(results))
    (results / "results.txt").unlink()
    assert len(list(tm.Dataset(results))) == 1


def test_running_tasks_are_cancelled_without_warnings() -> None:
    """joblib warns when it cancels tasks, and warnings are errors in these tests."""
    results = Executor(batch_samples.slept, 2, None).results(
        (name, 0.2) for name in "abcdef"
    )
    assert next(results) in (("a", 0.2), ("b", 0.2))
    results.close()


def test_warm_started_results_are_reused_with_their_origin(
    folder: Path,
) -> None:
    given = dict(zip("abcdefghi", problems(folder, 9), strict=True))
    how = {"results": folder / "warm", "warm_start": True, "workers": 1, **QUICK}
    first = list(tm.plan_many(given, **how))
    assert any(outcome.began_with is not None for outcome in first)
    again = list(tm.plan_many(dict(reversed(given.items())), **how))
    assert {o.name: o.T for o in again if o.resumed}.items() <= {
        o.name: o.T for o in first
    }.items()
    for outcome in again:
        assert outcome.began_with is None or outcome.began_with != outcome.index
    same = list(tm.plan_many(given, **how))
    assert all(outcome.resumed for outcome in same)
    assert [o.began_with for o in same] == [o.began_with for o in first]


TASK = """
[robot]
path = "arm.urdf"
[start]
q = [0.5, 1.7, -1.7]
[goal]
type = "joint"
q = [1.0, 1.0, -1.5]
[[scene.obstacles]]
name = "post"
type = "mesh"
path = "post.stl"
position = [-9.0, 0.0, 0.0]
"""


@pytest.mark.parametrize("changed", ["arm.urdf", "post.stl", "none"])
def test_results_are_not_reused_after_a_change_of_their_files(
    tmp_path: Path, changed: str
) -> None:
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(Path(tm.load_robot("planar3r").urdf_path).read_text())
    post = trimesh.creation.box((0.1, 0.1, 0.1))
    post.export(tmp_path / "post.stl")
    scenario = tmp_path / "task.toml"
    scenario.write_text(TASK)

    def planned() -> tm.Outcome:
        (found,) = tm.plan_many(
            [scenario], workers=1, results=tmp_path / "results", **QUICK
        )
        assert found.success, found.message
        return found

    first = planned()
    if changed == "arm.urdf":
        urdf.write_text(urdf.read_text().replace('effort="7"', 'effort="5"'))
    elif changed == "post.stl":
        post.apply_scale(1.1).export(tmp_path / "post.stl")
    second = planned()
    assert second.resumed == (changed == "none")
    assert (second.T > 1.001 * first.T) == (changed == "arm.urdf")


def test_batch_saves_a_problem_whose_mesh_file_was_deleted(
    tmp_path: Path, planar3r: tm.Robot
) -> None:
    """The saved scenario holds the mesh itself."""
    file = tmp_path / "post.stl"
    trimesh.creation.box((0.1, 0.1, 0.1)).export(file)
    post = tm.Mesh("post", path=file, position=(0.0, 0.0, 3.0))
    plain = tm.Problem(planar3r, (0.5, 0.5, 0.5), tm.JointGoal((0.7, 0.5, 0.5)))
    given = [replace(plain, scene=tm.Scene([post])), plain]
    file.unlink()
    results = tmp_path / "results"
    found = list(tm.plan_many(given, workers=1, results=results, **QUICK))
    assert all(found), [item.message for item in found]
    kept = next(iter(tm.Dataset(results))).load().problem
    assert kept.scene == given[0].scene
    assert all(item.resumed for item in tm.plan_many(given, results=results, **QUICK))


SCRIPT = """
import sys
sys.path.insert(0, {here!r})
from pathlib import Path
from batch_samples import QUICK, problems
import time
import tominpmp as tm
def given(folder):
    yield from problems(folder, 400)[:60]
    time.sleep(3600.0)  # the process is killed before, however fast the machine
if __name__ == "__main__":
    folder = Path({folder!r})
    results = folder / "killed"
    for _ in tm.plan_many(given(folder), workers=2, results=results, **QUICK):
        pass
"""


def test_killed_batch_keeps_its_finished_results(folder: Path) -> None:
    results, script = folder / "killed", folder / "script.py"
    here = str(Path(batch_samples.__file__).parent)
    script.write_text(SCRIPT.format(here=here, folder=str(folder)))
    run = subprocess.Popen([sys.executable, str(script)])
    limit = time.monotonic() + 600.0
    while len(list(results.glob("*/*.npz"))) < 6 and time.monotonic() < limit:
        time.sleep(0.05)
    run.send_signal(signal.SIGKILL)
    run.wait()
    time.sleep(1.0)  # until the workers have ended
    done = list(results.glob("*/*.npz"))
    assert 6 <= len(done) <= 60
    # Not the first ones in any case: a worker may start later than the other one.
    given = problems(folder, 400)[:60]
    found = list(tm.plan_many(given, workers=1, results=results, **QUICK))
    assert all(outcome.success for outcome in found)
    assert sum(outcome.resumed for outcome in found) >= len(done)


def test_warm_starts_do_not_depend_on_the_number_of_workers(folder: Path) -> None:
    given = problems(folder, 9)
    one, two = (
        list(tm.plan_many(given, warm_start=True, workers=count, **QUICK))
        for count in (1, 2)
    )
    assert [outcome.index for outcome in one] == list(range(9))
    assert motions(one) == motions(two)
    began = [outcome.began_with for outcome in one]
    assert began == [outcome.began_with for outcome in two]
    assert sum(number is None for number in began) == 2
    cold = list(tm.plan_many(given, workers=1, **QUICK))
    for warm, other in zip(one, cold, strict=True):
        assert warm.T == pytest.approx(other.T, rel=2e-3)


def test_neighbours_are_near_and_planned_in_earlier_rounds(folder: Path) -> None:
    given = [*problems(folder, 12), None]
    rounds, near = rounds_of(given)
    assert sorted(k for numbers in rounds for k in numbers) == list(range(13))
    known: set[int] = set()
    for numbers in rounds:
        for k in numbers:
            assert {j for j, _ in near[k]} <= known
        known |= set(numbers)
    assert all(min(abs(k - j) for j, _ in near[k]) == 1 for k in rounds[-1])


def test_progress_counts_done_and_solved_problems(folder: Path) -> None:
    states: list[Progress] = []
    given = [*problems(folder, 2), "none.toml"]
    outcomes = tm.plan_many(given, workers=1, progress=states.append, **QUICK)
    assert len(list(outcomes)) == 3
    assert [(s.done, s.found, s.total) for s in states] == [
        (1, 1, 3),
        (2, 2, 3),
        (3, 2, 3),
    ]
    assert states[-1].last.name == "none"


def test_time_limit_holds_for_each_plan_of_a_batch(folder: Path) -> None:
    given = problems(folder, 2)
    found = list(tm.plan_many(given, workers=1, max_planning_time=1e-4))
    assert {outcome.status for outcome in found} == {"TIME_LIMIT"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"problems": 3}, "problems is 3"),
        ({"problems": "a.toml"}, r"\[path\] for one"),
        ({"workers": 0}, "workers is 0"),
        ({"workers": "two"}, "workers is 'two'"),
        ({"backend": "carrier pigeons"}, "backend is 'carrier pigeons'"),
        ({"backend": 3}, "backend is 3"),
        ({"seed": -1}, "seed is -1"),
        ({"ordered": "no"}, "ordered is 'no'"),
        ({"progress": 1}, "progress is 1"),
        ({"options": {}}, "options is"),
        ({"results": 5}, "results is 5"),
    ],
)
def test_invalid_argument_is_named_in_the_error(
    arguments: dict[str, Any], message: str
) -> None:
    with pytest.raises(tm.ProblemError, match=message):
        tm.plan_many(**{"problems": [], **arguments})


def test_invalid_options_and_folders_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(tm.OptionsError, match="no_such"):
        tm.plan_many([], no_such=3)
    (tmp_path / "file").write_text("")
    with pytest.raises(tm.ScenarioError, match=r"^/.*file: .*expected a folder"):
        tm.plan_many([], results=tmp_path / "file")
    with pytest.raises(tm.ScenarioError, match="not a folder"):
        tm.Dataset(tmp_path / "none")


def test_dataset_is_read_without_the_list_of_problems(
    folder: Path, alone: list[tm.Outcome]
) -> None:
    results = folder / "dataset"
    list(tm.plan_many([*problems(folder), "none.toml"], results=results, **QUICK))
    dataset = tm.Dataset(results)
    assert len(dataset) == 7
    entries = list(dataset)
    assert [entry.success for entry in entries] == [*[True] * 6, False]
    assert entries[0].T == alone[0].T
    assert entries[0].load().problem == problems(folder)[0]
    assert entries[2].trajectory() == motions(alone)[2]
    assert entries[6].trajectory() is None
    with pytest.raises(tm.ScenarioError, match="holds no problem"):
        entries[6].load()
    rows = [row for _, row in dataset.samples(20)]
    assert len(rows) == 6 and all(row.shape == (20, 3) for row in rows)
    np.testing.assert_allclose(rows[0][-1, 0], 0.5, atol=1e-6)
    with np.load(dataset.files[0]) as file:
        about = json.loads(str(file["about"]))
    assert about["status"] == "CONVERGED" and about["verified"] is True
    assert not list(results.rglob(".*")), "drafts are left"


def test_parquet_table_has_the_motions_and_joint_names(folder: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    results = folder / "table"
    list(tm.plan_many(problems(folder, 2), results=results, workers=1, **QUICK))
    path = tm.Dataset(results).to_parquet(folder / "table.parquet")
    table = parquet.read_table(path).to_pylist()
    assert len(table) == 2 and table[0]["success"] and len(table[0]["q"]) > 8
    assert table[0]["joint_names"] == [*problems(folder, 1)[0].robot.joint_names]


def test_parquet_without_pyarrow_names_the_missing_dependency(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: the message began with "Parquet files needs"."""
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(tm.MissingDependency, match="writing Parquet files needs"):
        tm.Dataset(tmp_path).to_parquet(tmp_path / "table.parquet")


def test_parquet_table_may_begin_with_a_result_without_a_motion(folder: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    results = folder / "late"
    cases = [folder / "missing.toml", *problems(folder, 1)]
    list(tm.plan_many(cases, results=results, workers=1, **QUICK))
    path = tm.Dataset(results).to_parquet(folder / "late.parquet")
    broken, planned = parquet.read_table(path).to_pylist()
    assert broken["q"] is None and not broken["success"]
    assert len(planned["q"]) > 8 and planned["robot"]


def test_npz_file_that_is_no_result_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, x=np.zeros(3))
    with pytest.raises(tm.ScenarioError, match="not the result of a batch"):
        Entry.read(path)


def test_batch_command_names_broken_scenarios_and_reads_lists(
    folder: Path, tmp_path: Path
) -> None:
    cells = tmp_path / "cells"
    (cells / "more").mkdir(parents=True)
    one, two = problems(folder, 2)
    tm.save_scenario(cells / "a.toml", one)
    tm.save_scenario(cells / "more" / "c.toml", two)
    (cells / "b.toml").write_text("[robot]\nname = 'nobody'\n")
    results = tmp_path / "results"
    words = ["batch", str(cells), "-o", str(results), "--workers", "1"]
    words += ["--intervals", "8", "--refine", "none", "--starts", "1"]
    found = invoke(words)
    assert found.exit_code == 1, found.output
    assert "3/3" in found.output and "2 of 3" in found.output
    assert "b: " in found.output and "nobody" in found.output
    assert [e.about["name"] for e in tm.Dataset(results)] == ["a", "b", "more/c"]
    (cells / "list").write_text("")
    listed = tmp_path / "list.toml"
    listed.write_text("problems = ['cells/a.toml', 'cells/more/*.toml']\n")
    words[1:2] = [str(listed), "--json"]
    found = invoke(words)
    assert found.exit_code == 0, found.output
    data = json.loads(found.stdout)
    assert data["found"] == 2 and data["outcomes"][1]["name"] == "cells/more/c"
    files = [str(file) for file in tm.Dataset(results).files]
    assert [outcome["path"] for outcome in data["outcomes"]] == files
    assert [outcome["file"] for outcome in data["outcomes"]] == files
    # Patterns may be absolute, too, and follow the rules of a shell.
    (cells / ".draft.toml").write_text("")
    absolute = tmp_path / "absolute.toml"
    absolute.write_text(f"problems = ['{cells}/**/*.toml', '{cells}/[a]*']\n")
    files = [file for _, file in running._scenarios_in(absolute)]
    assert files == [cells / "a.toml", cells / "b.toml", cells / "more" / "c.toml"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("problems = ['none*.toml']", "which no file matches"),
        ('problems = ["a\\u0000/*"]', "which no file matches"),
        ("problems = 3", "problems"),
        ("problem = []", "problem"),
        ("problems = []", "holds no scenario"),
    ],
)
def test_invalid_list_of_scenarios_is_reported(
    tmp_path: Path, content: str, message: str
) -> None:
    path = tmp_path / "list.toml"
    path.write_text(content)
    found = invoke(["batch", str(path), "-o", str(tmp_path / "r")])
    assert found.exit_code == 2 and message in found.output
    assert not (tmp_path / "r").exists()


def test_batch_of_an_empty_folder_is_an_error(tmp_path: Path) -> None:
    found = invoke(["batch", str(tmp_path)])
    assert found.exit_code == 2 and "holds no scenario" in found.output


def test_backend_that_is_not_installed_is_named_in_the_error(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.setitem(sys.modules, "dask", None)
    with pytest.raises(tm.TominpmpError, match=r"distributed|dask"):
        tm.plan_many(problems(folder, 1), backend="dask")


def test_outcome_has_a_readable_repr_and_equality(alone: list[tm.Outcome]) -> None:
    assert repr(alone[0]).startswith("<Outcome 'problem 0': CONVERGED, T = ")
    assert replace(alone[0]) == alone[0]
