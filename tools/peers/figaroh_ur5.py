# SPDX-License-Identifier: Apache-2.0
"""FIGAROH on a folder with train.csv, test.csv and robot.urdf; runs in an environment of its own. One JSON line per model."""

from __future__ import annotations

import json
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import yaml

warnings.filterwarnings("ignore")
from figaroh.calibration.base_calibration import BaseCalibration  # noqa: E402
from figaroh.tools.robot import Robot  # noqa: E402

folder = Path(sys.argv[1])
for name, elastic in (("geometry", False), ("geometry and joint elasticity", True)):
    start = time.perf_counter()
    robot = Robot(str(folder / "robot.urdf"), str(folder), isFext=False)
    marker = {"name": "m", "measurable_dof": [True, True, True, False, False, False]}
    task = {
        "enabled": True, "type": "kinematic_calibration",
        "joints": {"active_joints": [f"joint_{k}" for k in range(1, 7)]},
        "kinematics": {"base_frame": "universe", "tool_frame": "tool0"},
        "parameters": {"calibration_level": "full_params", "include_non_geometric": elastic},
        "measurements": {"markers": [marker], "poses": {"base_pose": [0] * 6, "tool_pose": [0] * 6}},
        "data": {
            "source_file": str(folder / "train.csv"), "validation_data_file": str(folder / "test.csv"),
            "number_of_samples": sum(1 for _ in (folder / "train.csv").open()) - 1,
        },
    }  # fmt: skip
    (folder / "figaroh.yaml").write_text(yaml.safe_dump({"robot": {"name": "ur5"}, "tasks": {"calibration": task}}))
    calibration = BaseCalibration(robot, str(folder / "figaroh.yaml"))
    # both are read without a default where neither frame is known
    calibration.calib_config.setdefault("known_baseframe", False)
    calibration.calib_config.setdefault("known_tipframe", False)
    calibration.initialize()
    calibration.solve(enable_logging=False)
    found = calibration._compute_validation_metrics()
    result = {
        "model": name, "held_out_rms_mm": float(np.float64(found["pos_rmse_calibrated_mm"])),
        "parameters": len(calibration.calib_config["param_name"]), "seconds": time.perf_counter() - start,
    }  # fmt: skip
    print("RESULT " + json.dumps(result))
