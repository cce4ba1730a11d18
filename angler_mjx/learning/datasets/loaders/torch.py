"""Windows for PyTorch, which is imported here and nowhere else.

JAX is imported beside what reads; give `DataLoader` ``multiprocessing_context="forkserver"``.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from angler_mjx.errors import ConfigError, UnsupportedError
from angler_mjx.learning.datasets.loaders import shuffling
from angler_mjx.learning.datasets.reading.windows import Window, Windows

try:
    import torch
    from torch.utils.data import Dataset, IterableDataset, get_worker_info
except ImportError as error:
    raise UnsupportedError("PyTorch is not installed: pip install torch") from error


class WindowDataset(Dataset):  # type: ignore[misc]
    """Windows by their numbers, for samplers of PyTorch's own."""

    def __init__(self, windows: Windows) -> None:
        """Of a dataset."""
        self.windows = windows

    def __len__(self) -> int:
        """Windows."""
        return len(self.windows)

    def __getitem__(self, number: int) -> dict[str, Any]:
        """A window, of tensors."""
        return to_tensors(self.windows[number])


class WindowStream(IterableDataset):  # type: ignore[misc]
    """A pass over all windows, shuffled alike for whatever workers and ranks share it.

    Where it was broken off it goes on: `seen` windows of the pass, of all ranks together, are left
    out. ``state_dict`` and ``load_state_dict`` keep seed, epoch and what was seen.
    """

    def __init__(
        self,
        windows: Windows,
        *,
        seed: int = 0,
        rank: int = 0,
        world_size: int = 1,
        group: int = shuffling.GROUP_SIZE,
    ) -> None:
        """Of a dataset.

        Args:
            windows: of it.
            seed: of the order.
            rank: of this process of a distributed training.
            world_size: processes of it.
            group: see `shuffling.shuffle_windows`.

        Raises:
            ConfigError: the rank is none.
        """
        if not 0 <= rank < world_size:
            raise ConfigError(f"rank = {rank}: must be at least 0 and less than {world_size}")
        self.windows, self.seed, self.group = windows, seed, group
        self.rank, self.world_size = rank, world_size
        self.epoch = 0
        self.seen = 0

    def __len__(self) -> int:
        """Windows that this rank sees in a whole pass."""
        return len(range(self.rank, len(self.windows), self.world_size))

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """What this worker of this rank sees."""
        numbers = shuffling.shuffle_windows(self.windows, self.seed, self.epoch, self.group)
        info = get_worker_info()
        workers, worker = (1, 0) if info is None else (info.num_workers, info.id)
        selected = shuffling.shard_numbers(
            numbers,
            start=self.seen,
            index=self.rank + worker * self.world_size,
            of=self.world_size * workers,
        )
        return (to_tensors(self.windows[number]) for number in selected)

    def state_dict(self) -> dict[str, int]:
        """Where it is, as `load_state_dict` takes it."""
        return {"seed": self.seed, "epoch": self.epoch, "seen": self.seen}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Go on from there."""
        self.seed, self.epoch, self.seen = state["seed"], state["epoch"], state["seen"]


def to_tensors(window: Window) -> dict[str, Any]:
    """A window whose arrays are tensors, in the same memory."""
    return {name: torch.from_numpy(np.asarray(value)) for name, value in window.items()}
