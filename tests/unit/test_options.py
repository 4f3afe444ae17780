"""Checks of the values of options, and options as immutable values."""

from __future__ import annotations

import pickle
import re
from dataclasses import FrozenInstanceError, fields, replace

import numpy as np
import pytest

from tominpmp.exceptions import OptionsError
from tominpmp.options import CHOICES, Options

NO_NUMBERS = ["1", None, [1.0], np.ones(2), 1j, object(), True]
NOT_POSITIVE = [0, 0.0, -1.0, np.nan, np.inf, -np.inf]
NO_INTEGERS = ["4", None, 4.0, np.nan, [4], True, object()]
NO_CHOICES = ["", "fastest", None, 3, ["auto"], np.array(["auto", "uniform"]), object()]

# Values that each option refuses; one entry for every option.
BAD = {
    "method": NO_CHOICES,
    "intervals": [*NO_INTEGERS, 3, 0, -5],
    "grid": NO_CHOICES,
    "control": NO_CHOICES,
    "objective": NO_CHOICES,
    "effort": NO_CHOICES,
    "energy": NO_CHOICES,
    "energy_weight": [*NO_NUMBERS, -1e-9, np.nan, np.inf],
    "slack": [*(v for v in NO_NUMBERS if v is not None), -1e-9, np.nan, np.inf],
    "smoothing": [*(v for v in NO_NUMBERS if v is not None), -1e-9, np.nan, np.inf],
    "starts": [*(v for v in NO_INTEGERS if v is not None), 0, -1],
    "seed": [*NO_INTEGERS, -1],
    "max_planning_time": [
        *(v for v in NO_NUMBERS if v is not None),
        *(v for v in NOT_POSITIVE if v != np.inf),  # inf: no limit
    ],
    "max_iterations": [*NO_INTEGERS, 0, -1],
    "tolerance": [*NO_NUMBERS, *NOT_POSITIVE],
    "feasibility": [*NO_NUMBERS, *NOT_POSITIVE],
    "trust_region": [*NO_NUMBERS, *NOT_POSITIVE],
    "step_rule": NO_CHOICES,
    "control_step": [*NO_NUMBERS, *NOT_POSITIVE],
    "time_step": [*NO_NUMBERS, *NOT_POSITIVE],
    "control_period": [*(v for v in NO_NUMBERS if v is not None), *NOT_POSITIVE],
    "initial_duration": [*(v for v in NO_NUMBERS if v is not None), *NOT_POSITIVE],
    "initial_control": [
        "zero",
        1.0,
        [],
        [[1.0], [1.0, 2.0]],
        [1.0, None],
        [1.0, np.nan],
        [[np.inf, 0.0]],
        np.zeros((2, 2, 2)),
        {},
    ],
    "lp_solver": ["", None, 3, ["highs"], object()],
    "processes": [*NO_INTEGERS, 0, -2],
    "refine": ["mesh", 3, True],
    "goal_tolerance": [*NO_NUMBERS, *NOT_POSITIVE],
    "speed_tolerance": [*NO_NUMBERS, *NOT_POSITIVE],
    "limit_tolerance": [*NO_NUMBERS, *NOT_POSITIVE],
    "contact_tolerance": [*NO_NUMBERS, *NOT_POSITIVE],
    "callback": ["print", 3, []],
}

