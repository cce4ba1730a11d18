"""What changes while robots fly, in all engines: who has finished, breaks down, carries a load."""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.vehicles.load import Load
from angler_mjx.sim import fleet, world_phases
from angler_mjx.sim.engines.base import by_name
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.engines.lanes.engine import FusedEngine
from angler_mjx.sim.record import ProgressRecord
from angler_mjx.sim.state import Outcome
from angler_mjx.sim.world_phases import TaskOutput
from angler_mjx.world.tasks.spec import TaskSpec

from ...compiling import quickly

pytestmark = pytest.mark.usefixtures("compiled_sources")  # kernels run here, as C

STEPS = 6
"""Control steps of 0.05 s of a segment, all with a sample; two segments are flown."""
PERIOD = 4
"""Control steps from one look at the task to the next; the second segment begins between two."""
FINISHED_FROM = np.array([1000, 4, 1000, 4])
"""Number of the control step from which on each robot's part is done."""
FAILS_AT_S = np.array([[np.inf, np.inf, 0.12, 0.12], [0.2, 0.11, 0.0, np.inf]])
"""When each robot of the two worlds breaks down."""
LOADED = np.array([(4, 8), (8, 1000), (0, 4), (9, 9)])
"""Control steps from and to which each robot carries a load."""
TASK = TaskSpec(kind="tour", jobs=1, robots=4, tolerance_m=0.5, period=PERIOD)
LOAD = Load(
    mass_kg=4.0,
    volume_m3=0.001,
    drag_area_m2=(0.1, 0.2, 0.3),
    added_mass_kg=(1.0, 2.0, 3.0),
    density_kgpm3=1000.0,
)
ENGINES = {
    "mjx": by_name("mjx", "xla"),
    "lanes": by_name("fused", "xla"),
    "kernels": CudaEngine(block=2),
}
BY = "lanes, and a control step of the kernels in test_kernels_do_the_same_in_one_step"
SLOW = [pytest.param(name, marks=pytest.mark.nightly(by=BY)) for name in ("mjx", "kernels")]


def work(context, state, modem, estimate):
    """A task that is done at a given time, and records when it was looked at."""
    number = context.number // PERIOD * PERIOD
    none = jnp.zeros(len(LOADED), jnp.int32)
    progress = ProgressRecord(fraction=number * 1.0, target=none, carrying=none, done=none + number)
    return TaskOutput(
        finished=number >= FINISHED_FROM,
        loaded=(number >= LOADED[:, 0]) & (number < LOADED[:, 1]),
        record=progress,
    )


@pytest.fixture(scope="module")
def scene(scenes):
    """Two worlds of four robots with nothing in their way, that stand at their goals.

    Each draws its parameter set; what it carries changes whichever it has.
    """
    build, members, obstacles = scenes
    four = members("bluerov2") * len(FINISHED_FROM)
    built = build(2, members=four, config=obstacles["none"])
    kinds, environment = fleet.build_fleet(four, load=LOAD), built.worlds.environment
    worlds = replace(
        built.worlds,
        environment=replace(environment, goal_m=environment.start_m),
        fails_at_s=jnp.asarray(FAILS_AT_S, environment.start_m.dtype),
    )
    spec = replace(built.spec, task=TASK)
    return replace(built, spec=spec, fleet=kinds, worlds=worlds)


@pytest.fixture(scope="module")
def fly(scene):
    """State at the end and samples, of an engine by its name."""

    @cache
    def with_engine(name):
        state, samples = begin(scene), []
        part = partial(ENGINES[name].segment, scene.spec, n_sample=STEPS, steps_per_sample=1)
        run = quickly(part)
        for _ in range(2):
            state, seen = run(scene.fleet, scene.worlds, state)
            samples.append(seen)
        both = jax.tree.map(lambda *x: np.concatenate(x, axis=1), *samples)
        return jax.device_get(state), both

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world_phases, "advance_task", work)
        yield with_engine


def begin(scene):
    """At rest; the same program for all engines."""
    start = partial(FusedEngine().reset, replace(scene.spec, task=None))
    return quickly(start)(scene.fleet, scene.worlds)


@pytest.fixture(params=["lanes", *SLOW])
def flown(request, fly):
    """Of each engine."""
    return fly(request.param)


