# SPDX-License-Identifier: Apache-2.0
"""Figures (PNG) and self-contained HTML pages. Needs the extra `report`; nothing on the robot's computer imports it."""
