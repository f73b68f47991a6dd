# SPDX-License-Identifier: Apache-2.0
"""ROS side of the simulated cell: the robot's side of the contract in the README of this package."""
