# SPDX-License-Identifier: Apache-2.0
"""Devices that speak the wire protocols of real ones, with their faults on demand."""
