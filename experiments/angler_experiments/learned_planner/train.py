"""Train the network.

    python -m angler_experiments.learned_planner.train --config small --out runs/learned

Without ``--data`` its examples are drawn and planned on the device, and stay there; with it they
are read from run folders. The same command goes on where an earlier one ended.
"""

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import optax
import orbax.checkpoint as ocp
import tyro

from angler_experiments.learned_planner import checkpoint, flow, keeping, network, sources
from angler_experiments.learned_planner.checkpoint import Checkpoint
from angler_experiments.learned_planner.examples import Examples, mirrored
from angler_experiments.learned_planner.shapes import Width
from angler_experiments.learned_planner.sources import Source
from angler_experiments.learned_planner.telling import Clock
from angler_mjx.errors import ConfigError
from angler_mjx.storage.atomic import whole

WEIGHTS = "weights.npz"
_STEPS, _ABOUT, _PACE = "steps", "training.json", "pace.json"
_HELD = 20
"""One in so many worlds is held back."""
_SHARE, _DRAWING = 0.9, 0.4
"""Of the time that may be spent: on steps, and before them on drawing worlds."""


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
        call=500,
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


def optimiser() -> optax.GradientTransformation:
    """AdamW but for its rate."""
    return optax.chain(
        optax.clip_by_global_norm(1.0), optax.scale_by_adam(), optax.add_decayed_weights(1e-3)
    )


