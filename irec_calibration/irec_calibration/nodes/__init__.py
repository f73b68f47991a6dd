# SPDX-License-Identifier: Apache-2.0
"""ROS 2 nodes of the calibration: thin shells around the library."""
