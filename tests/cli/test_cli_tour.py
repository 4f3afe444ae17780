"""The command `tour`, and scenario files with stations."""

from __future__ import annotations

import json
import re
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command_line import invoke

import tominpmp as tm
from tominpmp.cell import running
from tominpmp.cell.tours.tour_file import load_tour
from tominpmp.files import export_check

HEAD = """
[robot]
name = "planar3r"
effort = 1e4

[start]
q = [0.5, 1.2, -0.7]

[motion_limits]
acceleration = 5.0
"""
STATIONS = """
[[stations]]
name = "drill"
dwell = 0.2
goal = {type = "joint", q = [0.9, 0.8, -0.4]}

[[stations]]
name = "tap"
after = ["drill"]
goal = {type = "joint", q = [0.6, 1.0, -0.3]}
"""


def run(path: Path, *arguments: str | Path) -> tuple[int, str]:
    done = invoke(["tour", str(path), *map(str, arguments)])
    return done.exit_code, done.output


def scenario(folder: Path, text: str) -> Path:
    path = folder / "tour.toml"
    path.write_text(HEAD + text)
    return path


def test_tour_of_a_file_is_planned_and_written(tmp_path: Path) -> None:
    path = scenario(tmp_path, '[tour]\nend = "last"\n' + STATIONS)
    code, output = run(path, "--json", "-o", tmp_path / "cycle.csv", "--dt", "0.01")
    assert code == 0
    found = json.loads(output)
    assert [visit["station"] for visit in found["visits"]] == ["drill", "tap"]
    assert found["verified"] and found["lower_bound"] <= found["cycle_time"]
    motion = tm.load_motion(tmp_path / "cycle.csv")
    assert motion.t[-1] == pytest.approx(found["cycle_time"])
    code, output = run(path)
    assert code == 0 and "drill" in output and "cycle" in output


def test_tour_is_written_to_standard_output(tmp_path: Path) -> None:
    done = invoke(["tour", str(scenario(tmp_path, STATIONS)), "-o", "-"])
    assert done.exit_code == 0
    assert done.stdout.startswith("time,q_joint1,") and "cycle" in done.stderr
    code, output = run(tmp_path / "tour.toml", "-o", "-", "--json")
    assert code == 2 and "both write to standard output" in output


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "stations"),
        (STATIONS.replace("0.2", "-1"), "stations[0].dwell: is -1, expected"),
        (STATIONS.replace('["drill"]', '["mill"]'), "mill"),
        (STATIONS.replace("0.9,", "90.0,"), "drill"),
        ('[tour]\nend = "home"\n' + STATIONS, "end"),
        ("[tour]\nend = {elbow = 1}\n" + STATIONS, "tour.end: has a value for 'elbow'"),
        ('[tour]\nprecedence = [["tap", "drill"]]\n' + STATIONS, "cycle"),
        (STATIONS + "speed = 3", "speed"),
    ],
)
def test_invalid_tour_file_is_named_by_its_key(
    tmp_path: Path, text: str, named: str
) -> None:
    code, output = run(scenario(tmp_path, text))
    assert code == 2
    assert named in output


def test_load_tour_returns_arguments_of_plan_tour(tmp_path: Path) -> None:
    found = load_tour(scenario(tmp_path, STATIONS))
    assert [station.name for station in found["stations"]] == ["drill", "tap"]
    tour = tm.plan_tour(**found, seed=1)
    assert tour.success and len(tour.motions) == 3


def test_options_of_a_file_keep_the_default_effort_of_tours(tmp_path: Path) -> None:
    """Regression: a file with any option was planned with the effort of one motion."""
    found = load_tour(scenario(tmp_path, "[options]\nseed = 3\n" + STATIONS))
    (effort,) = {motion.options.effort for motion in tm.plan_tour(**found).motions}
    assert effort == "quick"
    text = '[options]\neffort = "standard"\nrefine = "none"\n' + STATIONS
    found = load_tour(scenario(tmp_path, text))
    assert found["effort"] == "standard" and found["refine"] is None


