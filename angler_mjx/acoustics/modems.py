"""Numbers of modems that are built small enough for vehicles such as these."""

from dataclasses import dataclass

from angler_mjx.acoustics.link import Modulation


@dataclass(frozen=True, kw_only=True)
class Modem:
    """What a maker or its builders say."""

    frequency_khz: float
    """Middle of the band."""
    bandwidth_khz: float
    source_level_db: float
    """dB re 1 uPa at 1 m."""
    bit_rate_bps: float
    modulation: Modulation
    range_m: float
    """As far as it is said to reach."""


MODEMS: dict[str, Modem] = {}
