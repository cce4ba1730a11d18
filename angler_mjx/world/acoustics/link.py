"""Probability that a packet is received from another robot.

Functions of distance for NumPy and JAX arrays: files are checked without a device.
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
"""Coherent binary phase shift keying, or noncoherent binary frequency shift keying."""
type Fading = Literal["none", "rayleigh"]
"""Fading of bits: none, in white noise only, or Rayleigh, of a channel without a steady path."""

NEAREST_M = 1.0
"""Reference distance of source levels; sound is no louder at shorter distances."""


@dataclass(frozen=True, kw_only=True)
class RangeLink:
    """A link with reception within a range, and none beyond it."""

    range_m: float

    def success(self, distance_m: Any, rock_db: Any) -> Any:
        """Return the probability [...] that a packet is received, 0 or 1.

        Args:
            distance_m: [...] from sender to receiver.
            rock_db: [...] loss in rock; any loss blocks the packet.
        """
        return 1.0 * ((distance_m <= self.range_m) & (rock_db <= 0.0))

    def loud(self, distance_m: Any, rock_db: Any) -> Any:
        """Return whether a packet interferes with others, bool [...]; arguments as in `success`."""
        return self.success(distance_m, rock_db) > 0.0


@dataclass(frozen=True, kw_only=True)
class LinkBudget:
    """A link by spreading, absorption, and noise."""

    snr_db: float
    """Signal-to-noise ratio over the band of the modem, at 1 m."""
    bit_db: float
    """Bit energy over noise density, relative to ``snr_db``: band over bit rate."""
    spreading: float
    """Exponent k of the distance: 1 cylindrical, 2 spherical."""
    absorption_db_per_m: float
    bits: int
    """Number of bits of a packet; all must be correct."""
    modulation: Modulation
    fading: Fading

    def snr(self, distance_m: Any, rock_db: Any) -> Any:
        """Return the signal-to-noise ratio [...] at the receiver, dB; arguments as in `success`."""
        loss = transmission_loss_db(distance_m, self.spreading, self.absorption_db_per_m)
        return self.snr_db - loss - rock_db

    def success(self, distance_m: Any, rock_db: Any) -> Any:
        """Return the probability [...] that a packet is received.

        Args:
            distance_m: [...] from sender to receiver.
            rock_db: [...] loss in rock.
        """
        ratio = 10.0 ** (0.1 * (self.snr(distance_m, rock_db) + self.bit_db))
        return packet_success(bit_error(ratio, self.modulation, self.fading), self.bits)

    def loud(self, distance_m: Any, rock_db: Any) -> Any:
        """Return whether a packet interferes with others, bool [...]: if it exceeds the noise."""
        return self.snr(distance_m, rock_db) > 0.0


type Link = RangeLink | LinkBudget


def transmission_loss_db(distance_m: Any, spreading: float, absorption_db_per_m: float) -> Any:
    """Return the transmission loss [...] from 1 m to a distance, dB: ``10 k log10(r) + a r``.

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
    """Return the probability [...] of a bit error.

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
        # 1 - sqrt(g / (1 + g)) without cancellation.
        root = of.sqrt(ratio / (1.0 + ratio))
        return 0.5 / ((1.0 + ratio) * (1.0 + root))
    if fading == "none":
        return 0.5 * of.exp(-0.5 * ratio)
    return 1.0 / (2.0 + ratio)


def packet_success(error: Any, bits: int) -> Any:
    """Return the probability [...] that all bits are right, for bit errors ``error`` [...]."""
    of = _array_module(error)
    return of.exp(bits * of.log1p(-error))


def to_decibels(ratio: float) -> float:
    """Convert a ratio of powers to dB."""
    return 10.0 * math.log10(ratio)


def _array_module(values: Any) -> Any:
    return jnp if isinstance(values, jax.Array) else np
