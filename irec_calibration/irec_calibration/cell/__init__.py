# SPDX-License-Identifier: Apache-2.0
"""The production cell: cell file and tooling surface."""

from .cell import LOAD_CASE_NAMES, Cell, Rail, Section, Station, load_cases, read_cell

__all__ = ["LOAD_CASE_NAMES", "Cell", "Rail", "Section", "Station", "load_cases", "read_cell"]
