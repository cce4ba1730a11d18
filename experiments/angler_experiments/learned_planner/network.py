"""Network: velocity of paths, conditioned on the surroundings of a team's straight lines.

Tokens stand along the line of each robot. Surroundings enter by a convolution along the line whose
kernel spans its whole cross-section; robots and obstacles by attention with the geometry of each
pair. It is a function of a set of robots: their order changes nothing, nor do rows that do not
exist.
"""

from dataclasses import dataclass
from typing import TypedDict

import jax
import jax.numpy as jnp

from angler_experiments.learned_planner.scene import Scene
from angler_experiments.learned_planner.shapes import (
    N_ABOVE,
    N_ASIDE,
    N_BODY_FEATURES,
    N_CHANNELS,
    N_PAIR_FEATURES,
    N_ROBOT_FEATURES,
    N_SLICES,
    NetworkSize,
)


class Dense(TypedDict):
    """Numbers of one layer."""

    w: jax.Array
    """[in, out]."""
    b: jax.Array
    """[out]."""


class Block(TypedDict):
    """Layers along a line, and of attention to the team."""

    along_in: Dense
    along_out: Dense
    query: Dense
    key: Dense
    value: Dense
    wide: Dense
    back: Dense


Params = TypedDict(  # noqa: UP013 - keys of files are no names
    "Params",
    {
        "gap": Dense,
        "gap_on": Dense,
        "own": Dense,
        "water": Dense,
        "place": jax.Array,
        "pair": Dense,
        "pair_on": Dense,
        "body": Dense,
        "body_score": Dense,
        "body_on": Dense,
        "way": Dense,
        "time": Dense,
        "blocks": list[Block],
        "out": Dense,
    },
)
"""Numbers of the network; ``place`` is [slices, units]."""


