# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

NAME = "irec_sim"

setup(
    name=NAME,
    version="0.1.0",
    description="Stand-in for robot, cell and instruments: "
    "elastic plant, contact, servo, force sensor, laser tracker, hidden truths.",
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
        *((f"share/{NAME}/config/{kind}", glob(f"config/{kind}/*")) for kind in ("cells", "robots", "truths")),
    ],
    install_requires=["numpy>=1.26,<3", "scipy>=1.11", "PyYAML>=6.0", "jsonschema>=4.10", "python-can>=4.3"],
    extras_require={'test': ['pytest>=7.4', 'hypothesis>=6.98', 'pytest-timeout>=2.2']},  # by which colcon test knows pytest
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "irec-sim = irec_sim.cli:main",
            "cell_node = irec_sim.nodes.cell_node:main",
            "ros2_control_node = irec_sim.nodes.ros2_control_node:main",
        ],
        "irec.formats": ["irec-truth/1 = irec_sim.truth:truth_problems"],
    },
)