@pytest.mark.parametrize("name", SLOW)
def test_engines_agree(name, fly, deviation):
    """Twelve steps in float32: an ulp or two of 12 m, and as much of forces of 120 N."""
    (state, samples), (others, theirs) = fly(name), fly("lanes")
    for ours, other in ((state.vehicles, others.vehicles), (samples, theirs)):
        deviation.close(f"in_flight.{name}", ours.p, other.p, rtol=4e-6, atol=4e-6)
        deviation.close(f"in_flight.{name}", ours.nu, other.nu, rtol=4e-6, atol=4e-6)
    np.testing.assert_array_equal(state.tally.outcome, others.tally.outcome)


def test_what_a_task_records_holds_between_two_looks(flown):
    _, samples = flown
    looked = np.repeat([0, 4, 8], PERIOD)
    np.testing.assert_array_equal(samples.task.fraction, [looked, looked])
    np.testing.assert_array_equal(samples.task.done[0, :, 3], looked)


def test_robots_end_when_they_have_finished_or_break_down(flown):
    """By hand: a step ends at 0.05 s, 0.1 s ...; the first end at or after the time counts."""
    state, _ = flown
    running, reached, failed = Outcome.RUNNING, Outcome.REACHED, Outcome.FAILED
    np.testing.assert_array_equal(
        state.tally.outcome,
        [[running, reached, failed, failed], [failed, failed, failed, reached]],
    )
    np.testing.assert_allclose(
        state.tally.end_time_s, [[0.6, 0.25, 0.15, 0.15], [0.2, 0.15, 0.05, 0.25]], rtol=1e-6
    )


def test_who_broke_down_stays_where_it_was(flown):
    """World 0: robots 2 and 3 ended with the third step, so all samples after it agree."""
    state, samples = flown
    np.testing.assert_array_equal(samples.outcome[0, :, 2], 3 * [0] + 9 * [Outcome.FAILED])
    np.testing.assert_array_equal(samples.p[0, 4:, 2:], np.repeat(samples.p[0, 3:4, 2:], 8, axis=0))
    np.testing.assert_array_equal(state.vehicles.p[0, 2:], samples.p[0, 3, 2:])
    assert (state.vehicles.p[0, :2] != samples.p[0, 3, :2]).any(-1).all()
    np.testing.assert_array_equal(state.vehicles.nu[0, 2:], 0.0)


def test_kernels_do_the_same_in_one_step(scene, fly, deviation):
    """In the sixth step, from rest: robot 0 is loaded, 1 and 3 have finished, others break down."""
    fly("lanes")
    state = begin(scene)
    state = replace(state, step=jnp.full_like(state.step, 5))
    run = partial(ENGINES["lanes"].segment, scene.spec, n_sample=STEPS, steps_per_sample=1)
    _, samples = quickly(run)(scene.fleet, scene.worlds, state)
    one = quickly(partial(ENGINES["kernels"].control_step, scene.spec))
    after, sample = jax.device_get(one(scene.fleet, scene.worlds, state, None))
    running, reached, failed = Outcome.RUNNING, Outcome.REACHED, Outcome.FAILED
    np.testing.assert_array_equal(
        after.tally.outcome,
        [[running, reached, failed, failed], [failed, failed, failed, reached]],
    )
    deviation.close("in_flight.step", after.vehicles.p, samples.p[:, 1], rtol=4e-6, atol=4e-6)
    deviation.close("in_flight.step", after.vehicles.nu, samples.nu[:, 1], rtol=4e-6, atol=4e-6)
    np.testing.assert_array_equal(sample.task.fraction, [4.0, 4.0])


@pytest.mark.usefixtures("as_if_on_an_h200", "fly")
def test_kernels_lower_for_cuda(scene):
    """The segment that is told once a period, and in every step where it begins between two."""
    run = partial(CudaEngine().segment, scene.spec, n_sample=3, steps_per_sample=2)
    traced = jax.jit(run).trace(scene.fleet, scene.worlds, begin(scene))
    text = traced.lower(lowering_platforms=("cuda",)).as_text()
    # Control, motion and judgement, for all launches; there are no obstacles. Robots and padding
    # are laid out by two kernels.
    assert text.count("__gpu$xla.gpu.ptx") == 3 + 2
    # Where it is known to begin with a look, it is not in the program what is done elsewhere.
    known = jax.jit(partial(run, begins=PERIOD)).trace(scene.fleet, scene.worlds, begin(scene))
    shorter = known.lower(lowering_platforms=("cuda",)).as_text()
    assert text.count("stablehlo.case") == 1
    assert "stablehlo.case" not in shorter
