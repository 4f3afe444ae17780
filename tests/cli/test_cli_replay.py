"""The command `replay`: a motion file simulated in MuJoCo, and robustness trials."""

from __future__ import annotations

import json
from dataclasses import fields
from inspect import signature

import pytest
from cli_samples import Run

from tominpmp.physics.options import ReplayOptions

pytest.importorskip("mujoco")

QUICK = ["--intervals", "8", "--planning-effort", "quick", "--starts", "1", "-q"]


@pytest.fixture
def files(run: Run) -> None:
    ends = ["--start", "0.5", "1.7", "-1.7", "--goal", "0.9", "1.2", "-1"]
    saved = ["--save-scenario", "s.toml", "-o", "m.csv"]
    assert run("plan", "planar3r", *ends, *QUICK, *saved).exit_code == 0


def test_replay_reports_whether_a_motion_ends_at_its_goal(
    run: Run, files: None
) -> None:
    result = run("replay", "s.toml", "m.csv", "--step", "0.001")
    assert result.exit_code == 0, result.stderr
    assert "The motion in m.csv ends at its goal." in result.stdout
    data = json.loads(run("replay", "s.toml", "m.csv", "--json").stdout)
    assert data["ok"] is True
    assert data["torque_difference"] < 1e-8
    assert data["open_loop"]["goal_error"] < 1e-4
    # A tolerance below rounding cannot be satisfied.
    strict = run("replay", "s.toml", "m.csv", "--goal-tolerance", "1e-15")
    assert strict.exit_code == 1
    assert "does not end at its goal" in strict.stdout


def test_invalid_arguments_of_replay_are_reported(run: Run, files: None) -> None:
    result = run("replay", "s.toml")
    assert result.exit_code == 2
    assert "a MOTION is missing; or give --robustness" in result.stderr
    # Regression: the motion was ignored.
    result = run("replay", "s.toml", "m.csv", "--robustness", "--samples", "1")
    assert result.exit_code == 2
    assert "MOTION is 'm.csv', but --robustness plans its own" in result.stderr
    result = run("replay", "planar3r", "m.csv")
    assert result.exit_code == 2
    assert "is not a scenario file" in result.stderr
    result = run("replay", "s.toml", "m.csv", "--step", "-1")
    assert result.exit_code == 2
    assert "step is -1" in result.stderr


@pytest.mark.parametrize("plans", [True, False])
def test_invalid_numbers_are_named_by_their_flags(run: Run, plans: bool) -> None:
    # Regression: the tolerance was called by its name in the library, and an option
    # of the replay was accepted unchecked beside --robustness, and the reverse.
    source = ["planar3r", "--robustness"] if plans else ["planar3r", "m.csv"]
    for flag, value in (
        ("--step", "nan"),
        ("--goal-tolerance", "inf"),
        ("--random-payload", "-1"),
        ("--tracking-tolerance", "0"),
        ("--bandwidth", "nan"),
    ):
        result = run("replay", *source, flag, value)
        assert result.exit_code == 2
        expected = f"error: {flag} is {float(value)}, expected a"
        assert expected in result.stderr, result.stderr


@pytest.mark.parametrize("plans", [True, False])
def test_wrong_counts_are_refused_beside_a_motion(run: Run, plans: bool) -> None:
    # Regression: only the trials checked their number and their seed, so that any
    # numbers were accepted beside a motion.
    source = ["planar3r", "--robustness"] if plans else ["planar3r", "m.csv"]
    for flag, value, expected in (
        ("--samples", "0", "an integer >= 1, at most 100000"),
        ("--samples", "100001", "an integer >= 1, at most 100000"),
        ("--seed", "-1", "an integer >= 0"),
        ("--seed", str(2**63), "an integer >= 0"),
    ):
        result = run("replay", *source, flag, value)
        assert result.exit_code == 2
        message = f"error: {flag} is {value}, expected {expected}"
        assert message in result.stderr, result.stderr


def test_robustness_reports_sorted_durations_of_its_trials(
    run: Run, files: None
) -> None:
    result = run("replay", "s.toml", "--robustness", "--samples", "1", "--json")
    data = json.loads(result.stdout)
    assert result.exit_code in (0, 1)
    assert data["samples"] == 1
    assert data["T"] == sorted(data["T"])


def test_robustness_flags_choose_the_disturbances(run: Run, files: None) -> None:
    calm = ["--random-payload", "0", "--random-friction", "0", "--random-noise", "0"]
    trial = ["--samples", "1", "--random-delay", "0.001", "--bandwidth", "50"]
    loose = ["--tracking-tolerance", "0.05"]
    result = run("replay", "s.toml", "--robustness", *trial, *calm, *loose)
    assert result.exit_code == 0, result.stderr
    text = " ".join(result.stdout.split())
    assert "reserve of 0% (--effort-scale 1) keeps 99% of 1 trials" in text
    assert "up to 0 kg more" in text
    assert "delays up to 0.001 s" in text
    wrong = run("replay", "s.toml", "--robustness", "--random-delay", "-1")
    assert wrong.exit_code == 2
    assert "delay is -1" in wrong.stderr


def test_replay_flags_have_the_defaults_of_the_library() -> None:
    """The defaults are written twice: the help of the command imports light modules."""
    from tominpmp.physics.replay import replay
    from tominpmp.physics.robustness import Disturbances, robustness

    parameters = [signature(function).parameters for function in (replay, robustness)]
    motion, trials = ({k: p.default for k, p in each.items()} for each in parameters)
    assert vars(ReplayOptions()) == vars(ReplayOptions()) | {
        "step": motion["step"],
        "goal_tolerance": motion["tolerance"],
        "tracking_tolerance": trials["tolerance"],
        **{name: trials[name] for name in ("samples", "seed", "bandwidth")},
        **{f"random_{item.name}": item.default for item in fields(Disturbances)},
    }
