# SPDX-License-Identifier: Apache-2.0
"""The packages say the truth about themselves, and keep the two rules: science without ROS, simulator without the tested code."""

from __future__ import annotations

import ast
import importlib
import os
import py_compile
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("irec_calibration", "irec_correction", "irec_sim")
ROS_MODULES = re.compile(r"^(rclpy|irec_ros|launch|launch_ros|\w+_msgs|\w+_interfaces|std_srvs|rosidl\w*|ament_index_python)$")
# distribution -> import name, where they differ
SHARED = "irec_ros"  # Python that irec_msgs installs
# distribution -> key of rosdep (rosdep/python.yaml and jazzy/distribution.yaml of ros/rosdistro)
ROSDEP = {
    "numpy": "python3-numpy", "scipy": "python3-scipy", "PyYAML": "python3-yaml", "jsonschema": "python3-jsonschema",
    "python-can": "python3-can", "pin": "pinocchio", "mcap": "mcap-ros2-support", "lz4": "mcap-ros2-support",
    "zstandard": "mcap-ros2-support",
}  # fmt: skip
PYPI = {"pin": "pinocchio", "PyYAML": "yaml", "mcap-ros2-support": "mcap_ros2", "python-can": "can", "scikit-learn": "sklearn"}


def sources(package: str) -> list[Path]:
    return sorted((ROOT / package / package).rglob("*.py"))


def imports(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {n.name.split(".")[0] for n in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module.split(".")[0])
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_ros_is_imported_in_the_node_layer_only(package):
    outside = [p for p in sources(package) if "nodes" not in p.parts and any(ROS_MODULES.match(m) for m in imports(p))]
    assert not outside


def test_the_simulator_imports_nothing_that_it_is_meant_to_test():
    assert not [p for p in sources("irec_sim") if imports(p) & {"irec_calibration", "irec_correction"}]


def test_the_calibration_imports_neither_correction_nor_simulator():
    assert not [p for p in sources("irec_calibration") if imports(p) & {"irec_correction", "irec_sim"}]


def after_import(package: str, expression: str, threads: dict[str, str]) -> str:
    """What an expression is in a process of its own that has imported a package and nothing else."""
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")} | threads
    command = [sys.executable, "-c", f"import os, sys, {package}; print({expression})"]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=True).stdout.strip()


@pytest.mark.parametrize("package", PACKAGES)
def test_small_matrices_are_computed_by_one_thread(package):
    assert after_import(package, "os.environ.get('OPENBLAS_NUM_THREADS')", {}) == "1"


@pytest.mark.parametrize("package", PACKAGES)
def test_how_many_threads_compute_is_settled_before_numpy_is_loaded(package):
    assert after_import(package, "'numpy' in sys.modules", {}) == "False"


@pytest.mark.parametrize("package", PACKAGES)
def test_a_number_of_threads_that_somebody_has_set_stays(package):
    assert after_import(package, "os.environ.get('OPENBLAS_NUM_THREADS')", {"OPENBLAS_NUM_THREADS": "3"}) == "3"


@pytest.mark.parametrize("package", PACKAGES)
def test_what_is_imported_is_declared(package):
    tree = ElementTree.parse(ROOT / package / "package.xml").getroot()
    declared = {e.text for e in tree if e.tag.endswith("depend")}
    text = (ROOT / package / "setup.py").read_text()
    declared |= {PYPI.get(n, n) for n in re.findall(r"[\"']([A-Za-z][\w-]*)[>\"']", text)}
    declared |= {d.removeprefix("python3-") for d in declared if d} | {package}
    used = {"irec_msgs" if m == SHARED else m for p in sources(package) for m in imports(p)}
    used -= {*sys.stdlib_module_names, "__future__"}
    assert not used - declared


@pytest.mark.parametrize("package", PACKAGES)
def test_the_ros_packages_that_are_declared_are_those_that_are_imported(package):
    tree = ElementTree.parse(ROOT / package / "package.xml").getroot()
    declared = {e.text for e in tree if e.tag == "exec_depend" and ROS_MODULES.match(e.text or "")}
    files = [*sources(package), *(ROOT / package / "launch").glob("*.launch.py")]
    used = {m for p in files for m in imports(p) if ROS_MODULES.match(m)}
    assert declared == {"irec_msgs" if m == SHARED else m for m in used}


def test_what_the_nodes_share_imports_no_other_package_of_the_project_and_is_declared_by_irec_msgs():
    used = {m for p in (ROOT / "irec_msgs" / SHARED).glob("*.py") for m in imports(p)} - set(sys.stdlib_module_names)
    tree = ElementTree.parse(ROOT / "irec_msgs" / "package.xml").getroot()
    assert used - {"__future__", "irec_msgs"} <= {e.text for e in tree if e.tag in ("depend", "exec_depend")}


