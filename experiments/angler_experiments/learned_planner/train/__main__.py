"""Train the network.

    python -m angler_experiments.learned_planner.train --config small --out runs/learned

Without ``--data`` its examples are sampled and planned on the device, and stay there; with it they
are read from datasets and run folders. The same command resumes an earlier training.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import tyro

from angler_experiments.learned_planner.progress import ProgressClock
from angler_experiments.learned_planner.train import collect, example_files, from_runs, losses
from angler_experiments.learned_planner.train.configs import CONFIGS
from angler_experiments.learned_planner.train.examples import Examples
from angler_experiments.learned_planner.train.loop import (
    MAX_VALIDATION_WORLDS,
    limit_steps,
    split_examples,
    train,
)

_SAMPLING_FRACTION = 0.4
"""Fraction of the allowed time for sampling worlds."""


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
    """Train, and write ``weights.npz``, ``losses.csv`` and ``losses.png``.

    Args:
        out: Folder of the weights, and of the states to resume from.
        config: Config of network, examples and steps.
        data: Datasets (split train for training, val for validation) and run folders, instead of
            sampling.
        worlds: Worlds of the examples, in the fractions of the config or the first of the folders.
        steps: Steps; the config's if left out.
        minutes: Minutes of the whole command, by the pace of this machine: then there may be fewer
            worlds and steps.
        examples: File of sampled worlds; read if it exists.
        seed: Seed of initial parameters, batches and noise.
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
    report(str(losses.plot_losses(losses.read_losses(out / losses.FILE), out / "losses.png")))


def _read_folders(
    folders: tuple[Path, ...], split: str, report: ProgressClock
) -> Iterator[Examples]:
    for folder in folders:
        yield from from_runs.read_folder(folder, split, report)


if __name__ == "__main__":
    tyro.cli(main)
