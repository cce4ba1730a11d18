"""Train the network.

    python -m angler_experiments.learned_planner.train --config small --out runs/learned

Without ``--data`` its examples are drawn and planned on the device, and stay there; with it they
are read from datasets and run folders. The same command goes on where an earlier one ended.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import tyro

from angler_experiments.learned_planner.progress import ProgressClock
from angler_experiments.learned_planner.shapes import NetworkSize
from angler_experiments.learned_planner.training import collect, example_files, from_runs
from angler_experiments.learned_planner.training.examples import Examples
from angler_experiments.learned_planner.training.from_simulation import Source
from angler_experiments.learned_planner.training.loop import (
    MAX_VALIDATION_WORLDS,
    TrainConfig,
    limit_steps,
    split_examples,
    train,
)

_SAMPLING_FRACTION = 0.4
"""Of the time that may be spent: on drawing worlds."""

CONFIGS = {
    "tiny": TrainConfig(
        width=NetworkSize(units=16, blocks=1),
        sources=(Source(worlds=32, robots=2, tile=32),),
        steps=8,
        batch=8,
        rate=1e-3,
        call=4,
    ),
    "small": TrainConfig(
        width=NetworkSize(),
        sources=(Source(worlds=6144), Source(worlds=2048, still=False)),
        steps=6000,
        batch=32,
        rate=2e-3,
    ),
    "full": TrainConfig(
        width=NetworkSize(units=128, blocks=4),
        sources=(
            Source(worlds=40960, tile=4096),
            Source(worlds=28672, tile=4096, still=False),
            Source(worlds=20480, tile=4096, robots=4, still=False),
            Source(worlds=16384, tile=4096, preset="dense"),
        ),
        steps=40000,
        batch=256,
        rate=1e-3,
        call=500,
    ),
}


def main(
    out: Path,
    config: Literal["tiny", "small", "full"] = "small",
    data: tuple[Path, ...] = (),
    worlds: int | None = None,
    steps: int | None = None,
    minutes: float | None = None,
    examples: Path | None = None,
    seed: int = 0,
) -> None:
    """Train, and write ``weights.npz``.

    Args:
        out: Folder of it, and of the states to go on from.
        config: Of network, examples and steps.
        data: Datasets (train to learn from, val to look at) and run folders, instead of drawing.
        worlds: Of the examples, in the shares of the config or the first of the folders.
        steps: Instead of the config's.
        minutes: Of all this, by the pace of this machine: then there may be fewer worlds and steps.
        examples: File to keep the worlds that are drawn in; read if it is there.
        seed: Of the first numbers, the batches and the noise.
    """
    report = ProgressClock()
    train_config = replace(CONFIGS[config], seed=seed, steps=steps or CONFIGS[config].steps)
    seconds = None if minutes is None else 60.0 * minutes
    sampling_s = None if seconds is None else _SAMPLING_FRACTION * seconds
    validation_set = None
    if data:
        training_set = collect.collect_examples(
            _read_folders(data, "train", report), worlds, report, sampling_s
        )
        parts = list(_read_folders(data, "val", report))
        validation_set = (
            collect.collect_examples(parts, MAX_VALIDATION_WORLDS, report) if parts else None
        )
    else:
        training_set = example_files.load_or_sample(
            train_config.sources, worlds, examples, report, sampling_s
        )
    if validation_set is None:
        training_set, validation_set = split_examples(training_set)
    report(f"{training_set.count} worlds to learn from, {validation_set.count} to look at")
    if seconds is not None:
        train_config = limit_steps(
            train_config, training_set, out, seconds - report.seconds, report
        )
    train(train_config, training_set, out, report, validation_set=validation_set)


def _read_folders(
    folders: tuple[Path, ...], split: str, report: ProgressClock
) -> Iterator[Examples]:
    for folder in folders:
        yield from from_runs.read_folder(folder, split, report)


if __name__ == "__main__":
    tyro.cli(main)
