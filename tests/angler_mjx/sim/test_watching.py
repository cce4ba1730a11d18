"""What a policy that asks is told of obstacles and current, judged by the flight that follows."""

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import BodyTwist
from angler_mjx.sim import information
from angler_mjx.sim import policy as policies
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.engines.lanes.engine import FusedEngine
from angler_mjx.sim.engines.mjx import MjxEngine
from angler_mjx.sim.information import Information
from angler_mjx.sim.policy import Policy
from angler_mjx.world import currents
from angler_mjx.world.obstacles import DRIFT

from ..compiling import quickly

WORLDS, STEPS, AT = 2, 28, 16
"""Looked at every sixteenth step; each 50 ms."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Watcher(Policy):
    """Lies still and keeps what it was told last, and the step in which it was."""

    information: Information | None = field(
        default=Information(obstacles="truth", current="truth"), metadata={"static": True}
    )
    period: int = field(default=AT, metadata={"static": True})
    ahead_s: float = field(default=0.5, metadata={"static": True})

    def _kept(self, known):
        probe = jax.vmap(known.current.velocity, (0, None))(known.belief.p, jnp.zeros(()))
        return known.obstacles, probe, known.grid.occupied.sum()

    def reset(self, known, key):
        return self._kept(known)

    def act(self, carry, known, key, step):
        return self._kept(known), BodyTwist(nu=jnp.zeros_like(known.belief.nu))


@pytest.fixture(scope="module")
def scene(scenes):
    with jax.enable_x64(True):
        build, members, obstacles = scenes
        drawn = build(WORLDS, members=members("bluerov2") * 2, config=obstacles["all"])
        keys = jax.random.key_data(jax.random.split(jax.random.key(3), WORLDS))
        yield replace(drawn, worlds=replace(drawn.worlds, policy_key=keys))


def fly(engine, scene):
    policy: Any = Watcher()
    with jax.enable_x64(True):
        state = quickly(partial(FusedEngine().reset, scene.spec))(scene.fleet, scene.worlds, policy)
        run = partial(engine.segment, scene.spec, n_sample=STEPS, steps_per_sample=1)
        return jax.device_get(quickly(run)(scene.fleet, scene.worlds, state, policy=policy))


@pytest.mark.parametrize(
    "engine",
    [
        FusedEngine(),
        pytest.param(MjxEngine(), marks=pytest.mark.nightly(by="the fused engine in plain JAX")),
        pytest.param(
            CudaEngine(block=2, interpret=True),
            marks=pytest.mark.nightly(by="the fused engine in plain JAX"),
        ),
    ],
)
def test_the_truth_is_what_follows(engine, scene):
    """Told in step 16: obstacles of that step and, half a second later, of step 26."""
    after, seen = fly(engine, scene)
    told, probe, rock = after.policy.carry
    np.testing.assert_allclose(told.p_m[:, :, 0], seen.obstacle_p[:, AT], atol=1e-9)
    np.testing.assert_allclose(told.time_s[0], [0.0, 0.5], atol=1e-12)
    then = seen.obstacle_p[:, AT + 10]
    np.testing.assert_allclose(told.p_m[:, :, 1], then, atol=1e-9)
    assert np.abs(then - seen.obstacle_p[:, AT]).max() > 0.05
    # The current of then and there: 16 steps of 50 ms.
    place = jax.tree.map(np.asarray, scene.worlds.environment)
    for world in range(WORLDS):
        flow = jax.tree.map(lambda leaf, world=world: leaf[world], place.current)
        with jax.enable_x64(True):
            now = jnp.float64(0.05 * AT)
            wanted = [currents.velocity(flow, p, now) for p in seen.p[world, AT]]
        np.testing.assert_allclose(probe[world], wanted, atol=1e-9)
    np.testing.assert_array_equal(rock, place.grid.occupied.sum((1, 2, 3)))


def test_what_is_predicted_at_the_start_knows_nothing_of_later_currents(scene):
    """Other knots after the first move what truly drifts, and nothing that is predicted."""
    with jax.enable_x64(True):
        place = jax.tree.map(lambda leaf: leaf[0], scene.worlds.environment)
        flow = currents.GaussMarkov(
            knots_mps=jnp.array([[0.3, 0.0, 0.0]] * 2 + [[-0.6, 0.4, 0.1]] * 3),
            knot_dt_s=jnp.float64(1.0),
        )
        turns = replace(place, current=(flow,))
        stays = replace(place, current=(currents.Uniform(velocity_mps=flow.knots_mps[0]),))

        @partial(quickly, static_argnums=1)
        def told(environment, obstacles):
            levels = Information(obstacles=obstacles, current="predicted")
            return information.obstacle_information(
                environment, levels, 4.0, 0.05, 1000.0, 9.81
            ).p_m

        predicted, held = told(turns, "predicted"), told(stays, "truth")
        drifting = np.asarray(place.obstacles.motion == DRIFT)
        np.testing.assert_allclose(predicted[drifting], held[drifting], atol=1e-9)
        assert np.abs(told(turns, "truth") - predicted)[drifting].max() > 0.05


def test_whether_any_may_stand_is_said(scene):
    """So that no code need look for them where a scenario has none."""
    place = jax.tree.map(lambda leaf: leaf[0], scene.worlds.environment)
    moving = replace(place, obstacles=replace(place.obstacles, motions=(DRIFT,)))
    asked = (Information(obstacles="observed"), 1.0, 0.05, 1000.0, 9.81)
    assert information.obstacle_information(place, *asked).some_stand
    assert not information.obstacle_information(moving, *asked).some_stand


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"information": Information(obstacles="all")},
            "information.obstacles = 'all'; there is nothing, observed",
        ),
        ({"information": "truth"}, "information = 'truth'; give an Information"),
        ({"ahead_s": -1.0}, "ahead_s = -1.0; give a time"),
    ],
)
def test_what_nobody_can_tell_is_refused(changes, said):
    with pytest.raises(ConfigError, match=said):
        policies.check_information(Watcher(**changes))
