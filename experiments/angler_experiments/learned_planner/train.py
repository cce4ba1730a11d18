"""Train the network.

    python -m angler_experiments.learned_planner.train --config small --out runs/learned

Without ``--data`` its examples are drawn and planned on the device, and stay there; with it they
are read from run folders. The same command goes on where an earlier one ended.
"""

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import optax
import orbax.checkpoint as ocp
import tyro

from angler_experiments.learned_planner import checkpoint, flow, network, sources
from angler_experiments.learned_planner.checkpoint import Checkpoint
from angler_experiments.learned_planner.examples import Examples, mirrored
from angler_experiments.learned_planner.shapes import Width
from angler_experiments.learned_planner.sources import Source
from angler_mjx.errors import ConfigError

WEIGHTS = "weights.npz"
_STEPS, _ABOUT = "steps", "training.json"


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """How long on what."""

    width: Width
    sources: tuple[Source, ...]
    """Of worlds, where no folders are given."""
    steps: int
    batch: int
    """Worlds of a step."""
    rate: float
    seed: int = 0
    call: int = 250
    """Steps of one program, after which progress is told and the state is kept."""


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
            Source(worlds=16384, tile=4096, robots=4, still=False),
            Source(worlds=16384, tile=4096, preset="dense"),
        ),
        steps=40000,
        batch=256,
        rate=1e-3,
        call=1000,
    ),
}


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class State:
    """Where training stands."""

    params: Any
    optimiser: Any
    mean: Any
    """Of the parameters of late; what is shipped."""
    step: jax.Array


def schedule(config: TrainConfig) -> optax.GradientTransformation:
    """The optimiser."""
    rate = optax.warmup_cosine_decay_schedule(
        0.0, config.rate, min(300, config.steps // 4), config.steps, config.rate * 1e-2
    )
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(rate, weight_decay=1e-3))


def begin(config: TrainConfig) -> State:
    """The state before the first step; the seed decides all of it."""
    params = network.init(jax.random.key(config.seed), config.width)
    return State(
        params=params,
        optimiser=schedule(config).init(params),
        mean=params,
        step=jnp.zeros((), jnp.int32),
    )


@cache
def call(config: TrainConfig) -> Callable[[State, Examples], tuple[State, jax.Array]]:
    """``config.call`` steps as one program; it gives the state after them and their mean loss."""
    optimiser = schedule(config)

    def one(examples: Examples, state: State) -> tuple[State, jax.Array]:
        key = jax.random.fold_in(jax.random.key(config.seed + 1), state.step)
        of_rows, of_mirror, of_loss = jax.random.split(key, 3)
        rows = jax.random.randint(of_rows, (config.batch,), 0, examples.count)
        batch = jax.tree.map(lambda leaf: leaf[rows], examples)
        batch = mirrored(batch, jax.random.bernoulli(of_mirror, shape=(config.batch,)))
        value, slope = jax.value_and_grad(flow.loss)(
            state.params, batch.scenes, batch.ways, batch.counts, of_loss
        )
        update, inner = optimiser.update(slope, state.optimiser, state.params)
        params = optax.apply_updates(state.params, update)
        share = jnp.minimum(0.999, (state.step + 1.0) / (state.step + 10.0))
        mean = jax.tree.map(lambda a, b: share * a + (1.0 - share) * b, state.mean, params)
        return State(params=params, optimiser=inner, mean=mean, step=state.step + 1), value

    def run(state: State, examples: Examples) -> tuple[State, jax.Array]:
        after, losses = jax.lax.scan(lambda s, _: one(examples, s), state, None, length=config.call)
        return after, jnp.mean(losses)

    return jax.jit(run)


def train(
    config: TrainConfig,
    examples: Examples,
    out: Path,
    tell: Callable[[str], None] = print,
    stop: int | None = None,
) -> State:
    """Train to the end, or on from what ``out`` holds.

    Args:
        config: how.
        examples: all of them; every twentieth world is only looked at.
        out: folder of the states and, at the end, of ``weights.npz``.
        tell: progress.
        stop: end so early, as an interruption would.

    Raises:
        ConfigError: ``out`` holds a training of another kind.
    """
    out.mkdir(parents=True, exist_ok=True)
    _same(config, examples, out / _ABOUT)
    held = np.arange(examples.count) % 20 == 19
    learned, some = (
        _rows(examples, np.flatnonzero(~held)),
        _rows(examples, np.flatnonzero(held)[:512]),
    )
    judge = jax.jit(flow.loss)
    run, state = call(config), begin(config)
    options = ocp.CheckpointManagerOptions(max_to_keep=2)
    with ocp.CheckpointManager((out / _STEPS).absolute(), options=options) as manager:
        last = manager.latest_step()
        if last is not None:
            shapes = jax.tree.map(ocp.utils.to_shape_dtype_struct, state)
            state = manager.restore(last, args=ocp.args.StandardRestore(shapes))
            tell(f"goes on after step {last}")
        begun, value = time.perf_counter(), float("nan")
        while int(state.step) < min(config.steps, stop or config.steps):
            state, mean = run(state, learned)
            value = float(judge(state.mean, some.scenes, some.ways, some.counts, jax.random.key(5)))
            tell(
                f"step {int(state.step)}/{config.steps}: loss {float(mean):.4f}, on worlds that "
                f"are held back {value:.4f}, {time.perf_counter() - begun:.0f} s"
            )
            manager.save(int(state.step), args=ocp.args.StandardSave(state))
        manager.wait_until_finished()
    if int(state.step) >= config.steps:
        about = {"worlds": learned.count, "steps": config.steps, "seed": config.seed, "loss": value}
        made = Checkpoint(params=state.mean, width=config.width, about=about)
        checkpoint.save(out / WEIGHTS, made)
        tell(f"{out / WEIGHTS}: {(out / WEIGHTS).stat().st_size / 1e6:.2f} MB")
    return state


def _rows(examples: Examples, rows: np.ndarray) -> Examples:
    chosen: Examples = jax.tree.map(lambda leaf: leaf[rows], examples)
    return chosen


def _same(config: TrainConfig, examples: Examples, file: Path) -> None:
    """A folder belongs to one training."""
    about = json.loads(json.dumps({"config": asdict(config), "worlds": examples.count}))
    if file.exists() and json.loads(file.read_text()) != about:
        raise ConfigError(
            f"{file}: this folder holds a training with other settings or examples; "
            "give another --out, or remove it"
        )
    file.write_text(json.dumps(about, indent=1))


def main(
    out: Path,
    config: Literal["tiny", "small", "full"] = "small",
    data: tuple[Path, ...] = (),
    worlds: int | None = None,
    steps: int | None = None,
    seed: int = 0,
) -> None:
    """Train, and write ``weights.npz``.

    Args:
        out: folder of it, and of the states to go on from.
        config: of network, examples and steps.
        data: run folders to learn from, instead of drawing worlds.
        worlds: of the examples, in the shares of the config or the first of the folders.
        steps: instead of the config's.
        seed: of the first numbers, the batches and the noise.
    """
    chosen = CONFIGS[config]
    chosen = TrainConfig(**{**vars(chosen), "seed": seed, "steps": steps or chosen.steps})
    begun = time.perf_counter()
    tell = partial(print, flush=True)
    parts: Iterator[Examples] = (
        sources.of_folders(data) if data else sources.of_sources(chosen.sources, worlds)
    )
    examples = sources.gathered(parts, worlds, tell)
    tell(f"{examples.count} worlds in {time.perf_counter() - begun:.0f} s")
    train(chosen, examples, out, tell)


if __name__ == "__main__":
    tyro.cli(main)
