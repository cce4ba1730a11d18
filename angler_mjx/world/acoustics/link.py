"""Whether a packet gets through from one robot to another.

Functions of distance for arrays of NumPy and of JAX alike: files are checked without a device.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import scipy.special
from jax.scipy.special import erfc

type Modulation = Literal["bpsk", "fsk"]
"""Coherent binary phase shift keying, or binary frequency shift keying without a phase."""
type Fading = Literal["none", "rayleigh"]
"""Of bits: none, as in white noise alone, or of a channel without a steady path, bit by bit."""

NEAREST_M = 1.0
"""Source levels are those at 1 m; nearer is no louder."""


@dataclass(frozen=True, kw_only=True)
class RangeLink:
    """Everything is heard within a range, and nothing beyond it."""

    range_m: float

    def success(self, distance_m: Any, rock_db: Any) -> Any:
        """Probability [...] that a packet is understood, 0 or 1.

        Args:
            distance_m: [...] from sender to receiver.
            rock_db: [...] loss in rock; any is too much.
        """
        return 1.0 * ((distance_m <= self.range_m) & (rock_db <= 0.0))

    def loud(self, distance_m: Any, rock_db: Any) -> Any:
        """Whether it drowns another packet, bool [...]; arguments as in `success`."""
        return self.success(distance_m, rock_db) > 0.0


@dataclass(frozen=True, kw_only=True)
class LinkBudget:
    """Sound that spreads, is absorbed, and comes in among noise."""

    snr_db: float
    """Signal over noise, both over the band of the modem, at 1 m."""
    bit_db: float
    """Energy of a bit over the density of the noise, less the ratio before: band over bit rate."""
    spreading: float
    """Exponent k of the distance: 1 cylindrical, 2 spherical."""
    absorption_db_per_m: float
    bits: int
    """Of a packet; all have to be right."""
    modulation: Modulation
    fading: Fading

    def snr(self, distance_m: Any, rock_db: Any) -> Any:
        """Signal over noise [...] at the receiver, dB; arguments as in `success`."""
        loss = transmission_loss_db(distance_m, self.spreading, self.absorption_db_per_m)
        return self.snr_db - loss - rock_db

    def success(self, distance_m: Any, rock_db: Any) -> Any:
        """Probability [...] that a packet is understood.

        Args:
            distance_m: [...] from sender to receiver.
            rock_db: [...] loss in rock.
        """
        ratio = 10.0 ** (0.1 * (self.snr(distance_m, rock_db) + self.bit_db))
        return packet_success(bit_error(ratio, self.modulation, self.fading), self.bits)

    def loud(self, distance_m: Any, rock_db: Any) -> Any:
        """Whether it drowns another packet, bool [...]: where it is louder than the noise."""
        return self.snr(distance_m, rock_db) > 0.0


type Link = RangeLink | LinkBudget


def transmission_loss_db(distance_m: Any, spreading: float, absorption_db_per_m: float) -> Any:
    """Loss [...] from 1 m to a distance, dB: ``10 k log10(r) + a r``.

    Urick, Principles of Underwater Sound, 3rd ed., 1983, ch. 5; Stojanovic, On the relationship
    between capacity and distance in an underwater acoustic communication channel, 2007.

    Args:
        distance_m: [...]
        spreading: k.
        absorption_db_per_m: a.
    """
    of = _array_module(distance_m)
    far = of.maximum(distance_m, NEAREST_M)
    return 10.0 * spreading * of.log10(far) + absorption_db_per_m * far


def bit_error(ratio: Any, modulation: Modulation, fading: Fading) -> Any:
    """Probability [...] that a bit comes out wrong.

    Proakis, Salehi, Digital Communications, 5th ed., 2008: sections 4.3 and 4.5 in white noise,
    13.3 in Rayleigh fading, where ``ratio`` is its mean.

    Args:
        ratio: [...] energy of a bit over the density of the noise.
        modulation: of the modem.
        fading: of the channel.
    """
    of = _array_module(ratio)
    if modulation == "bpsk":
        if fading == "none":
            complement = erfc if of is jnp else scipy.special.erfc
            return 0.5 * complement(of.sqrt(ratio))
        # 1 - sqrt(g / (1 + g)) without taking like numbers from each other.
        root = of.sqrt(ratio / (1.0 + ratio))
        return 0.5 / ((1.0 + ratio) * (1.0 + root))
    if fading == "none":
        return 0.5 * of.exp(-0.5 * ratio)
    return 1.0 / (2.0 + ratio)


def packet_success(error: Any, bits: int) -> Any:
    """Probability [...] that all bits are right, each of which is wrong with ``error`` [...]."""
    of = _array_module(error)
    return of.exp(bits * of.log1p(-error))


def to_decibels(ratio: float) -> float:
    """A ratio of powers in dB."""
    return 10.0 * math.log10(ratio)


def _array_module(values: Any) -> Any:
    return jnp if isinstance(values, jax.Array) else np
