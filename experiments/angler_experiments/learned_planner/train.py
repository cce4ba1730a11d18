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

from angler_experiments.learned_planner.progress import Clock
from angler_experiments.learned_planner.shapes import Width
from angler_experiments.learned_planner.training import gathering, keeping, stored
from angler_experiments.learned_planner.training.examples import Examples
from angler_experiments.learned_planner.training.loop import (
    MOST_HELD,
    TrainConfig,
    divided,
    paced,
    train,
)
from angler_experiments.learned_planner.training.sampled import Source

_DRAWING = 0.4
"""Of the time that may be spent: on drawing worlds."""

CONFIGS = {
    "tiny": TrainConfig(
        width=Width(units=16, blocks=1),
        sources=(Source(worlds=32, robots=2, tile=32),),
        steps=8,
        batch=8,
        rate=1e-3,
        call=4,
    ),
    "small": TrainConfig(
        width=Width(),
        sources=(Source(worlds=6144), Source(worlds=2048, still=False)),
        steps=6000,
        batch=32,
        rate=2e-3,
    ),
    "full": TrainConfig(
        width=Width(units=128, blocks=4),
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
    tell = Clock()
    chosen = replace(CONFIGS[config], seed=seed, steps=steps or CONFIGS[config].steps)
    seconds = None if minutes is None else 60.0 * minutes
    drawing = None if seconds is None else _DRAWING * seconds
    held = None
    if data:
        learned = gathering.gathered(_of(data, "train", tell), worlds, tell, drawing)
        parts = list(_of(data, "val", tell))
        held = gathering.gathered(parts, MOST_HELD, tell) if parts else None
    else:
        learned = keeping.examples(chosen.sources, worlds, examples, tell, drawing)
    if held is None:
        learned, held = divided(learned)
    tell(f"{learned.count} worlds to learn from, {held.count} to look at")
    if seconds is not None:
        chosen = paced(chosen, learned, out, seconds - tell.seconds, tell)
    train(chosen, learned, out, tell, held=held)


def _of(folders: tuple[Path, ...], split: str, tell: Clock) -> Iterator[Examples]:
    for folder in folders:
        yield from stored.of_folder(folder, split, tell)


if __name__ == "__main__":
    tyro.cli(main)
