"""Losses of a link, of a position and of command, found by the wall clock."""

import math
from dataclasses import dataclass
from typing import Literal

from angler_mjx.errors import ConfigError
from angler_sitl.steering.autopilot_commander import (
    ALT_HOLD_MODE,
    POSHOLD_MODE,
    SURFACE_MODE,
)
from angler_sitl.steering.vehicle_commander import VehicleCommander

type LossKind = Literal["link_lost", "position_lost", "autopilot_restarted"]
type EndAction = Literal["hold", "surface", "disarm"]
"""What vehicles are commanded at the end."""


@dataclass(frozen=True, kw_only=True)
class LossLimits:
    """Times after which something counts as lost, by the wall clock."""

    link_s: float = 2.0
    """Without any message of the autopilot."""
    position_s: float = 1.0
    """Without a good position, while other messages arrive."""

    def __post_init__(self) -> None:
        """Refuse times that are no numbers above 0.

        Raises:
            ConfigError: naming the flag and its value.
        """
        for flag, value in (("link", self.link_s), ("position", self.position_s)):
            if not 0.1 <= value < math.inf:
                raise ConfigError(f"--{flag}-timeout {value:g}: give at least 0.1, in s")


@dataclass(frozen=True, kw_only=True)
class Loss:
    """Loss of one robot."""

    kind: LossKind
    text: str


def find_loss(pilot: VehicleCommander, limits: LossLimits, time_s: float) -> Loss | None:
    """Return what is lost of a vehicle; None if nothing is.

    Args:
        pilot: after its tick.
        limits: limits.
        time_s: of the session.
    """
    link = pilot.link
    silent_s = time_s - link.heard_s
    if silent_s > limits.link_s:
        return Loss(kind="link_lost", text=f"{pilot.name}: no message for {silent_s:.1f} s")
    if link.has_restarted:
        return Loss(
            kind="autopilot_restarted", text=f"{pilot.name}: the clock of its autopilot restarted"
        )
    blind_s = measure_blindness(pilot)
    if blind_s > limits.position_s:
        ignored = ", ".join(f"{count} {name}" for name, count in sorted(link.counts.items()))
        detail = f"; ignored messages: {ignored}" if ignored else ""
        return Loss(
            kind="position_lost",
            text=f"{pilot.name}: no good position for {blind_s:.1f} s ({pilot.note()}{detail})",
        )
    return None


def measure_blindness(pilot: VehicleCommander) -> float:
    """Return for how long messages have come without a good position, s."""
    return max(0.0, pilot.link.heard_s - pilot.position_good_s)


def is_followed(pilot: VehicleCommander, action: EndAction, *, has_position: bool) -> bool:
    """Return whether the heartbeat of a vehicle shows the action of the end."""
    if not pilot.armed:
        return True
    return action != "disarm" and pilot.mode == find_mode(action, has_position=has_position)


def command_action(pilot: VehicleCommander, action: EndAction, *, has_position: bool) -> None:
    """Command the action of the end once; it may not arrive.

    Args:
        pilot: of the vehicle.
        action: hold: POSHOLD, or ALT_HOLD without a position; surface: SURFACE; disarm.
        has_position: whether its position is good.
    """
    if action == "disarm":
        pilot.disarm()
    else:
        pilot.set_mode(find_mode(action, has_position=has_position))


def find_mode(action: EndAction, *, has_position: bool) -> int:
    """Return the firmware's number of the mode of an action."""
    if action == "surface":
        return SURFACE_MODE
    return POSHOLD_MODE if has_position else ALT_HOLD_MODE
