"""The live page's model: requests, their problems, and the Python code shown for them.

Also the texts and pictures that the page makes of an outcome.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from tominpmp.app import pictures, stage
from tominpmp.app.controller import Controller
from tominpmp.app.first_request import first_request, known, tool_frame
from tominpmp.app.planning import BindingLimit, Outcome, ShownMotion
from tominpmp.app.request import (
    Request,
    RobotChoice,
    follows_datasheet,
    group_names,
    loaded,
    new_item,
    placed,
    resized,
    sizes_of,
)
from tominpmp.bounds.result import LowerBound
from tominpmp.exceptions import (
    RobotLoadError,
    SceneError,
    TominpmpError,
)
from tominpmp.scene.obstacles import Box, Capsule, Cylinder, Sphere
from tominpmp.viz.playback import build_page
from tominpmp.viz.shares import Shares
from tominpmp.viz.surfaces import robot_bodies
from tominpmp.viz.surroundings import GOAL_RGB, START_RGB

PLANAR = first_request(known("planar3r"))
TURNED = (0.0, 0.0, 0.382683, 0.92388)
QUARTER = (0.0, 0.0, 0.5**0.5, 0.5**0.5)
ALL_KINDS = (
    Box("crate", size=(0.3, 0.2, 0.1), position=(-3.0, -2.0, 0.0), rotation=TURNED),
    Sphere("ball", radius=0.2, position=(-3.0, 2.0, 0.5)),
    Cylinder("can", radius=0.1, length=0.4, position=(-4.0, 0.0, 0.0)),
    placed(Capsule('a "quoted" name', radius=0.1, length=0.4), (-5, 0, 0), TURNED),
)
REQUESTS = {
    "as it is": PLANAR,
    "kinds of obstacles": replace(PLANAR, items=ALL_KINDS),
    "limits": replace(
        PLANAR, effort_scale=0.8, speed_scale=0.5, acceleration=12.0, margin=0.01
    ),
    "a position": replace(PLANAR, goal="position"),
    "a pose": replace(PLANAR, goal="pose"),
    "points on the way": replace(PLANAR, via=((3.0, 2.5, 0.0), (4.5, 2.0, 0.0))),
    "a way to a position": replace(PLANAR, via=((3.0, 2.5, 0.0),), goal="position"),
    "no dynamics": first_request(replace(PLANAR.robot, kinematic=True)),
    "a locked joint": Request(
        robot=RobotChoice("planar3r", locked=(("joint3", -1.0),)),
        frame="tip",
        q_start=(0.5, 0.5),
        q_goal=(0.9, 1.0),
    ),
}


@pytest.mark.parametrize("request_", REQUESTS.values(), ids=REQUESTS)
def test_python_code_of_a_request_makes_the_same_problem(request_: Request) -> None:
    names: dict[str, object] = {}
    head, _, plan = request_.python().partition("solution = ")
    exec(head, names)
    assert names["problem"] == request_.problem()
    assert plan == "tm.plan(problem)\nprint(solution.message)\n"


def test_different_requests_have_different_python_code() -> None:
    lines = {request.python() for request in REQUESTS.values()}
    assert len(lines) == len(REQUESTS)


def test_scales_and_margin_of_a_request_reach_the_problem() -> None:
    problem = REQUESTS["limits"].problem()
    plain = PLANAR.problem()
    assert problem.margin == 0.01
    assert problem.motion_limits is not None
    assert problem.motion_limits.effort_scale == 0.8
    speeds = problem.robot.limits.velocity / plain.robot.limits.velocity
    np.testing.assert_allclose(speeds, 0.5)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"q_goal": (0.0, 0.0)}, "goal"),
        ({"q_start": (np.nan, 0.0, 0.0)}, "q_start"),
        ({"effort_scale": 2.0}, "effort_scale"),
        ({"speed_scale": 0.0}, "velocity"),
        ({"margin": -1.0}, "margin"),
    ],
)
def test_invalid_request_value_is_named_in_the_error(
    changes: dict[str, object], field: str
) -> None:
    with pytest.raises(TominpmpError) as caught:
        replace(PLANAR, **changes).problem()  # type: ignore[arg-type]
    assert field in str(caught.value)


def test_invalid_obstacle_is_named_in_the_error() -> None:
    with pytest.raises(SceneError, match="ball"):
        resized(Sphere("ball", radius=0.2), [0.0])


def test_new_obstacles_have_distinct_names_and_rounded_placements() -> None:
    first = new_item("box", (1, 2, 3), ())
    second = new_item("box", (1, 2, 3), (first.name,))
    assert (first.name, second.name) == ("box1", "box2")
    moved = placed(first, (1.00004, 0, 0), (0, 0, 0, -1.0))
    assert moved.position.tolist() == [1.0, 0.0, 0.0]
    assert "rotation" not in replace(PLANAR, items=(moved,)).python()


def test_sizes_of_obstacles_have_names_and_can_be_changed() -> None:
    crate, _, can, _ = ALL_KINDS
    assert sizes_of(crate) == {"x": 0.3, "y": 0.2, "z": 0.1}
    assert sizes_of(can) == {"radius": 0.1, "length": 0.4}
    assert sizes_of(resized(crate, [1.0, 2.0, 3.0])) == {"x": 1.0, "y": 2.0, "z": 3.0}
    assert resized(can, [0.2, 0.5]) == replace(can, radius=0.2, length=0.5)


@pytest.mark.parametrize("name", ["planar3r", "so100"])
def test_first_request_moves_the_robot_and_a_frame_of_it(name: str) -> None:
    request = first_request(known(name))
    robot = loaded(request.robot)
    assert request.frame in robot.frame_names
    problem = request.problem()
    assert np.max(np.abs(problem.q_start - np.array(request.q_goal))) > 0.1


def test_tool_frame_is_a_frame_with_the_name_of_a_tool() -> None:
    assert tool_frame(loaded(known("planar3r"))) == "tip"
    arm = Path(__file__).parents[2] / "docs" / "static" / "arm.urdf"
    assert tool_frame(loaded(known(str(arm)))) == "tool"


def test_ghosts_of_start_and_goal_have_different_sizes() -> None:
    """Regression: the ghosts of start and goal showed stripes of both colours.

    Their surfaces coincided.
    """
    drawn: dict[str, Any] = {}
    scene = SimpleNamespace(
        add_frame=lambda name, **_: SimpleNamespace(),
        add_mesh_simple=lambda name, *_, **look: drawn.update({name: look}),
    )
    robot = loaded(known("planar3r"))
    bodies = robot_bodies(robot)
    stage.Arm(scene, "/q_start", robot, bodies, START_RGB)
    stage.Arm(scene, "/q_goal", robot, bodies, GOAL_RGB)
    sizes = {name.split("/")[1]: look["scale"] for name, look in drawn.items()}
    assert 1.0 < sizes["q_start"] < sizes["q_goal"] < 1.05


def test_unknown_robot_or_too_many_joints_are_named_in_the_error() -> None:
    with pytest.raises(RobotLoadError, match="nobody"):
        first_request(known("nobody"))
    with pytest.raises(RobotLoadError, match="joints that move, expected 16 at most"):
        first_request(known("tiago"))


def test_first_request_of_a_humanoid_moves_its_first_group() -> None:
    """Regression: a robot with too many joints was refused, and offered no group.

    The message advised the user to choose a group.
    """
    request = first_request(known("talos"))
    assert request.robot.group == group_names("talos")[0] == "r_leg"
    assert len(request.q_start) == 6
    assert request.frame == "right_sole_link"


def test_file_without_urdf_is_named_in_the_error(tmp_path: Path) -> None:
    path = tmp_path / "photo.urdf"
    path.write_bytes(b"\x89PNG not a robot")
    with pytest.raises(TominpmpError, match=r"photo\.urdf"):
        first_request(RobotChoice(str(path)))


def test_request_knows_groups_and_datasheet_limits_of_robots() -> None:
    assert "arm" in group_names("panda")
    assert group_names("planar3r") == ("arm",)
    assert group_names("ur3") == ()
    panda = known("panda")
    assert follows_datasheet(panda) is True
    assert follows_datasheet(replace(panda, limits="urdf")) is False
    assert follows_datasheet(known("planar3r")) is None
    path = str(loaded(panda).urdf_path)
    assert follows_datasheet(RobotChoice(path)) is False
    assert follows_datasheet(RobotChoice(path, limits="datasheet")) is True


@pytest.mark.parametrize("limits", [None, "urdf", "datasheet"])
def test_loaded_robot_has_the_limits_that_the_page_shows(limits: str | None) -> None:
    """Regression: the page planned a Panda with the limits of its URDF file alone."""
    choice = replace(known("panda"), limits=limits)
    has_accelerations = loaded(choice).motion_limits is not None
    assert has_accelerations == follows_datasheet(choice)
    assert ("limits" in first_request(choice).python()) == (limits is not None)


def test_requested_acceleration_limit_raises_no_limit_of_the_robot() -> None:
    """Regression: the requested acceleration limit replaced the limits of the robot.

    A UR5 with a requested limit was faster than a UR5 without it.
    """
    request = replace(first_request(known("ur5")), acceleration=15.0)
    own, names = (
        loaded(request.robot).motion_limits,
        request.problem().robot.joint_names,
    )
    for bound in (15.0, 1.0):
        problem = replace(request, acceleration=bound).problem()
        assert own is not None and problem.motion_limits is not None
        np.testing.assert_allclose(
            problem.motion_limits.by_joint("acceleration", names),
            np.minimum(own.by_joint("acceleration", names), bound),
        )


def test_kinematic_robot_without_datasheet_gets_acceleration_limit() -> None:
    own = first_request(replace(known("so100"), limits="urdf", kinematic=True))
    assert own.acceleration == 15.0
    makers = first_request(replace(known("so100"), kinematic=True))
    assert makers.acceleration is None
    for request in (own, makers):
        assert request.problem().robot.kinematic


@pytest.mark.parametrize("kinematic", [False, True])
def test_configuration_follows_a_handle_and_the_miss_beyond_reach_is_reported(
    kinematic: bool,
) -> None:
    """Regression: a robot without known acceleration limits had no handles."""
    request = replace(PLANAR, robot=replace(PLANAR.robot, kinematic=kinematic))
    assert (loaded(request.robot).motion_limits is None) and not request.turns
    controller = Controller(request, print, planning=lambda _: MagicMock())
    position, quaternion = request.pose(request.q_goal)
    aim = position + np.array([0.05, 0.1, 0.0])
    assert controller.drag("q_goal", aim, quaternion) == ""
    found, _ = request.pose(controller.request.q_goal)
    np.testing.assert_allclose(found, aim, atol=1e-3)
    miss = controller.drag("q_goal", np.array([50.0, 0.0, 0.0]), quaternion)
    assert re.fullmatch(r"4\d\.\d+ m", miss)


def test_handles_turn_the_tool_of_an_arm_with_six_joints() -> None:
    request = first_request(known("ur5"))
    controller = Controller(request, print, planning=lambda _: MagicMock())
    position, quaternion = request.pose(request.q_goal)
    turned = quaternion + np.array([0.0, 0.0, 0.05, 0.0])
    turned = turned / np.linalg.norm(turned)
    assert request.turns and controller.drag("q_goal", position, turned) == ""
    place, turn = request.pose(controller.request.q_goal)
    np.testing.assert_allclose(place, position, atol=1e-3)
    assert abs(turn @ turned) == pytest.approx(1.0, abs=1e-6)


def test_first_request_of_continuous_joints_is_finite() -> None:
    """Regression: infinite position limits led to a warning about invalid values."""
    choice = RobotChoice("kinova")
    assert np.any(np.isinf(loaded(choice).limits.position_upper))
    assert np.all(np.isfinite(first_request(choice).q_start))


def shown(**changes: object) -> ShownMotion:
    t = np.linspace(0.0, 2.0, 241)
    share = np.sin(np.pi * t / 2.0)[:, None] * [1.0, 0.5]
    values = {
        "verified": True,
        "bound": LowerBound(1.6, "speed"),
        "seconds": 0.1,
        "joint_names": ("arm_joint1", "arm_<b>"),
        "t": t,
        "q": share,
        "speed": share,
        "torque": -share,
        "path": np.zeros((241, 3)),
        "active": (BindingLimit("speed of arm_joint1", 0.5, 0.7),),
        "solution": b"",
    }
    return ShownMotion(**(values | changes))  # type: ignore[arg-type]


def outcome(found: ShownMotion | None, message: str = "it was found") -> Outcome:
    return Outcome(PLANAR, message, found)


def test_headline_shows_duration_verification_and_lower_bound() -> None:
    text = pictures.headline(outcome(shown()), busy=False)
    assert "2.000 s" in text
    assert "verified" in text
    assert "25.0 % above the lower bound, 1.600\N{NO-BREAK SPACE}s" in text
    assert "planning" in pictures.headline(outcome(shown()), busy=True)
    for bound in (None, LowerBound(0.99, "speed")):
        text = pictures.headline(outcome(shown(bound=bound)), busy=False)
        assert "no useful bound" in text and "0.99" not in text
    refused = pictures.headline(outcome(None, "start <in> collision"), busy=False)
    assert "No motion" in refused
    assert "&lt;in&gt;" in refused


def test_bars_and_curves_are_red_at_the_limit_and_escape_names() -> None:
    text = pictures.bars(shown(), 1.0)
    assert text.count(pictures.HOT) == 2  # speed and torque of the first joint
    assert "<b>" not in text
    assert pictures.HOT not in pictures.bars(shown(), 0.0)
    assert pictures.HOT in pictures.curves(shown())
    assert pictures.HOT not in pictures.curves(
        shown(speed=0 * shown().speed, torque=0 * shown().speed)
    )


def test_torque_and_speed_have_the_colours_of_the_motion_pages() -> None:
    """Regression: only the names agreed, the colours did not.

    Orange was the torque on the live page, and the speed on the pages of motions.
    """
    found = shown()
    page = build_page(
        [],
        title="",
        caption="",
        rate=1.0,
        shares=Shares(tuple(found.joint_names), found.t, found.torque, found.speed),
    )
    for word in ("torque", "speed"):
        label = rf'style="color:(#\w{{6}})[^>]*>{word}<'
        colors = {
            match[1]
            for text in (page, pictures.bars(found, 0.0))
            if (match := re.search(label, text))
        }
        assert len(colors) == 1
        (color,) = colors
        assert f'shares.{word}[k], "{color}"' in page  # the curve
        assert f'stroke="{color}"' in pictures.curves(found)


def test_short_names_drop_the_common_parts_of_joint_names() -> None:
    names = [f"panda_joint{i}" for i in range(1, 4)]
    assert pictures.short_names(names) == ["joint1", "joint2", "joint3"]
    assert pictures.short_names(["only"]) == ["only"]
    assert pictures.short_names(["elbow_joint", "wrist_joint"]) == ["elbow", "wrist"]


def test_active_limits_are_shown_with_their_share_and_gain() -> None:
    text = pictures.active_limits(shown().active, "it is <optimal>")
    assert "50 % of the time" in text
    assert "0.70 % less time" in text
    assert "&lt;optimal&gt;" in text
    assert "nothing" in pictures.active_limits((), "")


@pytest.mark.parametrize(("turn", "along"), [((0.0, 0.0, 0.0, 1.0), 0), (QUARTER, 1)])
def test_camera_placement_regards_the_rotation_of_obstacles(
    turn: tuple[float, ...], along: int
) -> None:
    """A long beam about the origin is in the middle of the picture along its axis."""
    beam = Box("beam", size=(20.0, 0.1, 0.1), rotation=turn)
    request = replace(PLANAR, items=(beam,))
    server = MagicMock()
    server.initial_camera = camera = SimpleNamespace()
    server.get_clients.return_value = {}
    stage.look_at(server, loaded(request.robot), request)
    assert camera.look_at[along] == pytest.approx(0.0, abs=1e-9)
    assert abs(camera.look_at[1 - along]) > 1.0
