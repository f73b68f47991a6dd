# SPDX-License-Identifier: Apache-2.0
"""A robot from its description: kinematics, Jacobians of actuated and virtual axes, gravity torques, coupled joints."""

from .kinematics import Kinematics
from .robot import Payload, Robot, parent_joint

__all__ = ["Kinematics", "Payload", "Robot", "parent_joint"]
