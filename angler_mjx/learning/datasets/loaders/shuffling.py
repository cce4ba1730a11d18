"""In which order windows are seen: the same for the same seed, however many read them."""

from collections.abc import Iterator

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets.reading.windows import Windows

GROUP_SIZE = 64
"""Episodes whose windows are shuffled together: their arrays are decoded about once."""


def shuffle_windows(windows: Windows, seed: int, epoch: int, group: int = GROUP_SIZE) -> np.ndarray:
    """Numbers of all windows: episodes are shuffled, then the windows of each group of them.

    Philox of NumPy, keyed by seed and epoch; it does not depend on who reads them, nor on the
    machine.

    Args:
        windows: to be seen.
        seed: of the whole training.
        epoch: of this pass.
        group: episodes of a group; all windows of a dataset are shuffled at once by as many.

    Raises:
        ConfigError: seed, epoch or group are out of range.
    """
    for name, value, minimum in (("seed", seed, 0), ("epoch", epoch, 0), ("group", group, 1)):
        if value < minimum:
            raise ConfigError(f"{name} = {value}: must be {minimum} or more")
    rng = np.random.Generator(np.random.Philox(key=[seed, epoch]))
    ends = windows.ends
    firsts = np.concatenate([[0], ends[:-1]])
    episodes = rng.permutation(len(ends))
    parts = []
    for at in range(0, len(episodes), group):
        numbers = [np.arange(firsts[e], ends[e]) for e in episodes[at : at + group]]
        parts.append(rng.permutation(np.concatenate(numbers)))
    return np.concatenate(parts)


def shard_numbers(numbers: np.ndarray, *, start: int, index: int, of: int) -> Iterator[int]:
    """What one of several readers sees, beginning after ``start`` that all of them have seen.

    Args:
        numbers: of a whole pass.
        start: seen before, by all readers together.
        index: of this reader.
        of: readers.
    """
    return (int(number) for number in numbers[start + index :: of])