# Values that each option accepts, each with the value that is stored.
GOOD = {
    "method": [(value, value) for value in CHOICES["method"]],
    "intervals": [(4, 4), (np.int64(500), 500)],
    "grid": [(value, value) for value in CHOICES["grid"]],
    "control": [(value, value) for value in CHOICES["control"]],
    "objective": [("time", "time"), ("feasible", "feasible")],
    "effort": [(value, value) for value in CHOICES["effort"]],
    "energy": [(value, value) for value in CHOICES["energy"]],
    "energy_weight": [(0, 0.0), (1e-3, 1e-3)],
    "slack": [(None, None), (0, 0.0), (0.01, 0.01)],
    "smoothing": [(None, None), (0, 0.0), (np.float32(0.5), 0.5)],
    "starts": [(None, None), (1, 1), (np.int32(7), 7)],
    "seed": [(0, 0), (2**40, 2**40)],
    "max_planning_time": [(None, None), (1, 1.0), (1e-3, 1e-3), (np.inf, np.inf)],
    "max_iterations": [(1, 1)],
    "tolerance": [(1e-12, 1e-12), (np.array(0.5), 0.5)],
    "feasibility": [(1e-3, 1e-3)],
    "trust_region": [(10, 10.0)],
    "step_rule": [(value, value) for value in CHOICES["step_rule"]],
    "control_step": [(0.05, 0.05)],
    "time_step": [(0.01, 0.01)],
    "control_period": [(None, None), (0.004, 0.004)],
    "initial_duration": [(None, None), (1.5, 1.5)],
    "initial_control": [(None, None)],
    "lp_solver": [(value, value) for value in ("auto", "highs", "piqp", "clarabel")],
    "processes": [(1, 1), (8, 8)],
    "refine": [(None, None), ("grid", "grid"), ("switching", "switching")],
    "goal_tolerance": [(1, 1.0), (1e-3, 1e-3)],
    "speed_tolerance": [(1, 1.0), (1e-3, 1e-3)],
    "limit_tolerance": [(1, 1.0), (1e-3, 1e-3)],
    "contact_tolerance": [(1, 1.0), (1e-3, 1e-3)],
    "callback": [(None, None), (print, print)],
}


def test_every_option_is_tested() -> None:
    names = [item.name for item in fields(Options)]
    assert list(Options.names()) == names
    assert set(BAD) == set(GOOD) == set(names)


@pytest.mark.parametrize("name", BAD)
def test_bad_values_are_refused_with_option_and_expectation(name: str) -> None:
    taken, unclear = [], []
    for value in BAD[name]:
        try:
            Options(**{name: value})  # type: ignore[arg-type]
        except OptionsError as error:
            clear = re.match(rf"(?s){name} is .*, expected ", str(error))
            if error.option != name or not clear:
                unclear.append(str(error))
        else:
            taken.append(value)
    assert (taken, unclear) == ([], [])


@pytest.mark.parametrize("name", GOOD)
def test_good_values_are_converted_and_stored(name: str) -> None:
    for value, kept in GOOD[name]:
        found = getattr(Options(**{name: value}), name)  # type: ignore[arg-type]
        assert found == kept
        assert type(found) is type(kept)


def test_error_on_an_unknown_choice_lists_the_choices() -> None:
    with pytest.raises(OptionsError, match=f"one of: {', '.join(CHOICES['method'])}$"):
        Options(method="newton")  # type: ignore[arg-type]


def test_unknown_options_are_refused() -> None:
    with pytest.raises(TypeError, match="iterations"):
        Options(iterations=3)  # type: ignore[call-arg]
    with pytest.raises(TypeError):
        Options("inverse")  # type: ignore[misc]


@pytest.mark.parametrize("control", [[1, 2, 3], np.zeros((40, 3))])
def test_initial_control_is_a_copy(control: object) -> None:
    given = np.array(control, dtype=np.float64)
    options = Options(initial_control=given)
    kept = given.copy()
    given[:] = 9.0
    for item in (options, pickle.loads(pickle.dumps(options))):
        np.testing.assert_array_equal(item.initial_control, kept)
        with pytest.raises(ValueError, match="read-only"):
            item.initial_control[0] = 1.0


def test_options_are_immutable_and_equal_by_value() -> None:
    options = Options(initial_control=[1, 2, 3], intervals=30)  # type: ignore[arg-type]
    with pytest.raises(FrozenInstanceError):
        options.intervals = 5  # type: ignore[misc]
    assert options == Options(initial_control=np.array([1.0, 2.0, 3.0]), intervals=30)
    assert hash(options) == hash(replace(options))
    assert options != replace(options, intervals=31)
    assert options != replace(options, initial_control=None)
    assert pickle.loads(pickle.dumps(options)) == options
    assert Options() == Options()


def test_replaced_options_are_checked_again() -> None:
    with pytest.raises(OptionsError, match="intervals is 2"):
        replace(Options(), intervals=2)
