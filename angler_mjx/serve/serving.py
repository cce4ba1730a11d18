"""A served session from start to end: transports, session, recording, loop."""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from angler_mjx.errors import ConfigError, RunError, format_value
from angler_mjx.files import JsonTable
from angler_mjx.runs.session.recording import RecordedCourse, SessionRecording
from angler_mjx.runs.storage import folder
from angler_mjx.runs.storage.folder import Run
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.serve.backends.interface import Backend
from angler_mjx.serve.door import Door, DoorResult, DoorSettings, Pace
from angler_mjx.teleop import opening
from angler_mjx.teleop.loop import Watcher
from angler_mjx.teleop.signals import break_on_signal, stop_on_signal


@dataclass(frozen=True, kw_only=True)
class ServeSettings:
    """Settings from the command line."""

    pace: Pace = 1.0
    world: int = 0
    silence_s: float = 0.5
    duration_s: float | None = None
    out: Path | None = None
    """Run folder to create."""

    def __post_init__(self) -> None:
        """Refuse invalid numbers.

        Raises:
            ConfigError: naming the flag and its value.
        """
        numbers = {"silence": self.silence_s, "duration": self.duration_s}
        for flag, value in numbers.items():
            if value is not None and not 0.0 < value < math.inf:
                raise ConfigError(f"--{flag} {value:g}: give a number above 0")
        if not 0 <= self.world < 2**31:
            raise ConfigError(
                f"--world {format_value(self.world)}: give an index from 0 to {2**31 - 1}"
            )


def parse_pace(text: str) -> Pace:
    """Return a pace: ``max``, ``step``, or a multiple of real time.

    Raises:
        ConfigError: the text is none of them.
    """
    if text in ("max", "step"):
        return text  # type: ignore[return-value]
    try:
        factor = 1.0 if text == "real" else float(text)
    except ValueError:
        factor = math.nan
    if not 0.0 < factor < math.inf:
        raise ConfigError(
            f"--pace {text}: give real, max, step, or a multiple of real time above 0"
        )
    return factor


def serve_session(
    scenario: Scenario,
    settings: ServeSettings,
    open_backends: Sequence[Callable[[], Backend]],
    report: Callable[[str], None],
    opener: opening.SessionOpener = opening.open_simulated,
) -> tuple[DoorResult, Run | None]:
    """Serve one world of a scenario.

    Args:
        scenario: source of the world and robots.
        settings: settings.
        open_backends: openers of transports; they are opened before the session, so that a port in
            use is noticed at once.
        report: receives the addresses, and what happens.
        opener: of the session.

    Returns:
        Result, and the run folder if requested and at least one step was made.

    Raises:
        ConfigError: the scenario, a setting or an address cannot be used.
        UnsupportedError: a library is not installed.
        RunError: the session broke off, or writing to the disk failed.
    """
    with ExitStack() as stack:
        interrupt = stack.enter_context(break_on_signal())
        backends = []
        for open_backend in open_backends:
            backend = open_backend()
            stack.callback(backend.close)
            backends.append(backend)
        recording = None
        if settings.out is not None:
            recording = stack.enter_context(
                SessionRecording(settings.out, scenario, settings.world)
            )
        start_s = time.perf_counter()
        logs = None if recording is None else recording.building / folder.ROBOTS
        opened = opener(scenario, settings.world, logs, report)
        compile_s = time.perf_counter() - start_s
        stack.callback(opened.session.close)
        interrupt.check()
        watchers: list[Watcher] = [*opened.watchers]
        if recording is not None:
            recording.begin(opened.session)
            watchers.append(recording)
        door = Door(
            opened.session,
            scenario,
            backends,
            DoorSettings(
                pace="max" if opened.is_real else settings.pace,  # it paces itself
                silence_s=settings.silence_s,
                duration_s=settings.duration_s,
                can_reset=recording is None,
                is_real=opened.is_real,
            ),
            report,
            watchers,
        )
        interrupt.check()
        for backend in backends:
            report(f"{scenario.name}, world {settings.world}: {backend.address}")
            if backend.missing:
                report(f"{backend.address}: without {', '.join(backend.missing)}")
        if opened.begin is not None:
            opened.begin()
        stop = stack.enter_context(stop_on_signal())
        result = door.run(stop)
        stop.closing = True
        finished = {} if opened.finish is None else opened.finish()
        recorded = None
        if recording is not None and result.steps:
            recorded = recording.close(
                RecordedCourse(
                    steps=result.steps,
                    wall_s=result.wall_s,
                    compile_s=compile_s,
                    more={"served": _build_summary(result), **finished},
                    interrupted=result.broken,
                )
            )
    if result.broken:
        note = "" if recorded is None else f"; what was flown until then is in {recorded.path}"
        raise RunError(result.broken + note)
    return result, recorded


def _build_summary(result: DoorResult) -> JsonTable:
    overruns = result.overruns
    return {
        "steps": result.steps,
        "scene_s": result.scene_s,
        "overruns": None if overruns is None else overruns.count,
        "received": result.received,
        "refused": result.refused,
        "sent": result.sent,
    }
