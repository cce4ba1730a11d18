"""Medium access: slots in turn (TDMA), or random access (ALOHA), slotted or not.

Times are whole numbers of control steps, so that all worlds of a batch begin slots together.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Tdma:
    """Robots send in turn; a slot ends when its packet has passed all receivers."""

    slot: int
    """Length of a slot in control steps."""

    @property
    def period(self) -> int:
        """Return the period in control steps of the steps in which packets begin, from t = 0.

        Packets that arrive in between are received at the next such step.
        """
        return self.slot


@dataclass(frozen=True, kw_only=True)
class Aloha:
    """Each robot sends at random.

    At each chance it sends with a fixed probability, but not while its last packet is in flight.
    """

    chance: int
    """Control steps from one chance to the next: a slot in slotted access."""
    probability: float
    slotted: bool
    """Whether packets begin at the chance; if not, at any time between it and the next."""
    rests: int
    """Number of chances that a sender skips after a packet."""
    look: int
    """Control steps between two receptions by the robots; divides the steps between chances."""

    @property
    def period(self) -> int:
        """Return the period as in `Tdma`: a chance is a whole number of looks."""
        return self.look


type Access = Tdma | Aloha


def build_tdma(packet_s: float, longest_s: float, dt_s: float) -> Tdma:
    """Return slots of a packet and the max travel time of sound, rounded up.

    Args:
        packet_s: duration of a packet.
        longest_s: time that sound takes across the region.
        dt_s: control period.
    """
    return Tdma(slot=_whole_steps(packet_s + longest_s, dt_s))


def build_slotted_aloha(packet_s: float, longest_s: float, dt_s: float, interval_s: float) -> Aloha:
    """Return slots as in `build_tdma`, open to all robots.

    Args:
        packet_s: duration of a packet.
        longest_s: time that sound takes across the region.
        dt_s: control period.
        interval_s: mean time between packets of one robot.
    """
    look = _look_steps(packet_s, dt_s)
    slot = look * math.ceil(_whole_steps(packet_s + longest_s, dt_s) / look)
    return Aloha(
        chance=slot,
        probability=slot * dt_s / interval_s,
        slotted=True,
        rests=1,
        look=look,
    )


def build_pure_aloha(packet_s: float, longest_s: float, dt_s: float, interval_s: float) -> Aloha:
    """Return access with packets at any time; arguments as in `build_slotted_aloha`.

    Chances are a quarter of a packet apart, or one in each control step if that is longer: at each
    chance it is sampled whether and when before the next chance the robot begins.
    """
    look = _look_steps(packet_s, dt_s)
    chance_s = look * dt_s
    rests = _whole_steps(packet_s + longest_s, chance_s) + 1
    # Mean time between packets: the skipped chances, then a geometric number of them.
    free = interval_s / chance_s - rests + 1
    return Aloha(
        chance=look,
        probability=1.0 / free if free > 0.0 else math.inf,
        slotted=False,
        rests=rests,
        look=look,
    )


def _look_steps(packet_s: float, dt_s: float) -> int:
    return max(1, math.floor(0.25 * packet_s / dt_s))


def _whole_steps(time_s: float, dt_s: float) -> int:
    """Return the least whole number of periods above a time; a thousandth covers rounding."""
    return math.floor(time_s / dt_s + 1e-3) + 1
