"""The session that is driven: the one place that knows which kinds there are."""

import contextlib
from collections.abc import Callable
from typing import Literal, Protocol

import jax.numpy as jnp

from angler_mjx.control.commands import BodyTwist
from angler_mjx.errors import ConfigError, UnsupportedError
from angler_mjx.runs.scenario import Scenario
from angler_mjx.session.batch import BatchSession
from angler_mjx.session.interface import Session
from angler_mjx.teleop.recording import Recordable

type Kind = Literal["batch", "sitl"]


class Drivable(Session, Recordable, Protocol):
    """A session that can be driven and recorded."""


def open_session(
    kind: Kind, scenario: Scenario, world: int, tell: Callable[[str], None] | None = None
) -> Drivable:
    """The session of a kind, compiled and reset.

    Args:
        kind: what stands behind it.
        scenario: whose world and robots.
        world: global index of the world.
        tell: told that it takes a while.

    Raises:
        ConfigError: there is no such world.
        UnsupportedError: the kind is not there.
    """
    if world < 0:
        raise ConfigError(f"--world {world}: give an index from 0 on")
    if kind == "sitl":
        raise UnsupportedError(
            "--session sitl: driving real autopilots needs the SITL bridge, which is not there "
            "yet; use --session batch"
        )
    if tell is not None:
        tell(f"{scenario.name}: drawing and compiling world {world} ...")
    session = BatchSession(scenario, world=world)
    _compile(session)
    session.reset()
    return session


def _compile(session: BatchSession) -> None:
    """Let a simulated scene compile now what a key would otherwise wait for while it is driven."""
    session.reset()
    session.step({0: BodyTwist(nu=jnp.zeros(6))})
    with contextlib.suppress(ConfigError):  # it may have no plan
        session.resume_plan(0)
    session.step()


def choose(text: str | None, robots: int) -> tuple[int, ...]:
    """Indices of the robots to drive; all of them if nothing is given.

    Args:
        text: as in ``0,2``.
        robots: how many there are.

    Raises:
        ConfigError: the text is something else, or one of them is not there.
    """
    if text is None:
        return tuple(range(robots))
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() for part in parts):
        raise ConfigError(f"--robots {text}: give indices with commas between them, as in 0,2")
    chosen = tuple(dict.fromkeys(int(part) for part in parts))
    if bad := [i for i in chosen if i >= robots]:
        raise ConfigError(
            f"--robots {text}: there is no robot {bad[0]}; the scenario has 0 to {robots - 1}"
        )
    return chosen
