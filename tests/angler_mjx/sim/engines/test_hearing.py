"""Robots that talk while they fly, in all engines: the same packets, whatever moves them."""

from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import PoseTarget
from angler_mjx.sim.engines.base import by_name
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.policy import Policy
from angler_mjx.world.acoustics import access
from angler_mjx.world.acoustics.channel import Channel
from angler_mjx.world.acoustics.link import LinkBudget
from angler_mjx.world.acoustics.shadow import RockLoss

from ...compiling import quickly

pytestmark = pytest.mark.usefixtures("compiled_sources")  # kernels run here, as C

ROBOTS, STEPS, EVERY = 3, 24, 4
PACKET_S, DT_S = 0.12, 0.05
SHARED = Channel(
    access=access.build_tdma(PACKET_S, 0.02, DT_S),
    link=LinkBudget(
        snr_db=40.0,
        bit_db=0.0,
        spreading=2.0,
        absorption_db_per_m=0.1,
        bits=64,
        modulation="bpsk",
        fading="rayleigh",
    ),
    rock=RockLoss(db_per_m=3.0),
    sound_mps=1500.0,
    packet_s=PACKET_S,
    dt_s=DT_S,
)
"""Of so little signal that about every second packet is lost."""
ENGINES = {
    "mjx": by_name("mjx", "xla"),
    "lanes": by_name("fused", "xla"),
    "kernels": CudaEngine(block=2),
}


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Counting(Policy):
    """Sends each robot 0.2 m to the east of where it is, says how often it was asked, and keeps
    what it is told."""

    def reset(self, known, key):
        p = known.belief.p
        return {"asked": jnp.zeros(p.shape[0], p.dtype), "told": known.others.time_s}

    def payload(self, carry):
        return carry["asked"]

    def act(self, carry, known, key, step):
        # What was said counts the steps before the packet began, so it tells when that was.
        said = known.others.payload * DT_S
        p = known.belief.p + jnp.array([0.2, 0.0, 0.0])
        command = PoseTarget(
            position_m=p, velocity_mps=jnp.zeros_like(p), yaw_rad=jnp.zeros_like(p[:, 0])
        )
        return {"asked": carry["asked"] + 1.0, "told": said}, command


@pytest.fixture(scope="module")
def scene(scenes):
    """Two worlds of three robots; in the second one of them breaks down before its turn."""
    build, members, obstacles = scenes
    built = build(2, members=members("bluerov2")[:1] * ROBOTS, config=obstacles["none"])
    kind = built.worlds.environment.start_m.dtype
    keys = jax.random.key_data(jax.random.split(jax.random.key(1), 2))
    worlds = replace(
        built.worlds,
        acoustics_key=keys,
        policy_key=keys,
        fails_at_s=jnp.asarray(np.array([[np.inf] * 3, [np.inf, np.inf, 0.1]]), kind),
    )
    spec = replace(built.spec, acoustics=SHARED, also=("acoustics",))
    return replace(built, spec=spec, worlds=worlds)


@pytest.fixture(scope="module")
def fly(scene):
    """State at the end and samples, of an engine by its name."""

    @cache
    def with_engine(name):
        engine: Any = ENGINES[name]
        count = {"n_sample": STEPS // EVERY, "steps_per_sample": EVERY}
        run = partial(engine.segment, scene.spec, policy=Counting(), **count)
        begin = quickly(partial(engine.reset, scene.spec, policy=Counting()))
        start = begin(scene.fleet, scene.worlds)
        return jax.device_get(quickly(run)(scene.fleet, scene.worlds, start))

    return with_engine


MJX = pytest.param("mjx", marks=pytest.mark.nightly(by="the kernels, farther from the lanes"))


@pytest.mark.parametrize("name", [MJX, "kernels"])
def test_engines_agree(name, fly):
    (state, samples), (others, theirs) = fly(name), fly("lanes")
    np.testing.assert_array_equal(state.modem.in_flight.sent, others.modem.in_flight.sent)
    np.testing.assert_array_equal(state.modem.n_received, others.modem.n_received)
    np.testing.assert_array_equal(state.modem.heard.is_heard, others.modem.heard.is_heard)
    np.testing.assert_array_equal(
        state.modem.heard.payload["policy"], others.modem.heard.payload["policy"]
    )
    np.testing.assert_allclose(state.modem.heard.p_m, others.modem.heard.p_m, atol=5e-5)
    np.testing.assert_allclose(samples.talk.age_s, theirs.talk.age_s, atol=1e-5)
    np.testing.assert_allclose(samples.talk.fraction, theirs.talk.fraction, atol=1e-6)


def test_some_packets_are_heard_and_some_are_lost(fly):
    state, samples = fly("lanes")
    slot = SHARED.access.slot
    turns = -(-STEPS // slot)
    np.testing.assert_array_equal(state.modem.in_flight.sent[0].sum(), turns)
    # Robot 2 of the second world has broken down when its turn comes.
    np.testing.assert_array_equal(state.modem.in_flight.sent[1, 2], 0)
    heard = state.modem.n_received.sum()
    assert 0 < heard < (ROBOTS - 1) * state.modem.in_flight.sent.sum()
    last = samples.talk.fraction[:, -1]
    assert ((last >= 0.0) & (last <= 1.0))[:, :2].all()


def test_what_was_heard_is_of_the_time_of_sending(fly):
    """The policy says how often it was asked: as many steps as were flown when a packet began."""
    state, _ = fly("lanes")
    heard = state.modem.heard
    assert heard.is_heard.any()
    np.testing.assert_allclose(heard.payload["policy"] * DT_S, heard.time_s, atol=1e-6)
    np.testing.assert_allclose(state.policy.carry["told"], heard.time_s, atol=1e-6)
    begun = np.round(heard.time_s[heard.is_heard] / DT_S).astype(int)
    sender = np.nonzero(heard.is_heard)[2]
    np.testing.assert_array_equal(begun // SHARED.access.slot % ROBOTS, sender)


def test_worlds_that_were_drawn_without_a_channel_are_refused(scene):
    worlds = replace(scene.worlds, acoustics_key=None)
    engine = ENGINES["lanes"]
    start = jax.eval_shape(partial(engine.reset, scene.spec), scene.fleet, worlds)
    with pytest.raises(ConfigError, match="acoustics"):
        jax.eval_shape(partial(engine.control_step, scene.spec), scene.fleet, worlds, start, None)
