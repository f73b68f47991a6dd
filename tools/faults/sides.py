# SPDX-License-Identifier: Apache-2.0
"""The stacks behind the matrix: one for procedure and solving, another for the correction, never both."""

from __future__ import annotations

from pathlib import Path

from catalogue import CORRECTION_FAULTS, FAULTS
from correction_side import CorrectionSide
from procedure_side import ProcedureSide
from solve_side import SolveSide
from stack import Stack
from table import Row


class Sides:
    """Starts a stack when its first combination comes, and ends it when another one is needed."""

    def __init__(self, folder: Path, domain: int) -> None:
        self._folder, self._domain = folder, domain
        self._stack: Stack | None = None
        self._name = ""
        self._side: ProcedureSide | SolveSide | CorrectionSide | None = None

    def run(self, side: str, fault: str, phase: str) -> Row:
        runner = self._of(side)
        if isinstance(runner, SolveSide):
            return runner.run(fault)
        if isinstance(runner, ProcedureSide):
            return runner.run(next(f for f in FAULTS if f.name == fault), phase)
        return runner.run(next(f for f in CORRECTION_FAULTS if f.name == fault), phase)

    def _of(self, side: str) -> ProcedureSide | SolveSide | CorrectionSide:
        if self._name != side or self._side is None:
            self.close()
            self._stack = Stack(self._folder / side, self._domain)
            kinds = {"procedure": ProcedureSide, "solve": SolveSide, "correction": CorrectionSide}
            self._side, self._name = kinds[side](self._stack), side
        return self._side

    def close(self) -> None:
        if isinstance(self._side, CorrectionSide):
            self._side.close()
        if self._stack is not None:
            self._stack.close()
        self._stack = self._side = None
