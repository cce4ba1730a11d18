"""A task of the worlds, on lanes and in kernels: the same looks, records and ends."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.sim.engines.base import by_name
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.state import Outcome
from angler_mjx.world.tasks.spec import TaskSpec, TaskWorld

from ...compiling import quickly

pytestmark = pytest.mark.usefixtures("compiled_sources")  # kernels run here, as C

STEPS, EVERY, PERIOD = 8, 2, 3
"""Control steps, from one sample to the next, and from one look to the next."""
ENGINES = {
    "lanes": by_name("fused", "xla"),
    "kernels": CudaEngine(block=2),
}
KERNELS = pytest.param(
    "kernels",
    marks=pytest.mark.nightly(
        by="lanes, whose looks are the same code; engines/test_in_flight.py: a control step of the "
        "kernels; engines/test_hearing.py: their segment"
    ),
)


@pytest.fixture(scope="module")
def flown(scenes):
    """A function name of an engine -> state at the end and samples.

    Two worlds of two robots that hold their starts. In the first the places are the starts; in the
    second one of them is far from everybody.
    """
    build, members, obstacles = scenes
    two = members("bluerov2") * 2
    built = build(2, members=two, config=obstacles["none"])
    start = built.worlds.environment.start_m
    places = start.at[1, 1].add(4.0)
    task = TaskWorld(
        position_m=jnp.concatenate([places, start], axis=1),
        exists=jnp.ones((2, 2), bool),
        rank=jnp.tile(jnp.arange(2, dtype=jnp.int32), (2, 1)),
        part=jnp.tile(jnp.arange(2, dtype=jnp.int32), (2, 1)),
        fits=jnp.ones(2, bool),
    )
    spec = TaskSpec(kind="tour", jobs=2, robots=2, tolerance_m=0.2, period=PERIOD)
    worlds, spec = replace(built.worlds, task=task), replace(built.spec, task=spec)

    @cache
    def of(name):
        engine = ENGINES[name]
        state = quickly(lambda w: engine.reset(spec, built.fleet, w))(worlds)
        count = {"n_sample": STEPS // EVERY, "steps_per_sample": EVERY, "begins": PERIOD}
        fly = quickly(lambda w, s: engine.segment(spec, built.fleet, w, s, **count))
        return jax.tree.map(np.asarray, fly(worlds, state))

    return of


@pytest.mark.parametrize("name", ["lanes", KERNELS])
def test_a_world_that_is_done_at_the_first_look_ends_and_another_waits(flown, name):
    state, samples = flown(name)
    assert state.task.done.tolist() == [[True, True], [True, False]]
    assert state.task.complete.tolist() == [True, False]
    assert state.task.completed_s[0] == 0.0
    assert np.isnan(state.task.completed_s[1])
    assert (state.tally.outcome[0] == Outcome.REACHED).all()
    assert (state.tally.outcome[1] == Outcome.RUNNING).all()
    assert np.allclose(state.tally.end_time_s[0], 0.05)
    # The nearest robot is sent to what is left; the other stays.
    assert sorted(state.task.target[1].tolist()) == [-1, 1]
    assert samples.task.fraction.shape == (2, STEPS // EVERY)
    assert np.allclose(samples.task.fraction[:, 0], [1.0, 0.5])
    assert samples.task.done[0, -1].tolist() == [1, 1]


@pytest.mark.parametrize("name", [KERNELS])
def test_engines_agree_on_the_task(flown, name):
    ours, seen = flown("lanes")
    state, samples = flown(name)
    for field in ("done", "by", "information", "target", "finished", "did"):
        assert np.array_equal(getattr(state.task, field), getattr(ours.task, field)), field
    assert np.allclose(state.task.goal_m, ours.task.goal_m)
    for field in ("fraction", "target", "carrying", "done"):
        assert np.array_equal(getattr(samples.task, field), getattr(seen.task, field)), field
