"""The network: a velocity of ways, given what is seen from the straight lines of a team.

Tokens stand along the line of each robot. Surroundings enter by a convolution along the line whose
kernel spans its whole cross-section; robots and obstacles by attention with the geometry of each
pair. It is a function of a set of robots: their order changes nothing, nor do rows that do not
exist.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from angler_experiments.learned_planner.scene import Scene
from angler_experiments.learned_planner.shapes import (
    ABOVE,
    ASIDE,
    BODY,
    CHANNELS,
    OTHER,
    OWN,
    SLICES,
    Width,
)

type Params = dict[str, Any]
"""Arrays by names; nested."""

_TIMES = 8
"""Waves by which the network is told how far the flow is."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Context:
    """What does not change while ways are drawn."""

    tokens: jax.Array
    """[R, slices, units]."""
    pairs: jax.Array
    """[R, R, units]."""
    exists: jax.Array
    """bool [R]."""


def init(key: jax.Array, width: Width) -> Params:
    """Numbers of an untrained network; its velocity is zero everywhere."""
    d = width.units
    keys = iter(jax.random.split(key, 16 + 8 * width.blocks))

    def dense(n_in: int, n_out: int, scale: float = 1.0) -> Params:
        w = jax.random.normal(next(keys), (n_in, n_out)) * scale / n_in**0.5
        return {"w": w, "b": jnp.zeros((n_out,))}

    def block() -> Params:
        return {
            "along_in": dense(SLICES, 2 * SLICES),
            "along_out": dense(2 * SLICES, SLICES, 0.1),
            "query": dense(d, d),
            "key": dense(d, d),
            "value": dense(2 * d, d, 0.3),
            "wide": dense(d, 2 * d),
            "back": dense(2 * d, d, 0.1),
        }

    return {
        "gap": dense(3 * ASIDE * ABOVE, d),
        "gap_on": dense(d, d),
        "own": dense(OWN, d),
        "water": dense(3, d),
        "place": 0.1 * jax.random.normal(next(keys), (SLICES, d)),
        "pair": dense(OTHER, d),
        "pair_on": dense(d, d),
        "body": dense(BODY, d),
        "body_score": dense(d, 1),
        "body_on": dense(d, d, 0.3),
        "way": dense(CHANNELS, d),
        "time": dense(2 * _TIMES, d),
        "blocks": [block() for _ in range(width.blocks)],
        "out": {"w": jnp.zeros((d, CHANNELS)), "b": jnp.zeros((CHANNELS,))},
    }


def encode(params: Params, scene: Scene) -> Context:
    """What is to be said of one world, once."""
    gap = jnp.pad(scene.gap.astype(jnp.float32), ((0, 0), (1, 1), (0, 0), (0, 0)), mode="edge")
    robots = gap.shape[0]
    gap = gap.reshape(robots, SLICES + 2, ASIDE * ABOVE)
    patch = jnp.concatenate([gap[:, :-2], gap[:, 1:-1], gap[:, 2:]], axis=-1)
    seen = _dense(params["gap_on"], jax.nn.gelu(_dense(params["gap"], patch)))
    tokens = seen + _dense(params["water"], scene.water.astype(jnp.float32)) + params["place"]
    own = _dense(params["own"], scene.own) + _of_bodies(params, scene)
    pairs = _dense(params["pair_on"], jax.nn.gelu(_dense(params["pair"], scene.others)))
    return Context(tokens=tokens + own[:, None], pairs=pairs, exists=scene.exists)


def velocity(params: Params, context: Context, way: jax.Array, time: jax.Array) -> jax.Array:
    """Velocity [R, inner, 4] of ways [R, inner, 4] at a time [] of the flow, 0 to 1."""
    turns = time * jnp.pi * 2.0 ** jnp.arange(_TIMES) / 4.0
    waves = jnp.concatenate([jnp.sin(turns), jnp.cos(turns)])
    ends = jnp.pad(way, ((0, 0), (1, 1), (0, 0)))
    h = context.tokens + _dense(params["way"], ends) + _dense(params["time"], waves)
    for block in params["blocks"]:
        along = jnp.swapaxes(_norm(h), 1, 2)
        along = _dense(block["along_out"], jax.nn.gelu(_dense(block["along_in"], along)))
        h = h + jnp.swapaxes(along, 1, 2)
        h = h + _of_team(block, context, _norm(h))[:, None]
        h = h + _dense(block["back"], jax.nn.gelu(_dense(block["wide"], _norm(h))))
    return _dense(params["out"], _norm(h)[:, 1:-1])


def _of_team(block: Params, context: Context, h: jax.Array) -> jax.Array:
    """What each robot takes from the others, [R, units]; nothing where it is alone."""
    mean = jnp.mean(h, axis=1)
    query = _dense(block["query"], mean)
    key = _dense(block["key"], mean)[None] + context.pairs
    robots, d = mean.shape
    score = jnp.einsum("id,ijd->ij", query, key) / d**0.5
    other = context.exists[None] & ~jnp.eye(robots, dtype=bool)
    share = _softmax(score, other)
    held = jnp.einsum("ij,jd->id", share, mean)
    met = jnp.einsum("ij,ijd->id", share, context.pairs)
    return _dense(block["value"], jnp.concatenate([held, met], axis=-1))


def _of_bodies(params: Params, scene: Scene) -> jax.Array:
    each = jax.nn.gelu(_dense(params["body"], scene.bodies))
    score = _dense(params["body_score"], each)[..., 0]
    share = _softmax(score, jnp.broadcast_to(scene.body_exists, score.shape))
    return _dense(params["body_on"], jnp.einsum("in,ind->id", share, each))


def _softmax(score: jax.Array, which: jax.Array) -> jax.Array:
    """Shares of those that count along the last axis; zeros where none does."""
    held = jnp.where(which, score, -jnp.inf)
    top = jax.lax.stop_gradient(jnp.max(held, axis=-1, keepdims=True, initial=-1e9))
    # Nothing that is left out may be infinite: its slope would be none.
    weight = jnp.where(which, jnp.exp(jnp.where(which, score - top, 0.0)), 0.0)
    total = jnp.sum(weight, axis=-1, keepdims=True)
    return weight / jnp.where(total > 0.0, total, 1.0)


def _dense(layer: Params, x: jax.Array) -> jax.Array:
    given: jax.Array = x @ layer["w"] + layer["b"]
    return given


def _norm(h: jax.Array) -> jax.Array:
    centred = h - jnp.mean(h, axis=-1, keepdims=True)
    return centred * jax.lax.rsqrt(jnp.mean(centred**2, axis=-1, keepdims=True) + 1e-5)
