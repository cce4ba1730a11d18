"""Arrays of floats that are stored in whole steps: a millimetre, a thousandth of a m/s.

On disk they are integers, time running along a robot's row, where neighbours differ little; codecs
of Zarr's own extensions say so (``transpose``, ``scale_offset``, ``cast_value``), so whoever opens
the array with Zarr reads float32. Episodes of ``reef_fleet`` at 10 Hz, bytes a world before and
after with steps of 1 mm, 1 mm/s, 2 mrad and 1 us: 502 kB (floats, LZ4), 182 (integers, LZ4),
132 (Zstandard), 99 (time last), 86 (and shuffled by bits). Differences from sample to sample would
take 37, by a codec that only zarr-python knows.
"""

from dataclasses import dataclass

import numpy as np
from numcodecs.blosc import BITSHUFFLE, Blosc
from zarr.codecs import BloscCodec, CastValue, ScaleOffset, TransposeCodec

_ENCODER = Blosc(cname="zstd", shuffle=BITSHUFFLE, clevel=1)
"""As the arrays' metadata say."""

_MAX_VALUES = {"m/s": 30.0, "m/s, rad/s": 30.0, "rad": 7.0, "us": 4000.0, "1": 1.1}
"""What an array of a unit holds at most, where 16 bits are to do."""


@dataclass(frozen=True, kw_only=True)
class Quantization:
    """How an array [world, time, ...] is stored in steps."""

    per_unit: float
    """Steps in one unit of the array, a number of float32."""
    is_short: bool
    """Whether 16 bits hold what may come; 32 otherwise."""

    @property
    def dtype(self) -> np.dtype:
        """Type on disk."""
        return np.dtype(np.int16 if self.is_short else np.int32)

    @property
    def missing(self) -> int:
        """Stands for NaN: the least number there is."""
        return int(np.iinfo(self.dtype).min)

    @property
    def endless(self) -> int | None:
        """Stands for inf where there are 32 bits: the greatest number; 16 bits are clamped."""
        return None if self.is_short else int(np.iinfo(self.dtype).max)

    def filters(self, ndim: int) -> list[TransposeCodec | ScaleOffset | CastValue]:
        """Return the codecs between the array and its bytes."""
        pairs: list[tuple[str, int]] = [("NaN", self.missing)]
        if self.endless is not None:
            pairs.append(("Infinity", self.endless))
        return [
            TransposeCodec(order=(0, *range(2, ndim), 1)),
            ScaleOffset(scale=self.per_unit),
            CastValue(
                data_type=str(self.dtype),
                out_of_range="clamp",
                scalar_map={
                    "encode": [(value, steps) for value, steps in pairs],
                    "decode": [(steps, value) for value, steps in pairs],
                },
            ),
        ]

    @staticmethod
    def compressor() -> BloscCodec:
        """Return the compressor of the filtered bytes."""
        return BloscCodec(cname="zstd", shuffle="bitshuffle", clevel=1)

    def round_values(self, values: np.ndarray) -> np.ndarray:
        """Return values as they are read back."""
        steps = self._quantize(values)
        values_read: np.ndarray = steps.astype(np.float32) / np.float32(self.per_unit)
        values_read[steps == self.missing] = np.nan
        if self.endless is not None:
            values_read[steps == self.endless] = np.inf
        return values_read

    def encode_worlds(self, values: np.ndarray) -> list[bytes]:
        """Encode worlds [n, time, ...], a chunk each; values out of range are clamped."""
        # A world's chunk: its own axes first, time last.
        return [_ENCODER.encode(world) for world in self._quantize(np.moveaxis(values, 1, -1))]

    def _quantize(self, values: np.ndarray) -> np.ndarray:
        """Return numbers of steps, in rows one after another whatever the order of the values."""
        steps = np.empty(values.shape, np.float32)
        np.multiply(values, np.float32(self.per_unit), out=steps)
        np.rint(steps, out=steps)
        is_infinite = None if self.endless is None else steps == np.inf
        max_step = np.nextafter(np.float32(np.iinfo(self.dtype).max), np.float32(0.0))
        np.clip(steps, -max_step, max_step, out=steps)
        # What is no number yet takes the least one.
        np.fmax(steps, np.float32(self.missing), out=steps)
        quantized = steps.astype(self.dtype)
        if is_infinite is not None and is_infinite.any():
            quantized[is_infinite] = self.endless
        return quantized


def build_quantization(step: float | None, unit: str) -> Quantization | None:
    """Return the quantization of an array to a step; None without a step, stored exactly.

    Args:
        step: in the array's unit.
        unit: of the array.
    """
    if step is None:
        return None
    max_steps = _MAX_VALUES.get(unit, np.inf) / step
    return Quantization(
        per_unit=float(np.float32(1.0 / step)), is_short=max_steps < np.iinfo(np.int16).max
    )
