"""Status of the robots of a flight on stderr: a live table, or lines without a terminal."""

import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, suppress
from types import TracebackType
from typing import Literal, Self

from rich.console import Console
from rich.live import Live
from rich.table import Table

from angler_mjx.cli.shared.consoles import make_progress_console
from angler_mjx.errors import RunError
from angler_mjx.runs.session.interface import Observation
from angler_mjx.teleop.loop import Watcher
from angler_sitl.missions import robot_status
from angler_sitl.missions.robot_status import MissionStatus
from angler_sitl.session import SitlSession

REFRESH_S = 0.25
"""Period of the live table, by the wall clock."""
LINE_PERIOD_S = 10.0
"""Period of the lines, in seconds of the scene."""


def status_table(session: SitlSession) -> AbstractContextManager[Watcher]:
    """Return the display that suits stderr."""
    console = make_progress_console()
    return _LiveTable(session, console) if console.is_terminal else _LinePrinter(session, console)


class _LiveTable:
    """A live table; its last state stays."""

    def __init__(self, session: SitlSession, console: Console) -> None:
        self._session, self._latest = session, session.observe()
        self._live = Live(console=console, auto_refresh=False)
        self._refreshed_s = 0.0

    def __enter__(self) -> Self:
        self._live.start()
        self._refresh()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with suppress(RunError):  # after a crash of the autopilots
            self._refresh()
        self._live.stop()

    def after(self, observation: Observation) -> None:
        """See `Watcher`."""
        self._latest = observation
        if time.perf_counter() - self._refreshed_s >= REFRESH_S:
            self._refresh()

    def _refresh(self) -> None:
        self._refreshed_s = time.perf_counter()
        rows = robot_status.collect_status(self._session, self._latest)
        self._live.update(build_table(self._latest.time_s, rows), refresh=True)


class _LinePrinter:
    """A line printer, for a file or a pipe."""

    def __init__(self, session: SitlSession, console: Console) -> None:
        self._session, self._console, self._due_s = session, console, 0.0

    def __enter__(self) -> Self:
        self.after(self._session.observe())
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        pass

    def after(self, observation: Observation) -> None:
        """See `Watcher`."""
        # Tolerance of 1 ms: times are floating-point sums.
        if observation.time_s < self._due_s - 1e-3:
            return
        self._due_s += LINE_PERIOD_S
        for row in robot_status.collect_status(self._session, observation):
            line = f"{observation.time_s:7.2f} s  {row.format_line()}"
            self._console.print(line, highlight=False, markup=False, soft_wrap=True)


def build_table(time_s: float, rows: Sequence[MissionStatus]) -> Table:
    """Return a table of all robots at one time."""
    status = Table(title=f"{time_s:.2f} s", title_justify="left")
    for name in ("robot", "mode", "armed", "EKF", "off m", "clear m", "outcome", "remark"):
        side: Literal["right", "left"] = "right" if name.endswith(" m") else "left"
        status.add_column(name, justify=side, overflow="fold")
    for row in rows:
        status.add_row(
            row.name,
            row.mode,
            "armed" if row.armed else "[red]no",
            "good" if row.has_position else "[red]bad",
            f"{row.off_m:.2f}",
            f"{row.clearance_m:.2f}",
            row.outcome,
            row.remark.replace("[", r"\["),
        )
    return status
