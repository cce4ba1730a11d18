"""Teleoperation from start to end: session, keys, screen, recording and viewer combined."""

import math
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from angler_mjx.errors import ConfigError, RunError, format_value
from angler_mjx.files import JsonTable
from angler_mjx.report.viewing import replay, viewer_window
from angler_mjx.runs.session.recording import RecordedCourse, SessionRecording
from angler_mjx.runs.storage import folder
from angler_mjx.runs.storage.atomic_files import wrap_write_errors
from angler_mjx.runs.storage.folder import Run
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.teleop import live_view, opening, script
from angler_mjx.teleop.loop import DriveResult, Watcher, drive_session
from angler_mjx.teleop.pilot import KEY_TIMEOUT_S, TeleopPilot
from angler_mjx.teleop.script import KeyScript
from angler_mjx.teleop.signals import StopRequest, break_on_signal, stop_on_signal
from angler_mjx.teleop.terminal import Keyboard, Screen, has_screen

KEYS_FILE = "keys.txt"
"""File of the pressed keys in a run folder; as a script they repeat the drive of the scene."""


class TeleopRecording(SessionRecording):
    """Run folder in progress; see `SessionRecording`."""

    def finish(self, driven: DriveResult, compile_s: float) -> Run | None:
        """Write the run.

        Args:
            driven: result of the drive.
            compile_s: seconds of compilation.

        Returns:
            The run; None if not even one step was driven.

        Raises:
            RunError: writing to the disk failed.
        """
        if not driven.steps:
            return None
        path = self.building / KEYS_FILE
        with wrap_write_errors(path):
            script.save_keys(path, driven.keys)
        return self.close(
            RecordedCourse(
                steps=driven.steps,
                wall_s=driven.wall_s,
                compile_s=compile_s,
                more={"teleop": _build_summary(driven)},
                interrupted=driven.broken,
            )
        )


def _build_summary(driven: DriveResult) -> JsonTable:
    overruns = driven.overruns
    return {
        "steps": driven.steps,
        "scene_s": driven.scene_s,
        "realtime": overruns is not None,
        "overruns": None if overruns is None else overruns.count,
        "worst_overrun_s": None if overruns is None else overruns.worst_s,
        "keys": len(driven.keys),
    }


@dataclass(frozen=True, kw_only=True)
class TeleopSettings:
    """Teleoperation settings from the command line."""

    robots: str | None = None
    """Driven robots, as in ``0,2``; all if None."""
    script: Path | None = None
    """File of keys; the keyboard if None."""
    realtime: bool = True
    """Whether to keep real time; always with the keyboard."""
    out: Path | None = None
    """Run folder to create."""
    world: int = 0
    rerun: bool = False
    duration_s: float | None = None
    speed_mps: float = 0.5
    turn_radps: float = 0.5
    silence_s: float = KEY_TIMEOUT_S

    def __post_init__(self) -> None:
        """Refuse invalid numbers.

        Raises:
            ConfigError: naming the flag and its value.
        """
        flags = {
            "duration": self.duration_s,
            "speed": self.speed_mps,
            "turn": self.turn_radps,
            "silence": self.silence_s,
        }
        for flag, value in flags.items():
            if value is not None and not 0.0 < value < math.inf:
                raise ConfigError(f"--{flag} {value:g}: give a number above 0")


def run_teleop(
    scenario: Scenario,
    settings: TeleopSettings,
    report: opening.Report | None = None,
    opener: opening.SessionOpener = opening.open_simulated,
) -> tuple[DriveResult, Run | None]:
    """Drive robots of one world of a scenario.

    Args:
        scenario: source of the world and robots.
        settings: driven robots, and options.
        report: receives the reason of the delay before the start.
        opener: of the session to drive.

    Returns:
        Result of the drive, and the run folder if requested and at least one step was driven.

    Raises:
        ConfigError: the scenario or the settings cannot be used; nothing is left.
        UnsupportedError: the viewer is not installed.
        RunError: the session broke off, and the run folder holds the drive until then; or writing
            to the disk failed, and the hidden folder keeps its files.
    """
    if not 0 <= settings.world < 2**31:
        raise ConfigError(
            f"--world {format_value(settings.world)}: give an index from 0 to {2**31 - 1}"
        )
    robots = opening.parse_robots(settings.robots, len(scenario.members()))
    keys = Keyboard() if settings.script is None else KeyScript(script.load_keys(settings.script))
    if settings.rerun:
        live_view.require_viewer(settings.out)
    with ExitStack() as stack:
        interrupt = stack.enter_context(break_on_signal())
        recording = None
        if settings.out is not None:
            recording = stack.enter_context(TeleopRecording(settings.out, scenario, settings.world))
        start_s = time.perf_counter()
        logs = None if recording is None else recording.building / folder.ROBOTS
        opened = opener(scenario, settings.world, logs, report)
        session = opened.session
        compile_s = time.perf_counter() - start_s
        stack.callback(session.close)
        interrupt.check()
        pilot = TeleopPilot(
            session.robots,
            robots,
            speed_mps=settings.speed_mps,
            turn_radps=settings.turn_radps,
            silence_s=settings.silence_s,
        )
        title = f"{scenario.name}, world {settings.world}"
        watchers: list[Watcher] = [*opened.watchers]
        if recording is not None:
            recording.begin(session)
            watchers.append(recording)
        if settings.rerun and viewer_window.has_display():
            watchers.append(live_view.open_viewer(session, pilot, title, settings.world))
        stop = stack.enter_context(stop_on_signal())
        result = _drive_session(session, pilot, keys, title, stop, settings, watchers)
        stop.closing = True
        recorded = None if recording is None else recording.finish(result, compile_s)
        if recorded is not None and settings.rerun:
            replay.write_replay(recorded)
    if result.broken:
        note = "" if recorded is None else f"; what was driven until then is in {recorded.path}"
        raise RunError(result.broken + note)
    return result, recorded


def _drive_session(
    session: opening.Drivable,
    pilot: TeleopPilot,
    keys: Keyboard | KeyScript,
    title: str,
    stop: StopRequest,
    settings: TeleopSettings,
    watchers: Sequence[Watcher],
) -> DriveResult:
    """Drive with the terminal taken over, if there is one, and restore it."""
    with ExitStack() as terminal:
        screen = terminal.enter_context(Screen()) if has_screen() else None
        if isinstance(keys, Keyboard):
            terminal.enter_context(keys)
        return drive_session(
            session,
            pilot,
            keys,
            title=title,
            stop=stop,
            realtime=settings.realtime or settings.script is None,
            duration_s=settings.duration_s,
            screen=screen,
            watchers=watchers,
        )