def test_unnamed_joints_of_a_station_stay_at_the_start_of_the_tour(
    tmp_path: Path,
) -> None:
    some = STATIONS.replace("[0.6, 1.0, -0.3]", "{joint2 = 1.0}")
    path = scenario(tmp_path, "[tour]\nend = {joint1 = 0.8}\n" + some)
    found = load_tour(path)
    assert found["q_end"].tolist() == [0.8, 1.2, -0.7]
    assert found["stations"][1].goal.q.tolist() == [0.5, 1.0, -0.7]


def test_tour_file_that_fails_its_check_is_an_error(tmp_path: Path) -> None:
    path = scenario(tmp_path, STATIONS)
    code, output = run(path, "-o", tmp_path / "cycle.yaml", "--dt", "0.1")
    assert code == 1
    assert "cycle.yaml does not pass" in output and "drill" in output
    assert (tmp_path / "cycle.yaml").exists()


def test_tour_that_cannot_be_written_is_saved_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = scenario(tmp_path, STATIONS)
    code, output = run(path, "-o", "cycle.csv", "--dt", "1e-7")
    assert code == 2
    kept = re.search(r"kept in (\S+)", output)
    assert kept and tm.load_motion(kept[1]).t[-1] > 0.0
    assert "drill" in output and "cycle  " in output  # regression: no report


def test_failed_file_check_is_reported_after_an_interrupt(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(**arguments: Any) -> tm.Tour:
        return replace(tm.plan_tour(**arguments), status=tm.Status.INTERRUPTED)

    monkeypatch.setattr(running, "plan_tour", interrupted)
    path = scenario(tmp_path, STATIONS)
    code, output = run(path, "-o", tmp_path / "cycle.yaml", "--dt", "0.1")
    assert code == 130
    assert "cycle.yaml does not pass" in output


def test_interrupt_during_writing_completes_the_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: the tour was lost, and no report was printed."""
    judge = export_check.check_export

    def interrupted(*arguments: Any, **options: Any) -> Any:
        signal.raise_signal(signal.SIGTERM)  # which background jobs receive, too
        return judge(*arguments, **options)

    monkeypatch.setattr(export_check, "check_export", interrupted)
    page = tmp_path / "cycle.html"
    path = scenario(tmp_path, STATIONS)
    code, output = run(path, "-o", tmp_path / "cycle.csv", "--html", page)
    assert code == 143
    assert page.exists() and "drill" in output and f"file   {page}" in output


def test_tour_with_all_stations_at_the_start_has_no_motion_to_write(
    tmp_path: Path,
) -> None:
    stay = STATIONS.partition('\n[[stations]]\nname = "tap"')[0]
    stay = stay.replace("[0.9, 0.8, -0.4]", "[0.5, 1.2, -0.7]")
    path = scenario(tmp_path, stay)
    code, output = run(path)  # regression: the tour was not reported without files
    assert code == 0 and "cycle  0.2000 s" in output
    code, output = run(path, "-o", tmp_path / "cycle.csv")
    assert code == 2
    assert "no motion: all stations are at the start" in " ".join(output.split())


def test_plan_of_a_file_with_stations_suggests_the_tour_command(
    tmp_path: Path,
) -> None:
    done = invoke(["plan", str(scenario(tmp_path, STATIONS))])
    assert done.exit_code == 2
    assert "stations: belong to a tour, see tominpmp tour --help" in done.output


def test_tour_of_a_file_with_a_goal_suggests_the_plan_command(
    tmp_path: Path,
) -> None:
    """Regression: the message said that a key of a valid scenario does not exist."""
    goal = '[goal]\ntype = "joint"\nq = [0.9, 0.8, -0.4]\n'
    done = invoke(["tour", str(scenario(tmp_path, goal))])
    assert done.exit_code == 2
    assert "goal: belongs to a single motion, see tominpmp plan --help" in done.output
