# SPDX-License-Identifier: Apache-2.0
"""Procedure 1 of the paper as a state machine that knows no ROS: readings and time in, commands and rows out."""
