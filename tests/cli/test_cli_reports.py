"""Robot files of users' bug reports, planned by the command line.

Each folder of ``tests/reports`` has the files of one report; the table has the command
that was run there, and its expected result.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from cli_samples import Run

REPORTS = Path(__file__).parents[1] / "reports"
MOVE = "--start 0 0.1 --goal 0.5 0.6"


@dataclass(frozen=True)
class Report:
    """A command and its expected result.

    Attributes:
        words: The command after ``tominpmp plan``.
        T: Duration of the written motion [s]; None if the command ends with exit
            code 2.
        says: Part of the output.
        later: Reason for which the report is still expected to fail.
    """

    words: str
    T: float | None
    says: str = ""
    later: str = ""


TABLE = {
    "continuous_across_pi": Report(
        "robot.urdf --start 3.0 0.1 --goal -3.0 0.4",
        0.151,
        "j1 a turn above the number given",
    ),
    "file_uri_of_another_machine": Report(
        f"my_arm_description/urdf/robot.urdf --package-dir . {MOVE}", 0.2525
    ),
    "joint_limits_degrees_tag": Report(
        f"robot.urdf {MOVE} --joint-limits joint_limits.yaml", 0.4779
    ),
    "kinematic_no_effort_no_inertia": Report(
        f"robot.urdf {MOVE} --joint-limits joint_limits.yaml --kinematic",
        0.70711,
    ),
    "link_and_joint_of_one_name_lock": Report(
        "robot.urdf --lock j1=0.2 --start 0.1 --goal 0.6", 0.25
    ),
    "mesh_fine_cylinder_link": Report(
        f"robot.urdf {MOVE} --obstacle box:b:size=0.1,0.1,0.1:at=1,1,1", 0.2525
    ),
    "moveit_scene_text": Report(f"robot.urdf {MOVE} --scene desk.scene", 0.2525),
    "negative_inertia_planned": Report(f"robot.urdf {MOVE}", None, "l2"),
    "scene_in_millimetres": Report(
        f"robot.urdf {MOVE} --obstacle box:table:size=1000,1000,50:at=600,0,-100",
        0.2525,
        "obstacle 'table' is 1000 m across, as if it were in millimetres",
    ),
    "xacro_without_ros": Report(
        f"my_arm_description/urdf/arm.urdf.xacro --package-dir . {MOVE}",
        0.2525,
    ),
    "zero_box_on_root": Report(
        f"robot.urdf {MOVE}", 0.2525, "shapes of no size are left out: link base"
    ),
    "zero_box_visual": Report(
        f"robot.urdf {MOVE}", 0.2525, "shapes of no size are left out: link base"
    ),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name,
            marks=[pytest.mark.xfail(strict=True, reason=report.later)]
            if report.later
            else [],
        )
        for name, report in TABLE.items()
    ],
)
def test_reported_files_have_their_expected_result(
    run: Run, tmp_path: Path, name: str
) -> None:
    shutil.copytree(REPORTS / name, tmp_path, dirs_exist_ok=True)
    report = TABLE[name]
    result = run("plan", *report.words.split(), "-o", "out.csv")
    assert report.says in result.output
    if report.T is None:
        assert result.exit_code == 2
        return
    assert result.exit_code == 0
    rows = np.loadtxt("out.csv", delimiter=",", skiprows=1)
    assert rows[-1, 0] == pytest.approx(report.T, rel=0.02)


def test_every_folder_of_reports_is_in_the_table() -> None:
    assert {path.name for path in REPORTS.iterdir()} == set(TABLE)
