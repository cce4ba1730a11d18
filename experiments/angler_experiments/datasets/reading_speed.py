"""Reading speed of a dataset: random windows, windows in order, whole episodes; PyTorch, Grain.

    python -m angler_experiments.datasets.reading_speed datasets/reef

Files that were read before lie in memory: the measurement is of the reader, not of the disk.
"""

import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from numpy.typing import ArrayLike

from angler_mjx.learning import datasets
from angler_mjx.learning.datasets.windows import Windows

BATCH = 64
"""Number of windows that PyTorch's workers pass at once."""


def measure_rate(items: Iterable[Mapping[str, ArrayLike]], seconds: float) -> tuple[float, float]:
    """Return items and bytes per second of some seconds of iteration, without the first items."""
    iterator = iter(items)
    for _ in range(20):
        next(iterator)
    start_s, count, n_byte = time.perf_counter(), 0, 0
    for item in iterator:
        count += 1
        n_byte += sum(np.asarray(value).nbytes for value in item.values())
        if time.perf_counter() - start_s > seconds:
            break
    elapsed_s = time.perf_counter() - start_s
    return count / elapsed_s, n_byte / elapsed_s


def print_rate(
    label: str,
    make_items: Callable[[], Iterable[Mapping[str, ArrayLike]]],
    seconds: float,
    items_per_read: int = 1,
) -> None:
    """Print a row: the best of three, for items of several reads each."""
    best = max(measure_rate(make_items(), seconds) for _ in range(3))
    print(f"| {label} | {items_per_read * best[0]:,.0f} | {best[1] / 1e9:.2f} |", flush=True)


def build_torch_loader(windows: Windows, workers: int) -> Iterable[Mapping[str, ArrayLike]]:
    """Build a pass by PyTorch's workers, in batches: each costs as much to pass as one window."""
    from torch.utils.data import DataLoader

    from angler_mjx.learning.datasets.loaders.torch import WindowStream

    context = "forkserver" if workers else None
    loader: Iterable[Mapping[str, ArrayLike]] = DataLoader(
        WindowStream(windows),
        batch_size=BATCH,
        num_workers=workers,
        multiprocessing_context=context,
    )
    return loader


def main(
    dataset: Annotated[Path, tyro.conf.Positional],
    length: int = 64,
    seconds: float = 5.0,
    torch: bool = False,
    grain: bool = False,
) -> None:
    """Print a table of rates.

    Args:
        dataset: Its folder, or a run folder.
        length: Samples in a window.
        seconds: Of each measurement.
        torch: Measure PyTorch's loaders too.
        grain: Measure Grain's too.
    """
    data = datasets.open(dataset)
    team, robot_windows = data.windows(length), data.windows(length, of="robot")
    rng = np.random.default_rng(0)
    print(f"{len(data)} episodes, windows of {length} samples\n")
    print("| what | items/s | GB/s |\n|---|---|---|")
    for name, windows in (("team", team), ("robot", robot_windows)):
        numbers = rng.integers(0, len(windows), 200_000)
        print_rate(
            f"random windows of a {name}",
            lambda w=windows, n=numbers: (w[int(i)] for i in n),  # type: ignore[misc]
            seconds,
        )
    strides = data.windows(length, stride=length)
    print_rate("windows in order", lambda: iter(strides), seconds)
    fields = data.fields
    print_rate(
        "whole episodes",
        lambda: ({name: data.values(i, name) for name in fields} for i in range(len(data))),
        seconds,
    )
    if torch:
        for workers in (0, 2):
            print_rate(
                f"PyTorch, {workers} workers",
                lambda k=workers: build_torch_loader(team, k),  # type: ignore[misc]
                seconds,
                BATCH,
            )
    if grain:
        from angler_mjx.learning.datasets.loaders.grain import build_source

        print_rate(
            "Grain, shuffled", lambda: build_source(team).shuffle(seed=0).to_iter_dataset(), seconds
        )


if __name__ == "__main__":
    tyro.cli(main)
