"""Windows for PyTorch, the only module that imports it.

JAX is imported in reading processes; give `DataLoader` ``multiprocessing_context="forkserver"``.
"""

from collections.abc import Iterator

import numpy as np

from angler_mjx.errors import ConfigError, UnsupportedError
from angler_mjx.learning.datasets.loaders import shuffling
from angler_mjx.learning.datasets.windows import Window, Windows

try:
    import torch
    from torch.utils.data import Dataset, IterableDataset, get_worker_info
except ImportError as error:
    raise UnsupportedError("PyTorch is not installed: pip install torch") from error


class WindowDataset(Dataset):  # type: ignore[misc]
    """Windows by their numbers, for samplers of PyTorch."""

    def __init__(self, windows: Windows) -> None:
        """Wrap the windows of a dataset."""
        self.windows = windows

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.windows)

    def __getitem__(self, number: int) -> dict[str, torch.Tensor]:
        """Return a window of tensors."""
        return to_tensors(self.windows[number])


class WindowStream(IterableDataset):  # type: ignore[misc]
    """Pass over all windows, shuffled alike for any number of workers and ranks.

    Each item is a dict of tensors with the names, shapes and units of a window of `Windows`. An
    interrupted pass resumes: `seen` windows of the pass, of all ranks together, are left out.

    Attributes:
        epoch: number of the pass, from 0; part of the order.
        seen: number of windows of the pass that all ranks together have read.
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
        """Set the windows, their order and this process's fraction of them.

        Args:
            windows: windows of a dataset.
            seed: seed of the order.
            rank: rank of this process in a distributed training.
            world_size: number of its processes.
            group: episodes whose windows are shuffled together.

        Raises:
            ConfigError: the rank is not one of 0 to ``world_size`` - 1.
        """
        if not 0 <= rank < world_size:
            raise ConfigError(f"rank = {rank}: must be at least 0 and less than {world_size}")
        self.windows, self.seed, self.group = windows, seed, group
        self.rank, self.world_size = rank, world_size
        self.epoch = 0
        self.seen = 0

    def __len__(self) -> int:
        """Return the number of windows of this rank in a whole pass."""
        return len(range(self.rank, len(self.windows), self.world_size))

    def __iter__(self) -> Iterator[dict[str, torch.Tensor]]:
        """Yield the windows of this worker of this rank.

        Raises:
            ConfigError: seed, epoch or group are out of range, or a file is damaged.
        """
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
        """Return seed, epoch and number of seen windows, as an input of `load_state_dict`."""
        return {"seed": self.seed, "epoch": self.epoch, "seen": self.seen}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Resume from a position that `state_dict` returned."""
        self.seed, self.epoch, self.seen = state["seed"], state["epoch"], state["seen"]


def to_tensors(window: Window) -> dict[str, torch.Tensor]:
    """Return a window whose arrays are tensors, in the same memory."""
    return {name: torch.from_numpy(np.asarray(value)) for name, value in window.items()}
