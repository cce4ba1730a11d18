"""Control loop: keys in, commands out, a step of the scene, at real time or as fast as possible."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs.session.interface import Observation, Session
from angler_mjx.teleop import status
from angler_mjx.teleop.pace import Overruns, RealTimePacer
from angler_mjx.teleop.pilot import TeleopPilot
from angler_mjx.teleop.script import TimedKey
from angler_mjx.teleop.signals import StopRequest

REFRESH_S = 0.1
"""Wall time between repaints of the screen."""


class KeySource(Protocol):
    """Source of keys."""

    @property
    def finished(self) -> bool:
        """Whether no more keys will come."""
        ...

    def read(self, time_s: float) -> list[str]:
        """Return the keys since the last call; ``time_s`` is that of the scene."""
        ...


class Painter(Protocol):
    """Display of lines."""

    def paint(self, lines: Sequence[str]) -> None:
        """Show lines from the top."""
        ...


class Watcher(Protocol):
    """Receiver of every step: a recorder, a viewer."""

    def after(self, observation: Observation) -> None:
        """Process the observation after a step."""
        ...


@dataclass(frozen=True, kw_only=True)
class DriveResult:
    """Result of a drive."""

    steps: int
    scene_s: float
    """Duration of the scene."""
    wall_s: float
    overruns: Overruns | None
    """Overruns; None without real time."""
    keys: tuple[TimedKey, ...]
    """All pressed keys, with the time of the scene at which they took effect."""
    last: Observation
    broken: str = ""
    """Reason of an early end; empty if the drive was completed."""


def drive_session(
    session: Session,
    pilot: TeleopPilot,
    keys: KeySource,
    *,
    title: str,
    stop: StopRequest,
    realtime: bool,
    duration_s: float | None = None,
    screen: Painter | None = None,
    watchers: Sequence[Watcher] = (),
) -> DriveResult:
    """Drive a session until a key, a signal, the duration or the end of the keys ends it.

    Args:
        session: reset, with everything compiled.
        pilot: turns keys into commands.
        keys: source of keys.
        title: of the scene, for the screen.
        stop: request to stop, set by a signal.
        realtime: one step in each control period of the wall clock; else as fast as possible.
        duration_s: max time of the scene; no limit if None.
        screen: display of the status.
        watchers: called after every step.
    """
    observation = session.observe()
    start_s, start_time_s, steps = time.perf_counter(), observation.time_s, 0
    pace = RealTimePacer(session.dt_s) if realtime else None
    pressed: list[TimedKey] = []
    painted, broken = -REFRESH_S, ""
    while not stop.requested:
        time_s = observation.time_s
        if screen is not None and time.perf_counter() - painted >= REFRESH_S:
            painted = time.perf_counter()
            overruns = None if pace is None else pace.overruns
            screen.paint(status.format_screen(title, session.robots, observation, pilot, overruns))
        for key in keys.read(time_s):
            pressed.append(TimedKey(time_s, key))
            pilot.press(key, time_s)
        # A thousandth of a period: times are sums in floating point.
        is_timed_out = (
            duration_s is not None and time_s - start_time_s > duration_s - 1e-3 * session.dt_s
        )
        if pilot.ended or is_timed_out or (duration_s is None and keys.finished):
            break
        try:
            observation = _step_session(session, pilot, observation)
        except RunError as error:  # the drive so far is kept
            broken = str(error)
            break
        steps += 1
        for watcher in watchers:
            watcher.after(observation)
        if pace is not None:
            pace.wait()
    return DriveResult(
        steps=steps,
        scene_s=observation.time_s - start_time_s,
        wall_s=time.perf_counter() - start_s,
        overruns=None if pace is None else pace.overruns,
        keys=tuple(pressed),
        last=observation,
        broken=broken,
    )


def _step_session(session: Session, pilot: TeleopPilot, observation: Observation) -> Observation:
    """Advance one step; a robot that has no plan to resume stops instead."""
    commands = pilot.build_commands(observation)
    for robot in commands.resume:
        try:
            session.resume_plan(robot)
        except ConfigError as error:
            pilot.refuse(robot, str(error), observation.time_s)
    return session.step(commands.commands)
