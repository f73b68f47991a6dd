# SPDX-License-Identifier: Apache-2.0
"""Stand-in for robot, cell and instruments: elastic plant, contact, servo, force sensor, laser tracker, hidden truths."""

__version__ = "0.1.0"