def rate(config: TrainConfig, step: jax.Array, steps: jax.Array) -> jax.Array:
    """Of learning: up in 300 steps or a quarter, then down in half a wave to a hundredth."""
    warm = jnp.clip(steps // 4, 1, 300)
    share = jnp.clip((step - warm) / jnp.maximum(steps - warm, 1), 0.0, 1.0)
    down = 0.01 + 0.99 * 0.5 * (1.0 + jnp.cos(jnp.pi * share))
    return config.rate * jnp.minimum(step / warm, down)


def begin(config: TrainConfig) -> State:
    """The state before the first step; the seed decides all of it."""
    params = network.init(jax.random.key(config.seed), config.width)
    return State(
        params=params,
        optimiser=optimiser().init(params),
        mean=params,
        step=jnp.zeros((), jnp.int32),
    )


@cache
def call(config: TrainConfig) -> Callable[..., tuple[State, jax.Array]]:
    """``config.call`` steps as one program; it gives the state after them and their mean loss.

    It takes the state, examples, how many of them are learned from, and how many steps there will
    be in all; the config's ``steps`` are not read.
    """
    rule = optimiser()

    def one(
        examples: Examples, count: jax.Array, steps: jax.Array, state: State
    ) -> tuple[State, jax.Array]:
        key = jax.random.fold_in(jax.random.key(config.seed + 1), state.step)
        of_rows, of_mirror, of_loss = jax.random.split(key, 3)
        rows = jax.random.randint(of_rows, (config.batch,), 0, count)
        batch = jax.tree.map(lambda leaf: leaf[rows], examples)
        batch = mirrored(batch, jax.random.bernoulli(of_mirror, shape=(config.batch,)))
        value, slope = jax.value_and_grad(flow.loss)(
            state.params, batch.scenes, batch.ways, batch.counts, of_loss
        )
        update, inner = rule.update(slope, state.optimiser, state.params)
        faster = -rate(config, state.step, steps)
        params = jax.tree.map(lambda a, b: a + faster * b, state.params, update)
        share = jnp.minimum(0.999, (state.step + 1.0) / (state.step + 10.0))
        mean = jax.tree.map(lambda a, b: share * a + (1.0 - share) * b, state.mean, params)
        return State(params=params, optimiser=inner, mean=mean, step=state.step + 1), value

    def run(
        state: State, examples: Examples, count: jax.Array, steps: jax.Array
    ) -> tuple[State, jax.Array]:
        forward = partial(one, examples, count, steps)
        after, losses = jax.lax.scan(lambda s, _: forward(s), state, None, length=config.call)
        return after, jnp.mean(losses)

    return jax.jit(run)


def _program(config: TrainConfig) -> Callable[..., tuple[State, jax.Array]]:
    return call(replace(config, steps=0, sources=()))


def affordable(
    config: TrainConfig, learned: Examples, seconds: float, tell: Callable[[str], None]
) -> int:
    """Steps, in whole calls, that so many seconds take: two calls are timed and thrown away."""
    run, state, begun = _program(config), begin(config), time.perf_counter()
    jax.block_until_ready(run(state, learned, learned.count, config.steps))
    compiled = time.perf_counter()
    jax.block_until_ready(run(state, learned, learned.count, config.steps))
    pace = (time.perf_counter() - compiled) / config.call
    left = seconds - (time.perf_counter() - begun)
    calls = max(1, int(_SHARE * left / pace / config.call))
    steps = min(config.steps, calls * config.call)
    tell(
        f"{1e3 * pace:.2f} ms a step, {compiled - begun:.0f} s to compile: {steps} steps, "
        f"about {pace * steps:.0f} s"
    )
    return steps


def paced(
    config: TrainConfig,
    examples: Examples,
    out: Path,
    seconds: float,
    tell: Callable[[str], None] = print,
) -> TrainConfig:
    """With as many steps as the time takes; the same ones when it is begun again."""
    file = out / _PACE
    if not file.exists():
        steps = affordable(config, divided(examples)[0], seconds, tell)
        out.mkdir(parents=True, exist_ok=True)
        with whole(file) as writing:
            writing.write_text(json.dumps({"steps": steps, "seconds": seconds}))
    return replace(config, steps=json.loads(file.read_text())["steps"])


def divided(examples: Examples) -> tuple[Examples, Examples]:
    """Those learned from; and some of those held back, which is every twentieth world."""
    held = np.arange(examples.count) % _HELD == _HELD - 1
    return _rows(examples, np.flatnonzero(~held)), _rows(examples, np.flatnonzero(held)[:512])


def train(
    config: TrainConfig,
    examples: Examples,
    out: Path,
    tell: Callable[[str], None] = print,
    stop: int | None = None,
    size: int | None = None,
) -> State:
    """Train to the end, or on from what ``out`` holds.

    Args:
        config: how.
        examples: all of them; every twentieth world is only looked at.
        out: folder of the states and, at the end, of ``weights.npz``.
        tell: progress.
        stop: end so early, as an interruption would.
        size: learn from the first so many; all if left out.

    Raises:
        ConfigError: ``out`` holds a training of another kind.
    """
    size = examples.count if size is None else min(size, examples.count)
    count = size - size // _HELD
    out.mkdir(parents=True, exist_ok=True)
    _same(config, size, out / _ABOUT)
    learned, some = divided(examples)
    judge = jax.jit(flow.loss)
    run, state = _program(config), begin(config)
    options = ocp.CheckpointManagerOptions(max_to_keep=2)
    with ocp.CheckpointManager((out / _STEPS).absolute(), options=options) as manager:
        last = manager.latest_step()
        if last is not None:
            shapes = jax.tree.map(ocp.utils.to_shape_dtype_struct, state)
            state = manager.restore(last, args=ocp.args.StandardRestore(shapes))
            tell(f"goes on after step {last}")
        begun, value = time.perf_counter(), float("nan")
        while int(state.step) < min(config.steps, stop or config.steps):
            state, mean = run(state, learned, count, config.steps)
            value = float(judge(state.mean, some.scenes, some.ways, some.counts, jax.random.key(5)))
            tell(
                f"step {int(state.step)}/{config.steps}: loss {float(mean):.4f}, on worlds that "
                f"are held back {value:.4f}, {time.perf_counter() - begun:.0f} s"
            )
            manager.save(int(state.step), args=ocp.args.StandardSave(state))
        manager.wait_until_finished()
    if int(state.step) >= config.steps and not (out / WEIGHTS).exists():
        about = {"worlds": count, "steps": config.steps, "seed": config.seed, "loss": value}
        made = Checkpoint(params=state.mean, width=config.width, about=about)
        checkpoint.save(out / WEIGHTS, made)
        tell(f"{out / WEIGHTS}: {(out / WEIGHTS).stat().st_size / 1e6:.2f} MB")
    return state


def _rows(examples: Examples, rows: np.ndarray) -> Examples:
    chosen: Examples = jax.tree.map(lambda leaf: leaf[rows], examples)
    return chosen


def _same(config: TrainConfig, size: int, file: Path) -> None:
    """A folder belongs to one training."""
    about = json.loads(json.dumps({"config": asdict(config), "worlds": size}))
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
    minutes: float | None = None,
    examples: Path | None = None,
    seed: int = 0,
) -> None:
    """Train, and write ``weights.npz``.

    Args:
        out: Folder of it, and of the states to go on from.
        config: Of network, examples and steps.
        data: Run folders to learn from, instead of drawing worlds.
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
    if data:
        made = sources.gathered(sources.of_folders(data), worlds, tell, drawing)
    else:
        made = keeping.examples(chosen.sources, worlds, examples, tell, drawing)
    tell(f"{made.count} worlds")
    if seconds is not None:
        chosen = paced(chosen, made, out, seconds - tell.seconds, tell)
    train(chosen, made, out, tell)


if __name__ == "__main__":
    tyro.cli(main)
