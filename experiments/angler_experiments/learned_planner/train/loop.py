"""Training steps with a stored state after each call; number of steps that a time allows."""

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
import orbax.checkpoint as ocp

from angler_experiments.learned_planner import checkpoint, flow, network
from angler_experiments.learned_planner.checkpoint import Checkpoint
from angler_experiments.learned_planner.network import Params
from angler_experiments.learned_planner.shapes import NetworkSize
from angler_experiments.learned_planner.train import losses
from angler_experiments.learned_planner.train.examples import Examples, mirror_examples
from angler_experiments.learned_planner.train.from_simulation import Source
from angler_mjx.errors import ConfigError
from angler_mjx.files import JsonTable
from angler_mjx.runs.storage.atomic_files import write_atomically

WEIGHTS = "weights.npz"
_STEPS, _ABOUT, _PACE = "steps", "training.json", "pace.json"
_VALIDATION_EVERY = 20
"""One of this many worlds is held back for validation by default."""
MAX_VALIDATION_WORLDS = 512
"""Maximum number of validation worlds."""
_TIME_FRACTION = 0.9
"""Fraction of the allowed time for steps and their overhead."""


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Settings of training."""

    width: NetworkSize
    sources: tuple[Source, ...]
    """Sources of worlds, without folders."""
    steps: int
    batch: int
    """Worlds of a step."""
    rate: float
    seed: int = 0
    call: int = 250
    """Steps of one program, after which progress is reported and the state is stored."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TrainingState:
    """State of training."""

    params: Params
    optimiser: optax.OptState
    mean: Params
    """Moving average of the parameters; the shipped ones."""
    step: jax.Array


def build_optimiser() -> optax.GradientTransformation:
    """Build AdamW without its rate."""
    return optax.chain(
        optax.clip_by_global_norm(1.0), optax.scale_by_adam(), optax.add_decayed_weights(1e-3)
    )


