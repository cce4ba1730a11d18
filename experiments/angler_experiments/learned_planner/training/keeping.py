"""Examples in one file, so that worlds need not be drawn and planned again: ``.npz``, no pickle."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from angler_experiments.learned_planner.scene import Scene
from angler_experiments.learned_planner.shapes import SCHEMA
from angler_experiments.learned_planner.training import gathering, sampled
from angler_experiments.learned_planner.training.examples import Examples
from angler_experiments.learned_planner.training.sampled import Source
from angler_mjx.errors import ConfigError
from angler_mjx.runs.storage.atomic import whole

_ABOUT = "about"
_OF_SCENE = ("gap", "own", "others", "bodies", "water", "exists", "body_exists")


def examples(
    chosen: Sequence[Source],
    worlds: int | None,
    file: Path | None,
    tell: Callable[[str], None],
    seconds: float | None = None,
) -> Examples:
    """Examples of sources: those of a file, or drawn and put there.

    Args:
        chosen: sources.
        worlds: in all; theirs if left out.
        file: where they are kept.
        tell: progress.
        seconds: after which no more worlds are begun.

    Raises:
        ConfigError: the file holds other examples.
    """
    if file is not None and file.exists():
        held = read(file, chosen)
        tell(f"{held.count} worlds of {file}")
        count = held.count if worlds is None else min(worlds, held.count)
        return jax.tree.map(lambda leaf: leaf[:count], held) if count < held.count else held
    made = gathering.gathered(sampled.of_sources(chosen, worlds), worlds, tell, seconds)
    tell(f"{made.count} worlds drawn and planned")
    if file is not None:
        write(file, made, chosen)
        tell(f"{file}: {file.stat().st_size / 1e9:.2f} GB")
    return made


def write(file: Path, made: Examples, chosen: Sequence[Source]) -> None:
    """Keep examples of sources."""
    arrays = {name: getattr(made.scenes, name) for name in _OF_SCENE}
    arrays |= {"ways": made.ways, "counts": made.counts}
    text = np.frombuffer(json.dumps(_about(chosen)).encode(), np.uint8)
    file.parent.mkdir(parents=True, exist_ok=True)
    with whole(file, durable=False) as writing, writing.open("wb") as stream:
        host = {name: np.asarray(leaf) for name, leaf in arrays.items()}
        np.savez(stream, allow_pickle=False, **{_ABOUT: text}, **host)


def read(file: Path, chosen: Sequence[Source]) -> Examples:
    """Examples that were kept.

    Raises:
        ConfigError: they are none, or of other sources.
    """
    try:
        with np.load(file, allow_pickle=False) as held:
            about = json.loads(held[_ABOUT].tobytes())
            if about == _about(chosen):
                scenes = Scene(**{name: jnp.asarray(held[name]) for name in _OF_SCENE})
                return Examples(
                    scenes=scenes,
                    ways=jnp.asarray(held["ways"]),
                    counts=jnp.asarray(held["counts"]),
                )
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise ConfigError(
            f"{file}: no examples can be read from it ({error}); remove it, or name another file"
        ) from error
    raise ConfigError(
        f"{file}: holds examples of other sources or of another schema; name another file"
    )


def _about(chosen: Sequence[Source]) -> dict[str, object]:
    about: dict[str, object] = json.loads(
        json.dumps({"schema": SCHEMA, "sources": [asdict(one) for one in chosen]})
    )
    return about
