"""Examples in one file, to avoid sampling and planning worlds again: ``.npz``, no pickle."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from angler_experiments.learned_planner.scene import Scene
from angler_experiments.learned_planner.shapes import SCHEMA
from angler_experiments.learned_planner.train import collect, from_simulation
from angler_experiments.learned_planner.train.examples import Examples
from angler_experiments.learned_planner.train.from_simulation import Source
from angler_mjx.errors import ConfigError
from angler_mjx.runs.storage.atomic_files import write_atomically

_ABOUT = "about"
_SCENE_ARRAYS = ("gap", "own", "others", "bodies", "water", "exists", "body_exists")


def load_or_sample(
    sources: Sequence[Source],
    worlds: int | None,
    file: Path | None,
    report: Callable[[str], None],
    seconds: float | None = None,
) -> Examples:
    """Return examples of sources: those of a file, or sampled and written to it.

    Args:
        sources: sources.
        worlds: number of all worlds; theirs if left out.
        file: file of the examples.
        report: receives progress.
        seconds: time after which no more worlds are begun.

    Raises:
        ConfigError: the file holds other examples.
    """
    if file is not None and file.exists():
        stored = read_examples(file, sources)
        report(f"{stored.count} worlds of {file}")
        count = stored.count if worlds is None else min(worlds, stored.count)
        return jax.tree.map(lambda leaf: leaf[:count], stored) if count < stored.count else stored
    sampled_examples = collect.collect_examples(
        from_simulation.sample_sources(sources, worlds), worlds, report, seconds
    )
    report(f"{sampled_examples.count} worlds drawn and planned")
    if file is not None:
        write_examples(file, sampled_examples, sources)
        report(f"{file}: {file.stat().st_size / 1e9:.2f} GB")
    return sampled_examples


def write_examples(file: Path, examples: Examples, sources: Sequence[Source]) -> None:
    """Write examples of sources."""
    arrays = {name: getattr(examples.scenes, name) for name in _SCENE_ARRAYS}
    arrays |= {"ways": examples.encoded_paths, "counts": examples.has_path}
    text = np.frombuffer(json.dumps(_describe_sources(sources)).encode(), np.uint8)
    file.parent.mkdir(parents=True, exist_ok=True)
    with write_atomically(file, durable=False) as temporary, temporary.open("wb") as stream:
        host = {name: np.asarray(leaf) for name, leaf in arrays.items()}
        np.savez(stream, allow_pickle=False, **{_ABOUT: text}, **host)


def read_examples(file: Path, sources: Sequence[Source]) -> Examples:
    """Read stored examples.

    Raises:
        ConfigError: the file holds no examples, or those of other sources.
    """
    try:
        with np.load(file, allow_pickle=False) as arrays:
            about = json.loads(arrays[_ABOUT].tobytes())
            if about == _describe_sources(sources):
                scenes = Scene(**{name: jnp.asarray(arrays[name]) for name in _SCENE_ARRAYS})
                return Examples(
                    scenes=scenes,
                    encoded_paths=jnp.asarray(arrays["ways"]),
                    has_path=jnp.asarray(arrays["counts"]),
                )
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise ConfigError(
            f"{file}: no examples can be read from it ({error}); remove it, or name another file"
        ) from error
    raise ConfigError(
        f"{file}: holds examples of other sources or of another schema; name another file"
    )


def _describe_sources(sources: Sequence[Source]) -> dict[str, object]:
    about: dict[str, object] = json.loads(
        json.dumps({"schema": SCHEMA, "sources": [asdict(source) for source in sources]})
    )
    return about