def learning_rate(config: TrainConfig, step: jax.Array, steps: jax.Array) -> jax.Array:
    """Return learning rate.

    Rising for 300 steps or a quarter, then a half cosine to a hundredth.
    """
    warmup_steps = jnp.clip(steps // 4, 1, 300)
    fraction = jnp.clip((step - warmup_steps) / jnp.maximum(steps - warmup_steps, 1), 0.0, 1.0)
    decay = 0.01 + 0.99 * 0.5 * (1.0 + jnp.cos(jnp.pi * fraction))
    return config.rate * jnp.minimum(step / warmup_steps, decay)


def initial_state(config: TrainConfig) -> TrainingState:
    """Return the state before the first step; the seed determines all of it."""
    params = network.init_params(jax.random.key(config.seed), config.width)
    return TrainingState(
        params=params,
        optimiser=build_optimiser().init(params),
        mean=params,
        step=jnp.zeros((), jnp.int32),
    )


@cache
def build_call(config: TrainConfig) -> Callable[..., tuple[TrainingState, jax.Array]]:
    """Build ``config.call`` steps as one program, which returns the new state and mean loss.

    Its arguments are the state, examples, the number of training examples, and the number of all
    steps; the config's ``steps`` are ignored.
    """
    transform = build_optimiser()

    def train_step(
        examples: Examples, count: jax.Array, steps: jax.Array, state: TrainingState
    ) -> tuple[TrainingState, jax.Array]:
        key = jax.random.fold_in(jax.random.key(config.seed + 1), state.step)
        of_rows, of_mirror, of_loss = jax.random.split(key, 3)
        rows = jax.random.randint(of_rows, (config.batch,), 0, count)
        batch = jax.tree.map(lambda leaf: leaf[rows], examples)
        batch = mirror_examples(batch, jax.random.bernoulli(of_mirror, shape=(config.batch,)))
        value, slope = jax.value_and_grad(flow.loss)(
            state.params, batch.scenes, batch.encoded_paths, batch.has_path, of_loss
        )
        update, inner = transform.update(slope, state.optimiser, state.params)
        step_size = -learning_rate(config, state.step, steps)
        params = jax.tree.map(lambda a, b: a + step_size * b, state.params, update)
        averaging = jnp.minimum(0.999, (state.step + 1.0) / (state.step + 10.0))
        mean = jax.tree.map(lambda a, b: averaging * a + (1.0 - averaging) * b, state.mean, params)
        return TrainingState(params=params, optimiser=inner, mean=mean, step=state.step + 1), value

    def run(
        state: TrainingState, examples: Examples, count: jax.Array, steps: jax.Array
    ) -> tuple[TrainingState, jax.Array]:
        bound_step = partial(train_step, examples, count, steps)
        final_state, step_losses = jax.lax.scan(
            lambda s, _: bound_step(s), state, None, length=config.call
        )
        return final_state, jnp.mean(step_losses)

    return jax.jit(run)


def _build_program(config: TrainConfig) -> Callable[..., tuple[TrainingState, jax.Array]]:
    return build_call(replace(config, steps=0, sources=()))


def affordable_steps(
    config: TrainConfig, examples: Examples, seconds: float, report: Callable[[str], None]
) -> int:
    """Return number of steps, in whole calls, that fit a time.

    Two calls are timed and discarded.
    """
    run, state, start_s = _build_program(config), initial_state(config), time.perf_counter()
    jax.block_until_ready(run(state, examples, examples.count, config.steps))
    compiled_s = time.perf_counter()
    jax.block_until_ready(run(state, examples, examples.count, config.steps))
    pace = (time.perf_counter() - compiled_s) / config.call
    remaining_s = seconds - (time.perf_counter() - start_s)
    calls = max(1, int(_TIME_FRACTION * remaining_s / pace / config.call))
    steps = min(config.steps, calls * config.call)
    report(
        f"{1e3 * pace:.2f} ms a step, {compiled_s - start_s:.0f} s to compile: {steps} steps, "
        f"about {pace * steps:.0f} s"
    )
    return steps


def limit_steps(
    config: TrainConfig,
    examples: Examples,
    out: Path,
    seconds: float,
    report: Callable[[str], None] = print,
) -> TrainConfig:
    """Return the config with the steps that the time allows; the same after a resume."""
    file = out / _PACE
    if not file.exists():
        steps = affordable_steps(config, examples, seconds, report)
        out.mkdir(parents=True, exist_ok=True)
        with write_atomically(file) as temporary:
            temporary.write_text(json.dumps({"steps": steps, "seconds": seconds}))
    return replace(config, steps=json.loads(file.read_text())["steps"])


def split_examples(examples: Examples) -> tuple[Examples, Examples]:
    """Split examples into training and validation ones, which is every twentieth world."""
    is_held = np.arange(examples.count) % _VALIDATION_EVERY == _VALIDATION_EVERY - 1
    kept = np.flatnonzero(is_held)[:MAX_VALIDATION_WORLDS]
    return select_rows(examples, np.flatnonzero(~is_held)), select_rows(examples, kept)


def train(
    config: TrainConfig,
    examples: Examples,
    out: Path,
    report: Callable[[str], None] = print,
    stop: int | None = None,
    size: int | None = None,
    validation_set: Examples | None = None,
) -> TrainingState:
    """Train to the end, resuming the state of ``out``.

    Args:
        config: settings of training.
        examples: training examples.
        out: folder of the states, of ``losses.csv`` and, at the end, of ``weights.npz``.
        report: receives progress.
        stop: step at which training ends early, as after an interruption.
        size: number of training examples, the first ones; all if left out.
        validation_set: examples of a reported loss; no loss is reported if left out.

    Raises:
        ConfigError: ``out`` holds a training of another kind.
    """
    count = examples.count if size is None else min(size, examples.count)
    out.mkdir(parents=True, exist_ok=True)
    _check_same_training(config, count, out / _ABOUT)
    compute_loss = jax.jit(flow.loss)
    run, state = _build_program(config), initial_state(config)
    options = ocp.CheckpointManagerOptions(max_to_keep=2)
    with ocp.CheckpointManager((out / _STEPS).absolute(), options=options) as manager:
        last = manager.latest_step()
        if last is not None:
            shapes = jax.tree.map(ocp.utils.to_shape_dtype_struct, state)
            state = manager.restore(last, args=ocp.args.StandardRestore(shapes))
            report(f"goes on after step {last}")
        rows = [row for row in losses.read_losses(out / losses.FILE) if row.step <= (last or 0)]
        start_s, value = time.perf_counter(), float("nan")
        while int(state.step) < min(config.steps, stop or config.steps):
            state, mean = run(state, examples, count, config.steps)
            if validation_set is not None:
                batch = (
                    validation_set.scenes,
                    validation_set.encoded_paths,
                    validation_set.has_path,
                )
                value = float(compute_loss(state.mean, *batch, jax.random.key(5)))
            report(
                f"step {int(state.step)}/{config.steps}: loss {float(mean):.4f}, on worlds that "
                f"are held back {value:.4f}, {time.perf_counter() - start_s:.0f} s"
            )
            rows.append(losses.LossRow(int(state.step), float(mean), value))
            losses.write_losses(rows, out / losses.FILE)
            manager.save(int(state.step), args=ocp.args.StandardSave(state))
        manager.wait_until_finished()
    if int(state.step) >= config.steps and not (out / WEIGHTS).exists():
        about: JsonTable = {
            "worlds": count,
            "steps": config.steps,
            "seed": config.seed,
            "loss": value,
        }
        trained = Checkpoint(params=state.mean, width=config.width, about=about)
        checkpoint.save_checkpoint(out / WEIGHTS, trained)
        report(f"{out / WEIGHTS}: {(out / WEIGHTS).stat().st_size / 1e6:.2f} MB")
    return state


def select_rows(examples: Examples, rows: np.ndarray) -> Examples:
    """Select some worlds of examples."""
    selected: Examples = jax.tree.map(lambda leaf: leaf[rows], examples)
    return selected


def _check_same_training(config: TrainConfig, count: int, file: Path) -> None:
    """Refuse a folder of another training."""
    about = json.loads(json.dumps({"config": asdict(config), "worlds": count}))
    if file.exists() and json.loads(file.read_text()) != about:
        raise ConfigError(
            f"{file}: this folder holds a training with other settings or examples; "
            "give another --out, or remove it"
        )
    file.write_text(json.dumps(about, indent=1))
