# SPDX-License-Identifier: Apache-2.0
"""A cell for recertifications without ROS: synthetic sessions of a robot whose compliances a test may change."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import synthetic
from irec_calibration.effects.scene import Scene
from irec_calibration.poses.store import EngagementPose, PoseList, read_poses, write_poses
from irec_calibration.procedure.settings import Acceptance
from irec_calibration.recertification.judgement import Missing
from irec_calibration.recertification.preconditions import Precondition
from irec_calibration.recertification.request import Place
from irec_calibration.robot import Robot
from irec_calibration.session import Session, write_table

ACCEPTANCE = Acceptance(min_poses=12, held_out_share=0.3, held_out_rms_m=1e-4, max_ratio_to_old=1.05, max_noise_floors=6.0)


def place() -> Place:
    return Place("synthetic", Robot(synthetic.urdf()), "S-1", 3e-4, ACCEPTANCE)


def pose_file(path: Path, poses: int = 25, seed: int = 3) -> Path:
    """A pose file of the synthetic robot."""
    robot = Robot(synthetic.urdf())
    q = np.random.default_rng(seed).uniform(*synthetic.JOINTS, (poses, 6))
    kin = robot.kinematics(q)
    listed = tuple(
        EngagementPose(i + 1, q[i], {}, kin.p_tcp[i], np.array([0.0, 0, 0, 1]), -kin.R_tool[i][:, 2], 0.1, "A")
        for i in range(poses)
    )
    return write_poses(PoseList("synthetic", "S-1", robot.sha256, tuple(robot.joint_names), listed), path)


@dataclass
class FakeCell:
    """Implements CellSide. `stop_after`: the run ends, not finished, after so many poses (once)."""

    compliance: np.ndarray = field(default_factory=lambda: synthetic.COMPLIANCE.copy())
    extra: Callable[[Scene], np.ndarray] | None = None
    seed: int = 11
    refuses: str = ""
    missing: Missing = Missing("adequate")
    stop_after: int = 0
    lateral: float = 1.0
    problems: tuple[Precondition, ...] = ()
    runs: list[str] = field(default_factory=list)
    activated: list[Path] = field(default_factory=list)
    reported: list[str] = field(default_factory=list)

    def preconditions(self) -> Sequence[Precondition]:
        return self.problems

    def report(self, stage: str, text: str) -> None:
        self.reported.append(f"{stage}: {text}")

    def lateral_factor(self, poses: PoseList, most: float) -> float:
        return min(self.lateral, most)

    def measured(self, poses_path: Path) -> Session:
        listed = read_poses(poses_path)
        q = np.array([p.q for p in listed.poses])
        self.seed += 1
        return synthetic.session(
            len(q), self.seed, extra=self.extra, compliance=self.compliance, q_of_poses=q, lateral=listed.lateral_factor
        )

    def run(self, poses_path: Path, session_path: Path, resume: bool, enough: Callable[[], bool]) -> str:
        self.runs.append(f"{session_path.stem}{' resumed' if resume else ''}")
        session = self.measured(poses_path)
        for n in session.poses.tolist():
            if self.stop_after and n > self.stop_after:
                self.stop_after = 0
                return "no force readings for 3 s"
            write_table(session.select_poses(list(range(1, n + 1))), session_path)
            if enough():
                return ""
        return ""

    def diagnose(self, session_path: Path, model_path: Path, folder: Path) -> Missing:
        return self.missing

    def activate(self, model_path: Path) -> str:
        if not self.refuses:
            self.activated.append(model_path)
        return self.refuses
