"""Finding robots by name or path, and the files that their descriptions refer to."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from robot_samples import (
    one_joint,
    one_shape,
    read,
    write,
    write_tetrahedron,
)

from tominpmp.description import files
from tominpmp.description.files import find_robot, resolve_resource, robot_names
from tominpmp.description.tree import UrdfDescription
from tominpmp.description.urdf import read_urdf
from tominpmp.exceptions import RobotLoadError

# Finding


def test_bundled_robot_is_found_by_name_with_its_srdf() -> None:
    found = find_robot("planar3r")
    assert found.urdf.name == "planar3r.urdf"
    assert found.srdf is not None and found.srdf.name == "planar3r.srdf"
    assert found.name == "planar3r"


@pytest.mark.parametrize(
    ("name", "urdf", "srdf"),
    [
        ("panda", "panda.urdf", "panda.srdf"),
        ("ur3", "ur3_robot.urdf", None),
        ("ur5", "ur5_robot.urdf", "ur5.srdf"),
        ("ur10", "ur10_robot.urdf", None),
        ("ur5_gripper", "ur5_gripper.urdf", "ur5_gripper.srdf"),
        ("ur5_limited", "ur5_joint_limited_robot.urdf", "ur5_joint_limited_robot.srdf"),
        ("kinova", "kinova.urdf", "kinova.srdf"),
        ("xarm7", "xarm7.urdf", "xarm7.srdf"),
        ("z1", "z1.urdf", "z1.srdf"),
        ("baxter", "baxter.urdf", "baxter_manipulation.srdf"),
        ("talos", "talos_reduced.urdf", "talos.srdf"),
        ("solo12", "solo12.urdf", "solo.srdf"),
        ("double_pendulum", "double_pendulum.urdf", None),
        ("so100", "so100.urdf", None),
    ],
)
def test_example_robots_have_the_names_of_their_loader(
    name: str, urdf: str, srdf: str | None
) -> None:
    found = find_robot(name)
    assert found.urdf.name == urdf
    assert (found.srdf and found.srdf.name) == srdf


def test_error_on_an_unknown_name_has_close_names_and_not_all_of_them() -> None:
    """Regression: the message listed ninety names."""
    with pytest.raises(
        RobotLoadError, match=r"did you mean .*panda.*path of a file"
    ) as e:
        find_robot("pandra")
    assert "tominpmp robots" in str(e.value) and "ur5" not in str(e.value)


def test_error_says_if_example_robots_are_not_installed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(files, "_example_folder", lambda: None)
    assert robot_names() == ("planar3r",)
    with pytest.raises(RobotLoadError, match="example-robot-data has more robots"):
        find_robot("panda")


def test_example_folder_lies_beside_the_packages(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder = tmp_path / "cmeel.prefix" / "share" / "example-robot-data" / "robots"
    folder.mkdir(parents=True)

    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    files._example_folder.cache_clear()
    try:
        assert files._example_folder() == folder
    finally:
        files._example_folder.cache_clear()


def test_bundled_robots_of_the_wheel_precede_a_checkout(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(files, "__file__", str(tmp_path / "a" / "tominpmp" / "d" / "f"))
    (tmp_path / "robots").mkdir()
    assert files._bundled_folder() == tmp_path / "robots"
    (tmp_path / "a" / "tominpmp" / "robots").mkdir(parents=True)
    assert files._bundled_folder() == tmp_path / "a" / "tominpmp" / "robots"


@pytest.mark.parametrize("value", ["", None, 3])
def test_value_that_is_neither_name_nor_path_is_refused(value: object) -> None:
    with pytest.raises(RobotLoadError, match="expected the name"):
        find_robot(value)  # type: ignore[arg-type]


def test_srdf_is_found_beside_the_urdf_and_in_the_folder_srdf(tmp_path: Path) -> None:
    urdf = write(tmp_path, one_joint(), "urdf/arm.urdf")
    assert find_robot(urdf).srdf is None
    other = write(tmp_path, "<robot/>", "srdf/arm.srdf")
    assert find_robot(urdf).srdf == other
    beside = write(tmp_path, "<robot/>", "urdf/arm.srdf")
    assert find_robot(urdf).srdf == beside
    above = write(tmp_path, one_joint(), "arms/arm.urdf")
    (tmp_path / "arms" / "urdf").mkdir()
    assert find_robot(above.parent / "urdf" / ".." / "arm.urdf").srdf == other


# Meshes


def mesh_file(description: UrdfDescription) -> str:
    (shape,) = (s for b in description.bodies for s in (*b.collisions, *b.visuals))
    return str(shape.file)


def mesh(filename: str, tag: str = "collision") -> str:
    return one_shape(f'<mesh filename="{filename}"/>', tag)


@pytest.mark.parametrize("tag", ["collision", "visual"])
@pytest.mark.parametrize(
    "filename",
    ["../meshes/a.obj", "package://pkg/meshes/a.obj", "package:///pkg/meshes/a.obj"],
)
def test_meshes_are_found_in_the_folders_above(
    tmp_path: Path, filename: str, tag: str
) -> None:
    expected = write_tetrahedron(tmp_path / "pkg" / "meshes" / "a.obj")
    path = write(tmp_path, mesh(filename, tag), "pkg/urdf/sample.urdf")
    assert mesh_file(read_urdf(path)) == str(expected)


def test_mesh_is_found_by_absolute_path_and_file_url(tmp_path: Path) -> None:
    expected = write_tetrahedron(tmp_path / "b c" / "a.obj")
    for filename in (f"{expected}", f"file://{expected}"):
        assert mesh_file(read(tmp_path, mesh(filename))) == str(expected)


def test_mesh_is_found_in_one_of_several_package_folders(tmp_path: Path) -> None:
    expected = write_tetrahedron(tmp_path / "two" / "pkg" / "a.obj")
    path = write(tmp_path, mesh("package://pkg/a.obj"), "here/sample.urdf")
    (tmp_path / "one").mkdir()
    found = read_urdf(path, [tmp_path / "one", tmp_path / "two"])
    assert mesh_file(found) == str(expected)
    # The folder of the package itself serves as well.
    assert mesh_file(read_urdf(path, [tmp_path / "two" / "pkg"])) == str(expected)


def test_mesh_is_found_in_a_checkout_of_another_name(tmp_path: Path) -> None:
    expected = write_tetrahedron(tmp_path / "checkout" / "a.obj")
    write(tmp_path, "<package/>", "checkout/package.xml")
    path = write(tmp_path, mesh("package://pkg/a.obj"), "checkout/urdf/sample.urdf")
    assert mesh_file(read_urdf(path)) == str(expected)


def test_packages_are_found_by_the_names_in_their_manifests(tmp_path: Path) -> None:
    expected = tmp_path / "maker" / "arms" / "a.obj"
    name = "package://maker_arms/a.obj"
    elsewhere = write(tmp_path, mesh(name), "else/where/sample.urdf")
    for folder in ("maker/arms", "maker/config"):
        write(
            tmp_path, f"<n><name>maker_{folder[6:]}</name></n>", f"{folder}/package.xml"
        )
    with pytest.raises(RobotLoadError, match="package_dirs"):
        read_urdf(elsewhere, [tmp_path])
    write_tetrahedron(expected)
    # In a given folder, in a folder within it, beside the robot's own package.
    for folder in (tmp_path / "maker", tmp_path):
        assert mesh_file(read_urdf(elsewhere, [folder])) == str(expected)
    beside = write(tmp_path, mesh(name), "maker/config/urdf/sample.urdf")
    assert mesh_file(read_urdf(beside)) == str(expected)


@pytest.mark.parametrize(
    ("variable", "below"), [("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")]
)
def test_mesh_is_found_in_the_folders_of_ros(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str, below: str
) -> None:
    expected = write_tetrahedron(tmp_path / "ros" / below / "pkg" / "a.obj")
    monkeypatch.setenv(variable, f"/nowhere:{tmp_path / 'ros'}")
    path = write(tmp_path, mesh("package://pkg/a.obj"), "here/sample.urdf")
    assert mesh_file(read_urdf(path)) == str(expected)


def test_missing_mesh_names_the_file_and_the_folders_tried(tmp_path: Path) -> None:
    path = write(tmp_path, mesh("package://pkg/a.obj"), "here/sample.urdf")
    with pytest.raises(RobotLoadError) as caught:
        read_urdf(path, [tmp_path / "one", tmp_path / "two"])
    message = str(caught.value)
    assert "link l1, collision 1" in message
    assert "'package://pkg/a.obj'" in message
    for folder in ("one", "two", "here"):
        assert str(tmp_path / folder / "pkg" / "a.obj") in message
    assert "package_dirs" in message


def test_folder_or_device_is_refused_as_a_mesh(tmp_path: Path) -> None:
    for filename in (str(tmp_path), "/dev/zero"):
        with pytest.raises(RobotLoadError, match="does not exist"):
            read(tmp_path, mesh(filename))


@pytest.mark.parametrize(
    "filename",
    [
        "package://pkg/../../secret.obj",
        "package://pkg/a/../../secret.obj",
        "package://../secret.obj",
        "package:///../secret.obj",
        "package://",
        "model://pkg/../secret.obj",
    ],
)
def test_path_out_of_a_package_is_refused(tmp_path: Path, filename: str) -> None:
    write_tetrahedron(tmp_path / "secret.obj")
    path = write(tmp_path, mesh(filename), "pkg/urdf/sample.urdf")
    with pytest.raises(RobotLoadError, match="leads out of its package"):
        read_urdf(path, [tmp_path])


def test_double_slash_does_not_leave_the_package(tmp_path: Path) -> None:
    outside = write_tetrahedron(tmp_path / "secret.obj")
    path = write(tmp_path, mesh(f"package://pkg/{outside}"), "pkg/urdf/sample.urdf")
    with pytest.raises(RobotLoadError, match="does not exist"):
        read_urdf(path)


def test_upward_path_within_the_package_is_accepted(tmp_path: Path) -> None:
    expected = write_tetrahedron(tmp_path / "pkg" / "meshes" / "a.obj")
    filename = "package://pkg/urdf/../meshes/a.obj"
    urdf = tmp_path / "pkg" / "urdf" / "sample.urdf"
    assert resolve_resource(filename, urdf, [])[0] == expected


def test_mesh_urls_are_not_fetched(tmp_path: Path) -> None:
    with pytest.raises(RobotLoadError, match="nothing is fetched"):
        read(tmp_path, mesh("https://example.org/a.obj"))


@pytest.mark.parametrize(
    "filename",
    [
        "file:///home/user/ws/install/pkg/share/pkg/meshes/fore arm.obj",
        "/home/user/ws/install/pkg/share/pkg/meshes/fore arm.obj",
        "/home/user/catkin_ws/src/arms/pkg/meshes/fore arm.obj",
        r"C:\ws\install\share\pkg\meshes\fore arm.obj",
        "file:///C:/ws/install/share/pkg/meshes/fore%20arm.obj",
        "$(find pkg)/meshes/fore arm.obj",
        "file://$(find pkg)/meshes/fore%20arm.obj",
        "file://$(find-pkg-share pkg)/meshes/fore arm.obj",
        "package://pkg/meshes/fore%20arm.obj",
        r"package://pkg\meshes\fore arm.obj",
        r"..\meshes\fore arm.obj",
        "../Meshes/Fore Arm.OBJ",
        "package://PKG/meshes/fore%20arm.OBJ",
        "file://../meshes/fore arm.obj",
    ],
)
def test_mesh_names_of_other_machines_and_tools_are_resolved(
    tmp_path: Path, filename: str
) -> None:
    expected = write_tetrahedron(tmp_path / "pkg" / "meshes" / "fore arm.obj")
    path = write(tmp_path, mesh(filename), "pkg/urdf/sample.urdf")
    assert mesh_file(read_urdf(path)) == str(expected)
    elsewhere = write(tmp_path, mesh(filename), "else/where/sample.urdf")
    if ".." not in filename:
        assert mesh_file(read_urdf(elsewhere, [tmp_path])) == str(expected)


def test_literal_mesh_name_precedes_decoded_names(tmp_path: Path) -> None:
    for name in ("a%20b.obj", "a b.obj", "A%20B.obj"):
        write_tetrahedron(tmp_path / name)
        assert mesh_file(read(tmp_path, mesh(name))) == str(tmp_path / name)


@pytest.mark.parametrize(
    ("filename", "words"),
    [
        ("meshes/fore.obj", r"did you mean (Fore|fOre)\.obj"),
        ("meshes/elbo.obj", "did you mean elbow.obj"),
        ("file:///ws/share/pkg/meshes/none.obj", "holds the package in package_dirs"),
        ("$(find pkg)/none.obj", "holds the package in package_dirs"),
    ],
)
def test_missing_mesh_error_suggests_similar_names_or_package_dirs(
    tmp_path: Path, filename: str, words: str
) -> None:
    for name in ("Fore.obj", "fOre.obj", "elbow.obj"):
        write_tetrahedron(tmp_path / "meshes" / name)
    with pytest.raises(RobotLoadError, match=words):
        read(tmp_path, mesh(filename))


@pytest.mark.parametrize(
    "filename", ["package://pkg/%2e%2e/%2e%2e/secret.obj", r"package://pkg\..\..\a.obj"]
)
def test_encoded_path_out_of_a_package_is_refused(
    tmp_path: Path, filename: str
) -> None:
    path = write(tmp_path, mesh(filename), "pkg/urdf/sample.urdf")
    with pytest.raises(RobotLoadError, match="leads out of its package"):
        read_urdf(path, [tmp_path])


def test_mesh_scale_of_zero_is_refused(tmp_path: Path) -> None:
    write_tetrahedron(tmp_path / "a.obj")
    with pytest.raises(RobotLoadError, match="scale"):
        read(tmp_path, one_shape('<mesh filename="a.obj" scale="1 0 1"/>'))
