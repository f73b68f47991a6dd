# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

NAME = "irec_correction"

setup(
    name=NAME,
    version="0.1.0",
    description="Real-time correction of robot deflection under process forces: "
    "wrench conditioning, offsets, limits, RSI and CAN.",
    maintainer="irec maintainers",
    maintainer_email="maintainers@irec.example.org",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["**/*.html", "**/*.css", "**/*.js", "**/*.xml", "**/*.src", "**/*.j2", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        (f"share/{NAME}/config/nodes", ["config/nodes/correction.yaml"]),
    ],
    install_requires=["irec_calibration", "numpy>=1.26,<3", "scipy>=1.11", "pin>=2.7", "PyYAML>=6.0", "python-can>=4.3"],
    extras_require={'test': ['pytest>=7.4', 'hypothesis>=6.98', 'pytest-timeout>=2.2']},  # by which colcon test knows pytest
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "correction_node = irec_correction.nodes.correction_node:main",
            "rsi_bridge = irec_correction.nodes.rsi_bridge:main",
            "can_ft_node = irec_correction.nodes.can_ft_node:main",
        ]
    },
)
