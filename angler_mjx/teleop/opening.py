"""Session to drive: a simulated one by default, or another by a custom opener."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import jax.numpy as jnp

from angler_mjx.errors import ConfigError
from angler_mjx.files import JsonTable
from angler_mjx.robot.control.commands import BodyTwist
from angler_mjx.runs.session.batch_session import BatchSession
from angler_mjx.runs.session.interface import Session
from angler_mjx.runs.session.recording import Recordable
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.teleop.loop import Watcher

type Report = Callable[[str], None]
"""Receiver of the reason of a delay before the start."""


class Drivable(Session, Recordable, Protocol):
    """Session that can be driven and recorded."""


@dataclass(frozen=True, kw_only=True)
class OpenedSession:
    """Session that is ready, with the watchers of its steps."""

    session: Drivable
    watchers: Sequence[Watcher] = ()
    is_real: bool = False
    """Whether the robots are outside the simulator: time cannot stop, and instruments are not
    simulated. Such a session paces itself."""
    begin: Callable[[], None] | None = None
    """Called once before the first step, when nothing has to be compiled any more."""
    finish: Callable[[], JsonTable] | None = None
    """Called once after the last step; returns further keys of the run's summary."""


type SessionOpener = Callable[[Scenario, int, Path | None, Report | None], OpenedSession]
"""Opener of a session.

Its arguments are the scenario, the index of the world, a folder for the robots' own logs (None: no
logs), and the report."""


def open_simulated(
    scenario: Scenario, world: int, _: Path | None = None, report: Report | None = None
) -> OpenedSession:
    """Open one world of the simulator, compiled and reset.

    Args:
        scenario: source of the world and robots.
        world: global index of the world.
        _: simulated robots keep no logs.
        report: receives a notice of the delay.

    Raises:
        ConfigError: there is no such world.
    """
    if report is not None:
        report(f"{scenario.name}: drawing and compiling world {world} ...")
    session = BatchSession(scenario, world=world)
    _warm_up(session)
    session.reset()
    return OpenedSession(session=session)


def _warm_up(session: BatchSession) -> None:
    """Compile a simulated scene's commands, so that no key waits for a compiler later."""
    session.reset()
    session.step({0: BodyTwist(nu=jnp.zeros(6))})
    with contextlib.suppress(ConfigError):  # it may have no plan
        session.resume_plan(0)
    session.step()


def parse_robots(text: str | None, robots: int) -> tuple[int, ...]:
    """Return the indices of the robots to drive; all robots by default.

    Args:
        text: as in ``0,2``.
        robots: number of robots.

    Raises:
        ConfigError: the text has another format, or a robot does not exist.
    """
    if text is None:
        return tuple(range(robots))
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() for part in parts):
        raise ConfigError(f"--robots {text}: give indices with commas between them, as in 0,2")
    selected = tuple(dict.fromkeys(int(part) for part in parts))
    if bad := [i for i in selected if i >= robots]:
        raise ConfigError(
            f"--robots {text}: there is no robot {bad[0]}; the scenario has 0 to {robots - 1}"
        )
    return selected
