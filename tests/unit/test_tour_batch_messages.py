"""Mistakes in tours and batches: messages that were missing or misleading."""

from __future__ import annotations

import threading
import warnings

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.cell.batch.executor import Executor

HOME = (0.5, 1.7, -1.7)


@pytest.fixture(scope="module")
def robot() -> tm.Robot:
    return tm.load_robot("planar3r", gravity=(0, 0, 0))


def at(x: float, y: float) -> tm.Goal:
    return tm.PositionGoal("tip", (x, y, 0.0))


def test_joint_goal_of_wrong_length_names_the_station(robot: tm.Robot) -> None:
    with pytest.raises(tm.ProblemError, match=r"2 \('b'\): goal\.q has 2 numbers"):
        tm.plan_tour(robot, HOME, {"a": at(4, 1), "b": tm.JointGoal((1.0, 1.0))})


def test_stations_that_differ_by_rounding_are_one_place(robot: tm.Robot) -> None:
    stations = {"a": at(4, 0.3), "b": at(4, 0.1 + 0.2)}
    assert stations["a"] != stations["b"]
    with pytest.raises(tm.ProblemError, match=r"\('a'\) and .* \('b'\) are in one"):
        tm.plan_tour(robot, HOME, stations)


def test_unknown_name_in_may_touch_names_the_station(robot: tm.Robot) -> None:
    part = tm.Box("part", size=(0.1, 0.1, 0.1))
    load = tm.Payload(0.1, "tip", geometry=[part], name="part")
    stations = [
        tm.Station("pick", at(4, 1), payload=load, may_touch=[("part", "tables")]),
        tm.Station("put", at(3, 2)),
    ]
    table = tm.Scene([tm.Box("table", size=(1, 1, 0.1), position=(9, 9, 0))])
    match = (
        r"station 1 \('pick'\): may_touch: 'tables' is neither .*mean table\?\)"
        r"; there are: .*part.*table"
    )
    with pytest.raises(tm.ProblemError, match=match):
        tm.plan_tour(robot, HOME, stations, scene=table)


def test_plan_many_reports_an_entry_that_is_no_problem() -> None:
    (outcome,) = tm.plan_many([None], workers=1)
    assert outcome.message.startswith("the problem is None, expected a Problem")


def test_backend_dask_needs_a_client(robot: tm.Robot) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of other packages, on their first import
        distributed = pytest.importorskip("distributed")
    problem = tm.Problem(robot, HOME, tm.JointGoal(np.add(HOME, 0.1)))
    with pytest.raises(tm.ProblemError, match="first create a Dask Client"):
        tm.plan_many([problem], backend="dask")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cluster = distributed.LocalCluster(
            n_workers=1, processes=False, dashboard_address=None
        )
        with cluster, distributed.Client(cluster):
            quick = {"intervals": 8, "refine": None, "effort": "quick"}
            (outcome,) = tm.plan_many([problem], backend="dask", **quick)
    assert outcome.success


def test_backend_configured_at_construction_runs_the_work() -> None:
    joblib = pytest.importorskip("joblib")
    with joblib.parallel_config("threading", n_jobs=2):
        executor = Executor(in_main_thread, None, None)
    work = iter([(number, number) for number in range(4)])
    assert not any(main for _, main in executor.results(work))
    assert executor.workers == 2


def in_main_thread(number: int, _: int) -> tuple[int, bool]:
    return number, threading.current_thread() is threading.main_thread()


def test_backend_without_its_package_is_named(
    robot: tm.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(tm.ProblemError, match="backend is 'ray', which cannot be used"):
        tm.plan_many([], backend="ray")


def test_legend_of_many_joints_fits_the_figure() -> None:
    pytest.importorskip("matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from tominpmp.viz.figures import add_legend, new_figure, styled

    with styled():
        figure = new_figure(8.0, 3.0)
        names = [f"{arm}/shoulder_lift_joint" for arm in ("left", "right") * 6]
        panel = figure.add_subplot()
        for name in names:
            panel.plot([], [], label=name)
        add_legend(figure, 6)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        box = figure.legends[0].get_window_extent(canvas.get_renderer())
        assert box.x0 >= 0.0 and box.x1 <= figure.bbox.width


def test_message_about_after_lists_the_other_stations(robot: tm.Robot) -> None:
    alone = [tm.Station("a", at(4, 1), after=("z",))]
    with pytest.raises(
        tm.ProblemError, match=r"after: there is no other station 'z'; .* none"
    ):
        tm.plan_tour(robot, HOME, alone)
    two = [*alone, tm.Station("b", at(3, 2))]
    with pytest.raises(tm.ProblemError, match="there are: b"):
        tm.plan_tour(robot, HOME, two)


def test_unknown_backend_is_rejected() -> None:
    with pytest.raises(tm.ProblemError, match=r"'nowhere'.*\(joblib does not know it"):
        tm.plan_many([], backend="nowhere")
