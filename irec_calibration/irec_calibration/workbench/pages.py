# SPDX-License-Identifier: Apache-2.0
"""The pages of the workbench and the rooms behind them. A room outlives the page that shows it: reload and go on."""

from __future__ import annotations

import asyncio
import secrets
from pathlib import Path

from nicegui import background_tasks, ui

from ..cell import Cell, read_cell
from ..errors import IrecError
from ..nodes.cell_link import RosLink
from ..typing import Array, IntArray
from .app import Settings
from .bench_page import BenchPage
from .cell_page import CellPage
from .open_page import OpenPage
from .room import Room, Shared
from .versions import Past, new_folder, past_work
from .worker import Stock

STYLE = (Path(__file__).parent / "style.css").read_text(encoding="utf-8")
MOST_ROOMS = 6


class Pages:
    """Opens rooms and remembers them by a name in the address."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.rooms: dict[str, Room] = {}
        self._warmed = False
        self.shared = Shared(Stock(settings.effect_files))
        self._link: RosLink | None = None

    def register(self) -> None:
        """Make the pages known to the server."""

        @ui.page("/", title="irec workbench")
        async def _root() -> None:
            if self.settings.session:
                key = self.enter(self.settings.session, self.settings.model)
                ui.navigate.to(f"/bench/{key}")
            else:
                ui.navigate.to("/open")

        @ui.page("/cell", title="irec: the cell")
        async def _cell() -> None:
            _dress()
            link, why = self._cell_link()
            CellPage(link, why, self._cell_file(), self.settings.calibrations).build()

        @ui.page("/open", title="irec workbench: open")
        async def _open() -> None:
            _dress()
            background_tasks.create(self.warm())
            OpenPage(self.settings, self.enter, past_work(self.settings.root), self.shared.stock).build()

        @ui.page("/bench/{key}", title="irec workbench", response_timeout=30.0)
        async def _bench(key: str) -> None:
            _dress()
            room = self.rooms.get(key)
            if room is None:
                ui.navigate.to("/open")
                return
            page = BenchPage(room, self.settings)
            page.build()

    def enter(self, session: str, model: str = "", past: Past | None = None) -> str:
        """A room of one's own for a session; its name in the address. Two people share one only where they share the address."""
        while len(self.rooms) >= MOST_ROOMS:
            oldest = next(iter(self.rooms))
            self.rooms.pop(oldest).close()
        folder = past.folder if past is not None else new_folder(self.settings.root, session)
        room = Room(session, folder, model, self.shared)
        room.surface = self._surface()
        room.cell = self.settings.cell
        room.past = past
        key = secrets.token_urlsafe(6)
        self.rooms[key] = room
        return key

    def _cell_file(self) -> Cell | None:
        return read_cell(self.settings.cell) if self.settings.cell else None

    def _surface(self) -> tuple[Array, IntArray] | None:
        cell = self._cell_file()
        if cell is None:
            return None
        mesh = cell.surface.mesh()
        return mesh.vertices, mesh.corners

    def _cell_link(self) -> tuple[RosLink | None, str]:
        """One link to the nodes of the cell for all pages, made when the first one asks; or why there is none."""
        if self._link is None:
            try:
                self._link = RosLink()
            except IrecError as error:
                return None, str(error)
        return self._link, ""

    async def warm(self) -> None:
        """Start processes while the browser loads the page; not for the page of the cell, which needs none."""
        if not self._warmed:
            self._warmed = True
            await asyncio.to_thread(self.shared.stock.fill, 2)

    def close(self) -> None:
        """End all workers."""
        for room in self.rooms.values():
            room.close()
        self.shared.stock.close()
        if self._link is not None:
            self._link.close()


def _dress() -> None:
    """The look that all pages share; white on this blue can be read by everybody."""
    ui.colors(primary="#0072B2")
    ui.add_css(STYLE)
