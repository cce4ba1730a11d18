"""Trained networks in one file: arrays by names in an ``.npz``, with their sizes and origin."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from angler_experiments.learned_planner import network
from angler_experiments.learned_planner.network import Params
from angler_experiments.learned_planner.shapes import SCHEMA, NetworkSize
from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import JsonTable
from angler_mjx.runs.storage.checksums import hash_file

SHIPPED_FILE = "weights.npz"
"""File of the shipped network, beside this module."""
_ABOUT, _KIND = "about", "angler_mjx learned planner"


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """Network that can plan."""

    params: Params
    width: NetworkSize
    about: JsonTable
    """Origin: examples, steps, loss, seed."""


def save_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint, numbers as float16."""
    about = {
        "kind": _KIND,
        "schema": SCHEMA,
        "width": checkpoint.width.table(),
        "made": checkpoint.about,
    }
    arrays = {
        name: np.asarray(leaf, np.float16) for name, leaf in _name_leaves(checkpoint.params).items()
    }
    text = np.frombuffer(json.dumps(about, sort_keys=True).encode(), np.uint8)
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **{_ABOUT: text}, **arrays)


def load_checkpoint(path: Path | None = None) -> Checkpoint:
    """Read a checkpoint; the shipped one if no path is given.

    Raises:
        ConfigError: the file is not a checkpoint, is damaged, or was made for another version of
            this planner.
    """
    if path is None:
        with resources.as_file(resources.files(__package__) / SHIPPED_FILE) as shipped_path:
            return _read_checkpoint(shipped_path)
    return _read_checkpoint(path)


def hash_checkpoint(path: Path | None = None) -> str:
    """Return the hash of a checkpoint; that of the shipped one without a path.

    Raises:
        ConfigError: the file does not exist.
    """
    try:
        return hash_file(path or Path(__file__).with_name(SHIPPED_FILE))[:16]
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error


def _read_checkpoint(path: Path) -> Checkpoint:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        about = json.loads(arrays.pop(_ABOUT).tobytes())
        if not isinstance(about, dict) or about.get("kind") != _KIND:
            raise KeyError(_KIND)
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise ConfigError(
            f"{path}: no checkpoint of the learned planner can be read from it ({error}); make one "
            "with python -m angler_experiments.learned_planner.train, or leave "
            "planner.learned.checkpoint out for the shipped one"
        ) from error
    if about.get("schema") != SCHEMA:
        raise ConfigError(
            f"{path}: a checkpoint of schema {format_value(about.get('schema'))}, and this planner "
            "reads "
            f"schema {SCHEMA}; train it again, or leave planner.learned.checkpoint out"
        )
    width = NetworkSize(**about["width"])
    shapes = jax.eval_shape(lambda: network.init_params(jax.random.key(0), width))
    for name, leaf in _name_leaves(shapes).items():
        shape = arrays[name].shape if name in arrays else None
        if shape != leaf.shape:
            problem = "is missing" if shape is None else f"has the shape {list(shape)}"
            raise ConfigError(
                f"{path}: {name} {problem}, not {list(leaf.shape)}: it is damaged; "
                "copy it again, or train it again"
            )
    paths, tree = jax.tree_util.tree_flatten_with_path(shapes)
    leaves = [jnp.asarray(arrays[_leaf_name(path)], jnp.float32) for path, _ in paths]
    return Checkpoint(
        params=jax.tree.unflatten(tree, leaves), width=width, about=about.get("made", {})
    )


def _name_leaves(params: Params) -> dict[str, jax.Array]:
    return {_leaf_name(path): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(params)}


def _leaf_name(path: Iterable[object]) -> str:
    return "/".join(str(getattr(step, "key", getattr(step, "idx", step))) for step in path)
