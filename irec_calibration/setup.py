# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

NAME = "irec_calibration"

setup(
    name=NAME,
    version="0.1.0",
    description="In-situ elastic calibration of industrial robots: sessions, effects, identification, diagnosis, Procedure 1.",
    maintainer="irec maintainers",
    maintainer_email="maintainers@irec.example.org",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["**/*.html", "**/*.css", "**/*.js", "**/*.xml", "**/*.src", "**/*.j2", "**/*.json", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        (f"share/{NAME}/config/nodes", ["config/nodes/calibration.yaml", "config/nodes/kuka_drivers.yaml",
                                        "config/nodes/recorder.yaml"]),
    ],
    install_requires=[
        "numpy>=1.26,<3", "scipy>=1.11", "pin>=2.7", "PyYAML>=6.0", "jsonschema>=4.10", "mcap>=1.2", "mcap-ros2-support>=0.5.5",
        "lz4>=4.3", "zstandard>=0.22",
    ],
    extras_require={'report': ['matplotlib>=3.8', 'jinja2>=3.1'], 'ml': ['scikit-learn>=1.5'], 'mesh': ['trimesh>=4.4'],
                    'step': ['cascadio>=0.1.1', 'trimesh>=4.4'],
                    'workbench': ['nicegui>=3.4,<4', 'plotly>=5.20'], 'completion': ['argcomplete>=3.3'],
                    'test': ['pytest>=7.4', 'hypothesis>=6.98', 'pytest-timeout>=2.2']},  # by which colcon test knows pytest
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "irec = irec_calibration.cli:main",
            "procedure_node = irec_calibration.nodes.procedure_node:main",
            "calibration_node = irec_calibration.nodes.calibration_node:main",
            "check_driver = irec_calibration.nodes.check_driver:main",
            "ros2_control_driver = irec_calibration.nodes.ros2_control_driver:main",
            "tracker_driver = irec_calibration.nodes.tracker_driver:main",
            "tf_node = irec_calibration.nodes.tf_node:main",
            "recorder_node = irec_calibration.nodes.recorder_node:main",
        ]
    },
)