@pytest.mark.parametrize("package", PACKAGES)
def test_rosdep_brings_all_that_pip_would(package):
    setup = (ROOT / package / "setup.py").read_text()
    needed = re.findall(r"[\"']([A-Za-z][\w-]*)(?:>=[^\"']*)?[\"']", re.search(r"install_requires=\[(.*?)\]", setup, re.S)[1])
    assert "numpy" in needed
    tree = ElementTree.parse(ROOT / package / "package.xml").getroot()
    asked_for = {e.text for e in tree if e.tag == "exec_depend"}
    assert not {ROSDEP.get(name, name) for name in needed} - asked_for


@pytest.mark.parametrize("package", PACKAGES)
def test_colcon_test_knows_that_the_tests_are_those_of_pytest(package):
    assert re.search(r"'test': \['pytest>=", (ROOT / package / "setup.py").read_text()), "colcon test would run no test"
    tree = ElementTree.parse(ROOT / package / "package.xml").getroot()
    wanted = {"python3-pytest", "python3-pytest-timeout", "python3-hypothesis"}
    assert wanted <= {e.text for e in tree if e.tag == "test_depend"}


@pytest.mark.parametrize("package", (*PACKAGES, "irec_msgs"))
def test_versions_and_licence_agree(package):
    tree = ElementTree.parse(ROOT / package / "package.xml").getroot()
    assert tree.get("format") == "3"
    assert tree.findtext("license") == "Apache-2.0"
    if package in PACKAGES:
        setup = (ROOT / package / "setup.py").read_text()
        assert f'version="{tree.findtext("version")}"' in setup
        assert 'license="Apache-2.0"' in setup
        assert tree.findtext("version") == importlib.import_module(package).__version__


@pytest.mark.parametrize("package", PACKAGES)
def test_executables_are_installed_where_ros2_run_finds_them(package):
    assert (ROOT / package / "setup.cfg").read_text().count(f"=$base/lib/{package}\n") == 2
    assert (ROOT / package / "resource" / package).is_file()


def test_each_target_that_make_help_lists_runs_a_file_that_exists():
    makefile = (ROOT / "Makefile").read_text()
    named = re.findall(r"\b(tools/[\w/.-]+\.(?:py|sh|txt))\b", makefile)
    assert named
    assert not [name for name in named if not (ROOT / name).is_file()]


def test_launch_files_start_executables_that_the_packages_install():
    installed = {
        (package, name)
        for package in PACKAGES
        for name in re.findall(r'"([\w-]+) = [\w.]+:\w+"', (ROOT / package / "setup.py").read_text())
    }
    for path in sorted(ROOT.glob("irec_*/launch/*.launch.py")):
        started = re.findall(r'package="(\w+)",\s*executable="([\w-]+)"', path.read_text())
        assert started, path
        assert set(started) <= installed, path


@pytest.mark.parametrize("package", PACKAGES)
def test_every_executable_resolves_to_a_function(package):
    text = (ROOT / package / "setup.py").read_text()
    points = re.findall(r'"[\w-]+ = ([\w.]+):(\w+)"', text)
    assert points
    for module, function in points:
        if ".nodes." in module:
            path = ROOT / package / Path(*module.split(".")).with_suffix(".py")
            assert re.search(rf"^def {function}\(", path.read_text(), re.M), module
        else:
            assert callable(getattr(importlib.import_module(module), function))


def test_launch_files_compile(tmp_path):
    files = sorted(ROOT.glob("irec_*/launch/*.launch.py"))
    assert files
    for path in files:
        py_compile.compile(str(path), cfile=str(tmp_path / "x.pyc"), doraise=True)


def test_every_source_file_states_its_licence():
    files = [p for package in PACKAGES for p in (ROOT / package).rglob("*.py") if "build" not in p.parts]
    assert not [p for p in files if "SPDX-License-Identifier: Apache-2.0" not in p.read_text(encoding="utf-8")[:200]]


def test_no_file_holds_a_path_of_a_machine():
    pattern = re.compile(r"/(home|work|root)/\w+")
    names = [p for d in (*PACKAGES, "irec_msgs", "config", "docs", "tools", "test") for p in (ROOT / d).rglob("*")]
    texts = [p for p in names if p.suffix in {".py", ".md", ".yaml", ".sh", ".toml", ".xml", ".urdf"} and p != Path(__file__)]
    assert not [p for p in texts if pattern.search(p.read_text(encoding="utf-8"))]
