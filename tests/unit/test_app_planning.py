"""The live page's planning: outcomes, warm starts, superseded requests, the worker."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from queue import SimpleQueue

import numpy as np
import pytest

from tominpmp.app.controller import Controller
from tominpmp.app.first_request import first_request, known
from tominpmp.app.planning import LEAST_GAIN, LEAST_SHARE, Outcome, Session
from tominpmp.app.request import Request
from tominpmp.app.worker import Jobs, Worker, work
from tominpmp.exceptions import ProblemError, RobotLoadError

# The arm without the obstacle: quick to plan.
PLANAR = replace(first_request(known("planar3r")), items=())
NEAR = replace(PLANAR, q_goal=(0.95, -1.2, -0.85))


@pytest.fixture(scope="module", autouse=True)
def unlimited_time() -> Iterator[None]:
    """Planning takes as long as it needs: outcomes do not depend on the machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tominpmp.app.planning.MOST_SECONDS", 1e6)
        yield


def verified(outcome: Outcome) -> bool:
    """Whether there is a motion that keeps all limits."""
    return outcome.shown is not None and outcome.shown.verified


def never() -> bool:
    return False


@pytest.fixture(scope="module")
def session() -> Session:
    return Session()


@pytest.fixture(scope="module")
def first(session: Session) -> list[Outcome]:
    return list(session.outcomes(PLANAR, never))


@pytest.fixture(scope="module")
def second(session: Session, first: list[Outcome]) -> list[Outcome]:
    return list(session.outcomes(NEAR, never))


def test_verified_motion_comes_first_and_its_active_limits_second(
    first: list[Outcome],
) -> None:
    assert [outcome.final for outcome in first] == [False, True]
    assert all(verified(outcome) for outcome in first)
    shown = first[-1].shown
    assert shown is not None
    np.testing.assert_allclose(shown.q[0], PLANAR.q_start, atol=1e-3)
    np.testing.assert_allclose(shown.q[-1], PLANAR.q_goal, atol=1e-3)
    # The paper's arm is held by its torques alone, and they are at their limits.
    assert np.max(np.abs(shown.torque)) == pytest.approx(1.0, abs=0.02)
    assert any(limit.name.startswith("torque of joint") for limit in shown.active)
    assert sum(limit.gain or 0.0 for limit in shown.active) > 0.2
    for limit in shown.active:
        assert limit.share > LEAST_SHARE or (limit.gain or 0.0) >= LEAST_GAIN
    assert "first-order" in shown.optimality


def test_next_request_is_planned_from_a_warm_start_and_afresh(
    first: list[Outcome], second: list[Outcome]
) -> None:
    assert [outcome.final for outcome in second] == [False, False, True]
    assert all(outcome.request == NEAR for outcome in second)
    begun, ended = first[-1].shown, second[-1].shown
    assert begun is not None
    assert ended is not None
    np.testing.assert_allclose(ended.q[-1], NEAR.q_goal, atol=1e-3)
    assert second[0].shown is not None
    assert ended.T <= second[0].shown.T


def test_motion_with_a_via_point_passes_it_and_has_active_limits() -> None:
    past = replace(PLANAR, via=((3.5, 2.5, 0.0),))
    outcomes = list(Session().outcomes(past, never))
    assert [verified(outcome) for outcome in outcomes] == [True, True]
    shown = outcomes[-1].shown
    assert shown is not None
    misses = np.linalg.norm(shown.path - past.via[0], axis=1)
    assert np.min(misses) < 0.05  # between two of the instants that are shown
    assert any(limit.name.startswith("torque of joint") for limit in shown.active)


def test_session_switches_between_kinematic_and_dynamic_robot() -> None:
    """Regression: the warm start failed with "values that are no numbers"."""
    session, kinds = Session(), []
    for kinematic in (True, False):
        robot = replace(PLANAR.robot, kinematic=kinematic)
        request = replace(PLANAR, robot=robot, acceleration=15.0)
        *_, last = session.outcomes(request, never)
        assert verified(last), last.message
        kinds.append(last.shown.control)
    assert kinds == ["acceleration", "torque"]


def test_superseded_request_yields_no_outcome(session: Session, second: object) -> None:
    before = session.solution
    looks = []

    def superseded() -> bool:
        looks.append(1)
        return len(looks) > 2

    assert list(session.outcomes(PLANAR, superseded)) == []
    assert len(looks) == 3
    assert session.solution is before


def test_invalid_request_is_reported_and_the_last_motion_stays(
    session: Session, second: object
) -> None:
    before = session.solution
    refused = replace(PLANAR, effort_scale=1e9)
    outcomes = list(session.outcomes(refused, never))
    assert [verified(outcome) for outcome in outcomes] == [False]
    assert "effort_scale" in outcomes[0].message
    assert session.solution is before


def test_export_writes_the_motion_and_checks_the_file(
    controller: Controller, second: list[Outcome]
) -> None:
    with pytest.raises(ProblemError, match="no motion to export"):
        controller.export(".csv", 0.01)
    take = recorder(controller).on_outcome
    for outcome in (*second, Outcome(NEAR, "no motion for this")):
        take(outcome)
    name, content, remark = controller.export(".csv", 0.01)
    assert name == "planar3r_motion.csv"
    assert content.startswith(b"time")
    assert remark


