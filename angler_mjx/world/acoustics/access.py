"""Who may send when: slots in turn (TDMA), or whenever one likes (ALOHA), in slots or not.

Times are whole numbers of control steps, so that all worlds of a batch begin slots together.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Tdma:
    """One robot after the other; a slot ends when its packet has passed everybody."""

    slot: int
    """Control steps."""

    @property
    def period(self) -> int:
        """Control steps of which packets begin in none but the first, counted from t = 0.

        What came in in the others is understood by the next such step.
        """
        return self.slot


@dataclass(frozen=True, kw_only=True)
class Aloha:
    """Each robot by itself, now and then.

    In every chance it sends with one probability, but not while its last packet is on its way.
    """

    chance: int
    """Control steps from one chance to the next: a slot where there are some."""
    probability: float
    slotted: bool
    """Whether packets begin at the chance; otherwise anywhere between it and the next."""
    rests: int
    """Chances from a packet to the next that its sender may take."""
    look: int
    """Control steps from one time that robots are told what they heard to the next; divides the
    time from chance to chance."""

    @property
    def period(self) -> int:
        """As in `Tdma`: a chance is a whole number of looks."""
        return self.look


type Access = Tdma | Aloha


def build_tdma(packet_s: float, longest_s: float, dt_s: float) -> Tdma:
    """Slots of a packet and the longest way of sound, rounded up.

    Args:
        packet_s: duration of a packet.
        longest_s: time that sound takes across the region.
        dt_s: control period.
    """
    return Tdma(slot=_whole_steps(packet_s + longest_s, dt_s))


def build_slotted_aloha(packet_s: float, longest_s: float, dt_s: float, interval_s: float) -> Aloha:
    """Slots as in `build_tdma`, open to all.

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
    """Packets that begin at any time; arguments as in `build_slotted_aloha`.

    Chances come a quarter of a packet apart, or in every control step if that is longer: with each
    a robot is drawn to begin or not, and when before the next.
    """
    look = _look_steps(packet_s, dt_s)
    chance_s = look * dt_s
    rests = _whole_steps(packet_s + longest_s, chance_s) + 1
    # Mean time between packets: so many chances at rest, then a geometric number of them.
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
    """Least whole number of periods that is longer, by a thousandth of one for rounding."""
    return math.floor(time_s / dt_s + 1e-3) + 1
