"""Probability that a packet is received from another robot.

Functions of distance for NumPy and JAX arrays: files are checked without a device.
"""

import math
from dataclasses import dataclass
from types import ModuleType
from typing import Literal

import jax
import jax.numpy as jnp
import jax.scipy.special
import numpy as np
import scipy.special

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

    def success[A: (np.ndarray, jax.Array)](self, distance_m: A, rock_db: A | float) -> A:
        """Return the probability [...] that a packet is received, 0 or 1.

        Args:
            distance_m: [...] from sender to receiver.
            rock_db: [...] loss in rock; any loss blocks the packet.
        """
        return 1.0 * ((distance_m <= self.range_m) & (rock_db <= 0.0))

    def loud[A: (np.ndarray, jax.Array)](self, distance_m: A, rock_db: A | float) -> A:
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

    def snr[A: (np.ndarray, jax.Array)](self, distance_m: A, rock_db: A | float) -> A:
        """Return the signal-to-noise ratio [...] at the receiver, dB; arguments as in `success`."""
        loss = transmission_loss_db(distance_m, self.spreading, self.absorption_db_per_m)
        return self.snr_db - loss - rock_db

    def success[A: (np.ndarray, jax.Array)](self, distance_m: A, rock_db: A | float) -> A:
        """Return the probability [...] that a packet is received.

        Args:
            distance_m: [...] from sender to receiver.
            rock_db: [...] loss in rock.
        """
        ratio = 10.0 ** (0.1 * (self.snr(distance_m, rock_db) + self.bit_db))
        return packet_success(bit_error(ratio, self.modulation, self.fading), self.bits)

    def loud[A: (np.ndarray, jax.Array)](self, distance_m: A, rock_db: A | float) -> A:
        """Return whether a packet interferes with others, bool [...]: if it exceeds the noise."""
        return self.snr(distance_m, rock_db) > 0.0


type Link = RangeLink | LinkBudget


def transmission_loss_db[A: (np.ndarray, jax.Array)](
    distance_m: A, spreading: float, absorption_db_per_m: float
) -> A:
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
    loss: A = 10.0 * spreading * of.log10(far) + absorption_db_per_m * far
    return loss


def bit_error[A: (np.ndarray, jax.Array)](ratio: A, modulation: Modulation, fading: Fading) -> A:
    """Return the probability [...] of a bit error.

    Proakis, Salehi, Digital Communications, 5th ed., 2008: sections 4.3 and 4.5 in white noise,
    13.3 in Rayleigh fading, where ``ratio`` is its mean.

    Args:
        ratio: [...] energy of a bit over the density of the noise.
        modulation: of the modem.
        fading: of the channel.
    """
    of = _array_module(ratio)
    error: A
    if modulation == "bpsk" and fading == "none":
        special: ModuleType = jax.scipy.special if of is jnp else scipy.special
        error = 0.5 * special.erfc(of.sqrt(ratio))
    elif modulation == "bpsk":
        # 1 - sqrt(g / (1 + g)) without cancellation.
        root = of.sqrt(ratio / (1.0 + ratio))
        error = 0.5 / ((1.0 + ratio) * (1.0 + root))
    elif fading == "none":
        error = 0.5 * of.exp(-0.5 * ratio)
    else:
        error = 1.0 / (2.0 + ratio)
    return error


def packet_success[A: (np.ndarray, jax.Array)](error: A, bits: int) -> A:
    """Return the probability [...] that all bits are right, for bit errors ``error`` [...]."""
    of = _array_module(error)
    success: A = of.exp(bits * of.log1p(-error))
    return success


def to_decibels(ratio: float) -> float:
    """Convert a ratio of powers to dB."""
    return 10.0 * math.log10(ratio)


def _array_module(values: np.ndarray | jax.Array) -> ModuleType:
    return jnp if isinstance(values, jax.Array) else np
