# SPDX-License-Identifier: Apache-2.0
"""What launch files name is installed with the packages; and where launch is at hand, they load and explain their arguments."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from irec_calibration.cell import read_cell
from irec_calibration.poses.store import read_poses

ROOT = Path(__file__).parents[1]
LAUNCH_FILES = sorted(ROOT.glob("irec_*/launch/*.launch.py"))
CELLS = ("afp", "milling")
INSTALLED = {
    "irec_calibration": ["config/nodes/calibration.yaml", "config/nodes/kuka_drivers.yaml", "config/nodes/recorder.yaml"],
    "irec_correction": ["config/nodes/correction.yaml"],
    "irec_sim": [
        str(p.relative_to(ROOT)) for kind in ("cells", "robots", "truths") for p in sorted((ROOT / "config" / kind).iterdir())
    ],
}


def share(package: str) -> Path:
    index = pytest.importorskip("ament_index_python.packages", reason="ament_index_python is missing: run `make test`")
    return Path(index.get_package_share_directory(package))


@pytest.mark.ros
@pytest.mark.parametrize("package", INSTALLED)
def test_the_configuration_is_installed_with_the_package(package):
    for name in INSTALLED[package]:
        assert (share(package) / name).read_bytes() == (ROOT / name).read_bytes(), f"{name}: run `make build`"


@pytest.mark.ros
def test_an_installed_cell_finds_its_robot_and_its_poses():
    for name in CELLS:
        cell = read_cell(share("irec_sim") / "config" / "cells" / f"{name}.yaml")
        assert read_poses(cell.poses_path, cell.serial, cell.robot.sha256).poses


@pytest.mark.parametrize("name", CELLS)
def test_the_poses_that_a_cell_names_suffice_for_its_recalibration(name):
    cell = read_cell(ROOT / "config" / "cells" / f"{name}.yaml")
    poses = read_poses(cell.poses_path, cell.serial, cell.robot.sha256).poses
    assert len(poses) >= cell.raw["acceptance"]["min_poses"]


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda p: p.name)
def test_files_that_a_launch_file_looks_for_in_a_package_are_installed_there(path):
    text = path.read_text()
    packages = re.findall(r'FindPackageShare\("(\w+)"\)', text)
    names = re.findall(r'"config", "nodes", "([\w.]+)"', text)
    assert len(packages) == len(names)
    assert all(f"config/nodes/{n}" in INSTALLED[p] for p, n in zip(packages, names, strict=True))


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda p: p.name)
def test_a_launch_file_loads_and_explains_its_arguments(path):
    pytest.importorskip("launch_ros", reason="launch is not on the package index: source a ROS 2 installation")
    from launch.launch_description_sources import get_launch_description_from_python_launch_file

    arguments = get_launch_description_from_python_launch_file(str(path)).get_launch_arguments()
    assert arguments
    assert not [a.name for a in arguments if a.description in ("", "no description given")]