_N_TIME_FREQUENCIES = 8
"""Number of frequencies that encode the time of the flow."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class EncodedScene:
    """Encoded scene, constant while paths are sampled."""

    tokens: jax.Array
    """[R, slices, units] tokens along the lines."""
    pairs: jax.Array
    """[R, R, units] features of pairs."""
    exists: jax.Array
    """bool [R] whether the robot exists."""


def init_params(key: jax.Array, width: NetworkSize) -> Params:
    """Return the numbers of an untrained network; its velocity is zero everywhere."""
    d = width.units
    keys = iter(jax.random.split(key, 16 + 8 * width.blocks))

    def dense(n_in: int, n_out: int, scale: float = 1.0) -> Dense:
        w = jax.random.normal(next(keys), (n_in, n_out)) * scale / n_in**0.5
        return {"w": w, "b": jnp.zeros((n_out,))}

    def block() -> Block:
        return {
            "along_in": dense(N_SLICES, 2 * N_SLICES),
            "along_out": dense(2 * N_SLICES, N_SLICES, 0.1),
            "query": dense(d, d),
            "key": dense(d, d),
            "value": dense(2 * d, d, 0.3),
            "wide": dense(d, 2 * d),
            "back": dense(2 * d, d, 0.1),
        }

    return {
        "gap": dense(3 * N_ASIDE * N_ABOVE, d),
        "gap_on": dense(d, d),
        "own": dense(N_ROBOT_FEATURES, d),
        "water": dense(3, d),
        "place": 0.1 * jax.random.normal(next(keys), (N_SLICES, d)),
        "pair": dense(N_PAIR_FEATURES, d),
        "pair_on": dense(d, d),
        "body": dense(N_BODY_FEATURES, d),
        "body_score": dense(d, 1),
        "body_on": dense(d, d, 0.3),
        "way": dense(N_CHANNELS, d),
        "time": dense(2 * _N_TIME_FREQUENCIES, d),
        "blocks": [block() for _ in range(width.blocks)],
        "out": {"w": jnp.zeros((d, N_CHANNELS)), "b": jnp.zeros((N_CHANNELS,))},
    }


def encode_scene(params: Params, scene: Scene) -> EncodedScene:
    """Encode the scene of one world, once."""
    gap = jnp.pad(scene.gap.astype(jnp.float32), ((0, 0), (1, 1), (0, 0), (0, 0)), mode="edge")
    robots = gap.shape[0]
    gap = gap.reshape(robots, N_SLICES + 2, N_ASIDE * N_ABOVE)
    patch = jnp.concatenate([gap[:, :-2], gap[:, 1:-1], gap[:, 2:]], axis=-1)
    surroundings = _apply_dense(params["gap_on"], jax.nn.gelu(_apply_dense(params["gap"], patch)))
    tokens = (
        surroundings
        + _apply_dense(params["water"], scene.water.astype(jnp.float32))
        + params["place"]
    )
    robot_features = _apply_dense(params["own"], scene.own) + _attend_to_bodies(params, scene)
    pairs = _apply_dense(params["pair_on"], jax.nn.gelu(_apply_dense(params["pair"], scene.others)))
    return EncodedScene(tokens=tokens + robot_features[:, None], pairs=pairs, exists=scene.exists)


def velocity(params: Params, context: EncodedScene, path: jax.Array, time: jax.Array) -> jax.Array:
    """Return the velocity [R, inner, 4] of paths [R, inner, 4] at a time [] of the flow, 0 to 1."""
    phases = time * jnp.pi * 2.0 ** jnp.arange(_N_TIME_FREQUENCIES) / 4.0
    time_features = jnp.concatenate([jnp.sin(phases), jnp.cos(phases)])
    ends = jnp.pad(path, ((0, 0), (1, 1), (0, 0)))
    h = (
        context.tokens
        + _apply_dense(params["way"], ends)
        + _apply_dense(params["time"], time_features)
    )
    for block in params["blocks"]:
        along = jnp.swapaxes(_normalise(h), 1, 2)
        along = _apply_dense(
            block["along_out"], jax.nn.gelu(_apply_dense(block["along_in"], along))
        )
        h = h + jnp.swapaxes(along, 1, 2)
        h = h + _attend_to_team(block, context, _normalise(h))[:, None]
        h = h + _apply_dense(block["back"], jax.nn.gelu(_apply_dense(block["wide"], _normalise(h))))
    return _apply_dense(params["out"], _normalise(h)[:, 1:-1])


def _attend_to_team(block: Block, context: EncodedScene, h: jax.Array) -> jax.Array:
    """Return each robot's attention to the others, [R, units]; zeros where it is alone."""
    mean = jnp.mean(h, axis=1)
    query = _apply_dense(block["query"], mean)
    key = _apply_dense(block["key"], mean)[None] + context.pairs
    robots, d = mean.shape
    score = jnp.einsum("id,ijd->ij", query, key) / d**0.5
    other = context.exists[None] & ~jnp.eye(robots, dtype=bool)
    weights = _masked_softmax(score, other)
    attended = jnp.einsum("ij,jd->id", weights, mean)
    pair_features = jnp.einsum("ij,ijd->id", weights, context.pairs)
    return _apply_dense(block["value"], jnp.concatenate([attended, pair_features], axis=-1))


def _attend_to_bodies(params: Params, scene: Scene) -> jax.Array:
    body_features = jax.nn.gelu(_apply_dense(params["body"], scene.bodies))
    score = _apply_dense(params["body_score"], body_features)[..., 0]
    weights = _masked_softmax(score, jnp.broadcast_to(scene.body_exists, score.shape))
    return _apply_dense(params["body_on"], jnp.einsum("in,ind->id", weights, body_features))


def _masked_softmax(score: jax.Array, mask: jax.Array) -> jax.Array:
    """Return the softmax over included elements of the last axis; zeros where there are none."""
    masked = jnp.where(mask, score, -jnp.inf)
    max_score = jax.lax.stop_gradient(jnp.max(masked, axis=-1, keepdims=True, initial=-1e9))
    # Excluded elements must be finite: otherwise their derivative is NaN.
    weight = jnp.where(mask, jnp.exp(jnp.where(mask, score - max_score, 0.0)), 0.0)
    total = jnp.sum(weight, axis=-1, keepdims=True)
    return weight / jnp.where(total > 0.0, total, 1.0)


def _apply_dense(layer: Dense, x: jax.Array) -> jax.Array:
    return x @ layer["w"] + layer["b"]


def _normalise(h: jax.Array) -> jax.Array:
    centred = h - jnp.mean(h, axis=-1, keepdims=True)
    return centred * jax.lax.rsqrt(jnp.mean(centred**2, axis=-1, keepdims=True) + 1e-5)