class ScriptedSession:
    """A session that yields three outcomes for every request, without planning."""

    def __init__(self, jobs: Jobs) -> None:
        self.jobs, self.seen = jobs, list[tuple[Request, int]]()

    def outcomes(
        self, request: Request, superseded: Callable[[], bool]
    ) -> Iterator[Outcome]:
        for step in range(3):
            self.seen.append((request, step))
            if request == PLANAR:
                self.jobs.put(NEAR)
            yield Outcome(request, "found", None, step == 2)
        self.jobs.put(None)


def test_worker_drops_a_superseded_request_after_its_first_motion() -> None:
    jobs: Jobs = SimpleQueue()
    script, answers = ScriptedSession(jobs), list[Outcome]()
    for request in (NEAR, PLANAR):
        jobs.put(request)
    work(script, jobs, answers.append)  # type: ignore[arg-type]
    assert script.seen == [(PLANAR, 0), (NEAR, 0), (NEAR, 1), (NEAR, 2)]
    assert [outcome.request for outcome in answers] == [PLANAR, NEAR, NEAR, NEAR]


class Recorder:
    """Planning that only records its requests."""

    def __init__(self, on_outcome: Callable[[Outcome], None]) -> None:
        self.on_outcome = on_outcome
        self.requests: list[Request] = []

    def plan(self, request: Request) -> None:
        self.requests.append(request)

    def close(self) -> None:
        pass


@pytest.fixture
def received() -> list[Outcome]:
    return []


@pytest.fixture
def controller(received: list[Outcome]) -> Controller:
    return Controller(PLANAR, received.append, planning=Recorder)


def recorder(controller: Controller) -> Recorder:
    planning = controller._planning
    assert isinstance(planning, Recorder)
    return planning


def test_changed_request_is_planned_and_a_repeated_one_is_not(
    controller: Controller,
) -> None:
    controller.plan(PLANAR)
    controller.change(q_goal=NEAR.q_goal)
    controller.change(q_goal=NEAR.q_goal)
    controller.change(effort_scale=0.5)
    changed = replace(NEAR, effort_scale=0.5)
    assert recorder(controller).requests == [PLANAR, NEAR, changed]


def test_planning_is_busy_until_the_last_outcome_of_the_last_request(
    controller: Controller,
) -> None:
    controller.plan(PLANAR)
    controller.change(q_goal=NEAR.q_goal)
    take = recorder(controller).on_outcome
    for outcome in (Outcome(PLANAR, "old"), Outcome(NEAR, "new", final=False)):
        take(outcome)
        assert controller.busy
    take(Outcome(NEAR, "newer"))
    assert not controller.busy
    # Regression: the earlier outcome of an equal request counted as the last one.
    controller.change(q_goal=PLANAR.q_goal)
    controller.change(q_goal=NEAR.q_goal)
    assert controller.busy
    take(Outcome(PLANAR, "old"))
    assert controller.busy
    take(Outcome(NEAR, "newest"))
    assert not controller.busy


def test_motion_of_the_former_robot_is_not_exported(
    controller: Controller, received: list[Outcome], first: list[Outcome]
) -> None:
    """Regression: after a plan without a motion, the former robot's was exported."""
    controller.plan(PLANAR)
    take = recorder(controller).on_outcome
    take(first[0])
    controller.choose(replace(PLANAR.robot, kinematic=True))
    take(first[1])
    assert received == first[:1]
    assert controller.outcome is None
    with pytest.raises(ProblemError, match="no motion to export"):
        controller.export(".csv")


def test_dragged_goal_is_planned_by_inverse_kinematics(controller: Controller) -> None:
    position, quaternion = controller.request.pose(PLANAR.q_goal)
    aim = position + np.array([0.0, 0.2, 0.0])
    assert controller.drag("q_goal", aim, quaternion) == ""
    (request,) = recorder(controller).requests
    found, _ = controller.request.pose(request.q_goal)
    np.testing.assert_allclose(found, aim, atol=1e-3)
    miss = controller.drag("q_goal", [99.0, 0.0, 0.0], quaternion)
    assert 50.0 < float(miss.removesuffix(" m")) < 100.0


def test_unknown_robot_leaves_the_request_unchanged(controller: Controller) -> None:
    with pytest.raises(RobotLoadError, match="nobody"):
        controller.choose(known("nobody"))
    assert controller.request is PLANAR
    assert recorder(controller).requests == []


@pytest.mark.slow
def test_crashed_worker_process_is_replaced_and_plans() -> None:
    outcomes = list[Outcome]()
    final = threading.Event()

    def take(outcome: Outcome) -> None:
        outcomes.append(outcome)
        if outcome.final:
            final.set()

    worker = Worker(take)
    try:
        worker.plan(PLANAR)
        os.kill(worker._process.pid, signal.SIGKILL)
        assert final.wait(300.0)
        assert not verified(outcomes[-1])
        assert "ended unexpectedly" in outcomes[-1].message
        final.clear()
        worker.plan(NEAR)
        assert final.wait(600.0)
        assert outcomes[-1].request == NEAR
        assert verified(outcomes[-1])
    finally:
        worker.close()
    assert worker._process.exitcode is not None
