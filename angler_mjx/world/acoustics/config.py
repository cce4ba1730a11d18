"""The acoustics table of a scenario file."""

from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel
from angler_mjx.quantities import PositiveLength
from angler_mjx.world.acoustics import access, sound
from angler_mjx.world.acoustics.access import Access, Aloha, Tdma
from angler_mjx.world.acoustics.channel import Channel
from angler_mjx.world.acoustics.link import (
    Fading,
    Link,
    LinkBudget,
    Modulation,
    RangeLink,
    to_decibels,
)
from angler_mjx.world.acoustics.shadow import RockLoss

MIN_SUCCESS = 1e-3
"""Min success probability next to the sender; a channel below it passes no packets."""


class AcousticsConfig(FileModel):
    """Messages with positions and progress between robots; see `docs/reference/acoustics.md`."""

    model: Literal["perfect", "range", "budget"] = "perfect"
    """perfect: instant and complete communication. range: packets are received within `range_m`.
    budget: by signal and noise at the receiver, bit by bit."""
    range_m: PositiveLength | None = None
    """Range of the model range."""
    access: Literal["tdma", "aloha", "slotted_aloha"] = "tdma"
    """Medium access: slots in turn, at random times, or at random in slots."""
    interval_s: float = Field(default=10.0, gt=0.0, le=86400.0)
    """Mean time between packets of a robot with random access."""
    guard_s: float | None = Field(default=None, ge=0.0, le=60.0)
    """Rest of a slot after its packet; the travel time of sound across the region if left out, and
    no shorter."""
    bits: int = Field(default=128, ge=1, le=10**6)
    """Total number of bits of a packet."""
    bit_rate_bps: float = Field(default=640.0, gt=0.0, le=1e6)
    """Bit rate of the modem."""
    lost_after_s: float = Field(default=60.0, gt=0.0, le=86400.0)
    """Silence after which a robot is considered broken down, and others take over its part of a
    task."""
    sound_mps: float | None = Field(default=None, ge=1300.0, le=1700.0)
    """Speed of sound; by Mackenzie's equation if left out."""
    temperature_c: float = Field(default=10.0, ge=0.0, le=35.0)
    """Temperature of the water."""
    salinity_ppt: float = Field(default=35.0, ge=0.0, le=45.0)
    """Salinity in parts per thousand: 35 in the ocean, 0 in lakes."""
    depth_m: float = Field(default=10.0, ge=0.0, le=8000.0)
    """Depth of the fleet, for speed and absorption of sound."""
    ph: float = Field(default=8.0, ge=7.0, le=9.0)
    """pH of the water, for its absorption."""
    absorption: Literal["thorp", "francois_garrison", "ainslie_mccolm"] = "francois_garrison"
    """Absorption model."""
    spreading: float = Field(default=1.5, ge=1.0, le=2.0)
    """Spreading exponent of the distance: 1 between surface and floor, 2 in open water, 1.5 as the
    usual compromise."""
    frequency_khz: float = Field(default=28.0, ge=0.1, le=1000.0)
    """Centre of the modem's band."""
    bandwidth_khz: float = Field(default=8.0, gt=0.0, le=1000.0)
    """Width of the modem's band."""
    source_level_db: float = Field(default=168.0, ge=60.0, le=220.0)
    """Source level of the sender, dB re 1 uPa at 1 m."""
    modulation: Modulation = "bpsk"
    """Modulation: bpsk, coherent phase shift keying, or fsk, noncoherent frequency shift keying."""
    fading: Fading = "rayleigh"
    """Fading of the channel: rayleigh, bit by bit, or none."""
    shipping: float = Field(default=0.5, ge=0.0, le=1.0)
    """Distant shipping, for the noise: 0 for none to 1 for dense."""
    wind_mps: float = Field(default=5.0, ge=0.0, le=50.0)
    """Wind speed, for the noise of waves."""
    self_noise_db: float | None = Field(default=None, ge=-50.0, le=200.0)
    """Spectral density of the receiver's own noise, dB re 1 uPa^2/Hz, added to that of the sea;
    none if left out."""
    rock: Literal["cuts", "damps", "lets_pass"] = "cuts"
    """Effect of rock on the straight path: cuts, damps or lets sound pass."""
    rock_db_per_m: float = Field(default=10.0, ge=0.0, le=1000.0)
    """Loss in damping rock."""

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        if self.model == "range" and self.range_m is None:
            raise ValueError('model = "range": give range_m, how far packets are heard')
        if 0.5 * self.bandwidth_khz >= self.frequency_khz:
            raise ValueError(
                f"bandwidth_khz = {self.bandwidth_khz:g}: reaches down to no sound at all about "
                f"frequency_khz = {self.frequency_khz:g}; take a narrower band"
            )
        return self

    def channel(
        self, robots: int, size_m: tuple[float, float, float], control_dt_s: float, horizon_s: float
    ) -> Channel | None:
        """Return the shared channel of the robots; None where communication is perfect.

        Args:
            robots: number of robots that share it.
            size_m: edges of the region.
            control_dt_s: control period.
            horizon_s: horizon of an episode.

        Raises:
            ValueError: no packet is received, or not in time.
        """
        if self.model == "perfect":
            return None
        link = self.link()
        if link.success(np.array(1.0), 0.0) < MIN_SUCCESS:
            raise ValueError(self._unheard_message(link))
        packet_s, speed = self.bits / self.bit_rate_bps, self.speed_mps()
        across_s = sum(edge**2 for edge in size_m) ** 0.5 / speed
        turns = self._build_access(robots, packet_s, across_s, control_dt_s)
        if isinstance(turns, Tdma) and turns.slot * control_dt_s * robots > horizon_s:
            raise ValueError(
                f"bits = {self.bits}: {robots} slots of {turns.slot * control_dt_s:g} s are longer "
                f"than the horizon, {horizon_s:g} s, so that not every robot gets its turn; take "
                "fewer bits, a higher bit_rate_bps, or a longer time.horizon_s"
            )
        rock = None
        if self.rock != "lets_pass":
            rock = RockLoss(db_per_m=None if self.rock == "cuts" else self.rock_db_per_m)
        return Channel(
            access=turns,
            link=link,
            rock=rock,
            sound_mps=speed,
            packet_s=packet_s,
            dt_s=control_dt_s,
            lost_after_s=self.lost_after_s,
        )

    def speed_mps(self) -> float:
        """Return the speed of sound."""
        if self.sound_mps is not None:
            return self.sound_mps
        return sound.speed_mps(self.temperature_c, self.salinity_ppt, self.depth_m)

    def absorption_db_per_km(self) -> float:
        """Return the absorption at the middle of the band."""
        water = (self.temperature_c, self.salinity_ppt, self.depth_m, self.ph)
        if self.absorption == "thorp":
            return sound.thorp_db_per_km(self.frequency_khz)
        if self.absorption == "ainslie_mccolm":
            return sound.ainslie_mccolm_db_per_km(self.frequency_khz, *water)
        return sound.francois_garrison_db_per_km(self.frequency_khz, *water)

    def noise_db(self) -> float:
        """Return the spectral density of the noise at the middle of the band, dB re 1 uPa^2/Hz."""
        ambient = sound.ambient_db(self.frequency_khz, self.shipping, self.wind_mps)
        if self.self_noise_db is None:
            return ambient
        return sound.added_db(ambient, self.self_noise_db)

    def link(self) -> Link:
        """Return the link from one robot to another."""
        if self.model == "range":
            return RangeLink(range_m=self.range_m or 0.0)
        band_hz = 1e3 * self.bandwidth_khz
        return LinkBudget(
            snr_db=self.source_level_db - self.noise_db() - to_decibels(band_hz),
            bit_db=to_decibels(band_hz / self.bit_rate_bps),
            spreading=self.spreading,
            absorption_db_per_m=1e-3 * self.absorption_db_per_km(),
            bits=self.bits,
            modulation=self.modulation,
            fading=self.fading,
        )

    def _build_access(
        self, robots: int, packet_s: float, across_s: float, control_dt_s: float
    ) -> Access:
        if self.guard_s is not None and self.guard_s < across_s:
            raise ValueError(
                f"guard_s = {self.guard_s:g}: sound takes {across_s:.3g} s across the region, so "
                "packets would run into those of the next slot; leave it out, or give more"
            )
        guard_s = across_s if self.guard_s is None else self.guard_s
        if self.access == "tdma":
            return access.build_tdma(packet_s, guard_s, control_dt_s)
        make = (
            access.build_slotted_aloha
            if self.access == "slotted_aloha"
            else access.build_pure_aloha
        )
        made: Aloha = make(packet_s, guard_s, control_dt_s, self.interval_s)
        if made.probability > 1.0:
            raise ValueError(
                f"interval_s = {self.interval_s:g}: a packet of {packet_s:.3g} s is on its way for "
                f"up to {packet_s + guard_s:.3g} s, and only one of each robot is at a time; give "
                "more"
            )
        return made

    def _unheard_message(self, link: Link) -> str:
        if isinstance(link, RangeLink):
            return f"range_m = {link.range_m:g}: no robot is so near to another; give more"
        return (
            f"source_level_db = {self.source_level_db:g}: {link.snr_db:.3g} dB over the noise at "
            f"1 m, so that not one in a thousand packets of {self.bits} bits gets through; raise "
            "it, or take fewer bits or less noise"
        )


def refuse_acoustics(table: AcousticsConfig, reason: str) -> None:
    """Refuse acoustics where no robot would receive packets.

    Args:
        table: acoustics table of a scenario.
        reason: text of the message: the limit, and an alternative.

    Raises:
        ConfigError: communication is not perfect.
    """
    if table.model != "perfect":
        raise ConfigError(f"acoustics.model = {table.model!r}: {reason}")
