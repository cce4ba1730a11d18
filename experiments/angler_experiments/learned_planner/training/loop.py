"""The steps of training, kept after each call, and how many of them a time allows."""

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import orbax.checkpoint as ocp

from angler_experiments.learned_planner import checkpoint, flow, network
from angler_experiments.learned_planner.checkpoint import Checkpoint
from angler_experiments.learned_planner.shapes import Width
from angler_experiments.learned_planner.training.examples import Examples, mirrored
from angler_experiments.learned_planner.training.sampled import Source
from angler_mjx.errors import ConfigError
from angler_mjx.runs.storage.atomic import whole

WEIGHTS = "weights.npz"
_STEPS, _ABOUT, _PACE = "steps", "training.json", "pace.json"
_HELD = 20
"""One in so many worlds is held back, where nobody says which."""
MOST_HELD = 512
"""On which a loss is told."""
_SHARE = 0.9
"""Of the time that may be spent on steps and what comes with them."""


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
    learned: Examples,
    out: Path,
    seconds: float,
    tell: Callable[[str], None] = print,
) -> TrainConfig:
    """With as many steps as the time takes; the same ones when it is begun again."""
    file = out / _PACE
    if not file.exists():
        steps = affordable(config, learned, seconds, tell)
        out.mkdir(parents=True, exist_ok=True)
        with whole(file) as writing:
            writing.write_text(json.dumps({"steps": steps, "seconds": seconds}))
    return replace(config, steps=json.loads(file.read_text())["steps"])


def divided(examples: Examples) -> tuple[Examples, Examples]:
    """Those learned from; and some of those held back, which is every twentieth world."""
    held = np.arange(examples.count) % _HELD == _HELD - 1
    some = np.flatnonzero(held)[:MOST_HELD]
    return rows_of(examples, np.flatnonzero(~held)), rows_of(examples, some)


def train(
    config: TrainConfig,
    examples: Examples,
    out: Path,
    tell: Callable[[str], None] = print,
    stop: int | None = None,
    size: int | None = None,
    held: Examples | None = None,
) -> State:
    """Train to the end, or on from what ``out`` holds.

    Args:
        config: how.
        examples: all that are learned from.
        out: folder of the states and, at the end, of ``weights.npz``.
        tell: progress.
        stop: end so early, as an interruption would.
        size: learn from the first so many; all if left out.
        held: those on which a loss is told; none is if left out.

    Raises:
        ConfigError: ``out`` holds a training of another kind.
    """
    count = examples.count if size is None else min(size, examples.count)
    out.mkdir(parents=True, exist_ok=True)
    _same(config, count, out / _ABOUT)
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
            state, mean = run(state, examples, count, config.steps)
            if held is not None:
                seen = (held.scenes, held.ways, held.counts)
                value = float(judge(state.mean, *seen, jax.random.key(5)))
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


def rows_of(examples: Examples, rows: np.ndarray) -> Examples:
    """Some worlds of them."""
    chosen: Examples = jax.tree.map(lambda leaf: leaf[rows], examples)
    return chosen


def _same(config: TrainConfig, count: int, file: Path) -> None:
    """A folder belongs to one training."""
    about = json.loads(json.dumps({"config": asdict(config), "worlds": count}))
    if file.exists() and json.loads(file.read_text()) != about:
        raise ConfigError(
            f"{file}: this folder holds a training with other settings or examples; "
            "give another --out, or remove it"
        )
    file.write_text(json.dumps(about, indent=1))
