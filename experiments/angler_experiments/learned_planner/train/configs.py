"""Configurations of training: network, examples and steps."""

from angler_experiments.learned_planner.shapes import NetworkSize
from angler_experiments.learned_planner.train.from_simulation import Source
from angler_experiments.learned_planner.train.loop import TrainConfig

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
