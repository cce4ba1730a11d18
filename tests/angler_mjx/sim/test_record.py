"""What is recorded: the declarations, and that phases give what is declared, in every engine."""

from dataclasses import fields
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.engines.lanes.engine import FusedEngine
from angler_mjx.engines.mjx import MjxEngine
from angler_mjx.engines.triton.engine import TritonEngine
from angler_mjx.sim import record, step
from angler_mjx.sim.record import Sample


def test_every_field_of_a_sample_is_declared():
    declared = {one.path[0] for one in record.FIELDS}
    assert declared == {one.name for one in fields(Sample)}
    names = [one.about.array for one in record.FIELDS]
    assert len(set(names)) == len(names)


def test_phases_are_in_order_and_read_what_was_given_before():
    names = [phase.name for phase in step.PHASES]
    assert names == ["sense", "policy", "decide", "move", "obstacles", "judge"]
    assert {one.about.phase for one in record.FIELDS} <= set(names)
    there = {"senses", "policy", "obstacles", "known", *step.KEPT}
    for phase in step.PHASES:
        assert set(phase.reads) <= there, phase.name
        there |= set(phase.gives)


def test_fields_have_the_declared_shapes_in_every_engine(scenes):
    """By shapes alone: nothing is compiled."""
    build, members, _ = scenes
    scene = build(2, members=members("bluerov2") * 2)
    sizes = {
        "robot": 2,
        "thruster": scene.fleet.control.vehicle.B.shape[-1],
        "obstacle": scene.worlds.environment.obstacles.kind.shape[-1],
    }
    reset = partial(FusedEngine().reset, scene.spec)
    state = jax.eval_shape(reset, scene.fleet, scene.worlds)
    for engine in (MjxEngine(), FusedEngine(), TritonEngine(lanes=2, interpret=True)):
        run = partial(engine.segment, scene.spec, n_sample=3, steps_per_sample=2)
        _, sample = jax.eval_shape(run, scene.fleet, scene.worlds, state)
        assert record.sizes_of(sample, lead=2) == sizes
        for one in record.FIELDS:
            value = one.of(sample)
            assert (value is None) == one.optional
            if value is not None:
                assert value.shape == (2, 3, *one.shape(sizes)), one.path
                wanted = jnp.int32 if one.about.whole else jnp.zeros(()).dtype
                assert value.dtype == wanted, one.path


def test_what_is_kept_once_more_after_the_last_sample_is_the_state():
    names = {one.about.array for one in record.STATES}
    assert names == {"p_m", "q", "nu", "outcome", "obstacle_p_m", "obstacle_q"}


def test_a_field_is_found_along_its_path():
    belief = SimpleNamespace(p=np.ones(3))
    inner = next(one for one in record.FIELDS if one.about.array == "estimate/p_m")
    assert inner.of(SimpleNamespace(belief=belief)) is belief.p
    assert inner.of(SimpleNamespace(belief=None)) is None
