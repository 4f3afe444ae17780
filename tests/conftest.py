"""Fixtures and settings for all tests."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path

import numpy as np
import pytest
from clocks import Clock
from hypothesis import settings

from tominpmp.options import TIME_LIMITS
from tominpmp.robot.robot import Robot, load_robot

# Figures are drawn without a screen.
os.environ.setdefault("MPLBACKEND", "Agg")

# The same examples on every run, however slow the machine.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")


# Time limits that slow machines, with several tests at a time, do not reach.
for _effort in TIME_LIMITS:
    TIME_LIMITS[_effort] *= 10.0

# Node ids of the longest tests, often some cases of a parametrised test: only
# `make test-all` runs them.
NIGHTLY = Path(__file__).with_name("nightly.txt").read_text("utf-8").splitlines()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the longest tests before pytest deselects marked tests."""
    long = set(NIGHTLY)
    for item in items:
        if item.nodeid in long:
            item.add_marker(pytest.mark.nightly)


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator whose draws a test must hold for, whatever the seed.

    The seed does not depend on the test's name, so that a renamed test keeps its data.
    """
    return np.random.default_rng(int(os.environ.get("TOMINPMP_TEST_SEED", "0")))


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """A clock that stands still, in place of the clock of the library."""
    found = Clock()
    monkeypatch.setattr(time, "perf_counter", found)
    # Times that another clock has shown cannot be compared with times of this clock.
    monkeypatch.setattr("tominpmp.initial_guess.parallel._idle_since", -math.inf)
    return found


@pytest.fixture(scope="session")
def planar3r() -> Robot:
    """The paper's arm: three joints in a vertical plane."""
    return load_robot("planar3r")


@pytest.fixture(scope="session")
def ur5() -> Robot:
    """An industrial arm with six joints."""
    return load_robot("ur5", limits="urdf")
