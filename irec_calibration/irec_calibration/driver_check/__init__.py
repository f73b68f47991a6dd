# SPDX-License-Identifier: Apache-2.0
"""Does a robot's driver keep the contract? Judged from what was observed of it; nothing here knows ROS."""
