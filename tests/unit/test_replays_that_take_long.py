"""Replays of slow motions end in time, and several threads may replay at once."""

from __future__ import annotations

import importlib
import sys
import threading

import numpy as np
import pytest
from optimum_cases import HANGING, ROD
from replays import replay
from sample_arms import DOWNWARD, make_arm

import tominpmp as tm
from tominpmp.stopping import Stop

# The module; the package has a function of the same name.
REPLAYS = importlib.import_module("tominpmp.verification.replay")
INTEGRATORS = ("LSODA", "DOP853", "Radau")


@pytest.fixture(scope="module")
def swinging() -> tuple[tm.Problem, tm.Trajectory]:
    """A pendulum that swings freely for ten seconds, in one interval of torque."""
    robot = make_arm(ROD, effort=1.0, gravity=DOWNWARD)
    problem = tm.Problem(robot, [HANGING + 2.0], tm.JointGoal([HANGING]))
    t, none = np.array([0.0, 10.0]), np.zeros((2, 1))
    return problem, tm.Trajectory(("joint1",), t, none, none, none)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_replay_stops_within_an_interval(swinging, integrator, monkeypatch) -> None:
    calls = []

    def check() -> None:
        calls.append(1)
        if len(calls) > 2:
            raise Stop(requested=False)

    monkeypatch.setattr(REPLAYS, "check", check)
    with pytest.raises(Stop):
        replay(*swinging, integrator=integrator)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_replay_is_abandoned_within_an_interval(
    swinging, integrator, monkeypatch
) -> None:
    most = 2 * REPLAYS.WATCH
    monkeypatch.setattr(REPLAYS, "MAX_EVALUATIONS", most)
    found = replay(*swinging, integrator=integrator)
    assert not found.complete
    assert np.all(np.isfinite(found.q))
    assert most < found.evaluations <= most + REPLAYS.WATCH


def test_lsoda_is_called_by_one_thread_at_a_time(swinging, monkeypatch) -> None:
    inside, most = [], []
    odeint = REPLAYS.odeint

    def watched(slope, *args, **kwargs):
        inside.append(1)
        most.append(len(inside))
        found = odeint(slope, *args, **kwargs)
        inside.pop()
        return found

    monkeypatch.setattr(REPLAYS, "odeint", watched)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        many = [threading.Thread(target=tm.verify, args=swinging) for _ in range(4)]
        for one in many:
            one.start()
        for one in many:
            one.join()
    finally:
        sys.setswitchinterval(interval)
    assert max(most) == 1


def refusing(*_args, **_options):
    raise REPLAYS.ODEintWarning("Illegal input detected (internal error).")


def test_arm_at_rest_is_replayed_although_lsoda_refuses(monkeypatch) -> None:
    """Regression: with dry friction the search for rows raised an IndexError."""
    robot = make_arm(ROD, effort=1.0, friction=0.5)
    problem = tm.Problem(robot, [0.0], tm.JointGoal([0.0]))
    t, none = np.array([0.0, 0.1]), np.zeros((2, 1))
    monkeypatch.setattr(REPLAYS, "odeint", refusing)
    found = replay(problem, tm.Trajectory(("joint1",), t, none, none, none))
    assert found.complete and not found.q.any()


def test_interval_that_lsoda_refuses_is_integrated_step_by_step(
    swinging, monkeypatch
) -> None:
    """Regression: without dry friction a valid motion of 28 segments had no replay."""
    whole = replay(*swinging)
    monkeypatch.setattr(REPLAYS, "odeint", refusing)
    found = replay(*swinging)

    assert whole.complete and found.complete
    np.testing.assert_allclose(found.q[-1], whole.q[-1], atol=1e-7)
