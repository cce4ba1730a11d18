"""Order of windows: the same for the same seed, with any number of readers."""

from collections.abc import Iterator

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets.windows import Windows

GROUP_SIZE = 64
"""Episodes whose windows are shuffled together: their arrays are decoded about once."""


def shuffle_windows(windows: Windows, seed: int, epoch: int, group: int = GROUP_SIZE) -> np.ndarray:
    """Return the shuffled numbers of all windows: episodes first, then windows within groups.

    Philox of NumPy, keyed by seed and epoch; it depends neither on the readers nor on the machine.

    Args:
        windows: windows to shuffle.
        seed: seed of the whole training.
        epoch: number of this pass.
        group: episodes of a group; with the number of all episodes, all windows are shuffled at
            once.

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
    """Yield the windows of one of several readers, after ``start`` windows that all have read.

    Args:
        numbers: window numbers of a whole pass.
        start: windows read before, by all readers together.
        index: index of this reader.
        of: number of readers.
    """
    return (int(number) for number in numbers[start + index :: of])
