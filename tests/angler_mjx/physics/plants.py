"""The vehicles that the physics is tested on, and a rollout of them by the simulator's own step."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from angler_mjx.physics import mjx_engine
from angler_mjx.physics import step as physics
from angler_mjx.physics.mjx_engine import BodyInertia, MjxEngine
from angler_mjx.vehicles import library, mjcf, params
from angler_mjx.vehicles.config import VehicleConfig
from angler_mjx.vehicles.params import VehicleParams

WATER = physics.Water()


@dataclass(frozen=True)
class Plants:
    names: list[str]
    configs: list[tuple[VehicleConfig, str]]
    models: list[mujoco.MjModel]
    engine: MjxEngine
    body: BodyInertia
    params: VehicleParams

    def __len__(self) -> int:
        return len(self.names)


def configs() -> list[tuple[VehicleConfig, str]]:
    """All shipped vehicles with all their sets, and a Heavy whose matrices are full."""
    shipped = [
        (config, name)
        for config in map(library.load, library.available())
        for name in sorted(config.parameter_sets)
    ]
    return [*shipped, (skewed(), "wu2018")]


def skewed() -> VehicleConfig:
    """A Heavy with full inertia and added mass, so that no cross term goes untested."""
    data = library.load("bluerov2_heavy").model_dump()
    chosen = data["parameter_sets"]["wu2018"]
    chosen["rigid_body"]["inertia_kgm2"] = [
        [0.26, 0.02, -0.03],
        [0.02, 0.23, 0.04],
        [-0.03, 0.04, 0.37],
    ]
    half = np.random.default_rng(5).normal(size=(6, 6)) * np.sqrt([2, 2, 2, 0.02, 0.02, 0.02])
    added = half.T @ half + np.diag([5.5, 12.7, 14.57, 0.12, 0.12, 0.12])
    chosen["added_mass"]["coefficients"] = (0.5 * (added + added.T)).tolist()
    chosen["buoyancy"]["center_of_buoyancy_m"] = [0.01, -0.02, 0.03]
    data["name"] = "skewed"
    return VehicleConfig.model_validate(data)


def build(chosen: list[tuple[VehicleConfig, str]]) -> Plants:
    specs = [mjcf.to_spec(c, name, shapes=False) for c, name in chosen]
    engine, body = mjx_engine.build(specs)
    return Plants(
        names=[f"{config.name}/{name}" for config, name in chosen],
        configs=chosen,
        models=[spec.compile() for spec in specs],
        engine=engine,
        body=body,
        params=params.stack([params.build(config, name, 16.0) for config, name in chosen]),
    )


def pick(tree: Any, index: int) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], tree)


def random_states(seed: int, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses deep under water at any attitude, velocities of about 1 m/s and 1 rad/s."""
    rng = np.random.default_rng(seed)
    p = rng.uniform([-5, -5, -12], [5, 5, -6], (*shape, 3))
    q = rng.normal(size=(*shape, 4))
    return p, q / np.linalg.norm(q, axis=-1, keepdims=True), rng.normal(size=(*shape, 6))


@partial(jax.jit, static_argnames=("dt", "steps"))
def rollout(engine, body, vehicles, states, commands, current, *, dt, steps):
    """States after each command, each held for ``steps`` steps; one row a vehicle.

    Args:
        engine: of the plants.
        body: [n] leads.
        vehicles: [n] leads.
        states: [n] leads.
        commands: [n, n_command, n_thruster] thrust, N.
        current: of the world, the same for all.
        dt: s.
        steps: physics steps a command.
    """

    def one(body, vehicle, state, commands):
        state = physics.start_multistep(engine, body, vehicle, state, current, jnp.zeros(()), WATER)

        def hold(carry, command):
            def step(carry, _):
                state, i = carry
                state = physics.step(
                    engine, body, vehicle, state, command, current, i * dt, dt, WATER
                )
                return (state, i + 1), None

            carry, _ = jax.lax.scan(step, carry, length=steps)
            return carry, carry[0]

        return jax.lax.scan(hold, (state, jnp.zeros((), int)), commands)[1]

    return jax.vmap(one)(body, vehicles, states, commands)


def start(vehicles: VehicleParams, p, q, nu) -> physics.VehicleState:
    """States with thrusters at rest; ``rollout`` starts the multistep formula itself."""
    n, _, n_thruster = vehicles.B.shape
    return physics.VehicleState(
        p=jnp.asarray(p),
        q=jnp.asarray(q),
        nu=jnp.asarray(nu),
        force_before=jnp.zeros((n, 6)),
        thrust=jnp.zeros((n, n_thruster)),
    )


@jax.jit
def accelerations(engine, body, vehicles, p, q, nu, thrust, current):
    """nu' [n, k, 6] of n vehicles in k states each, thrusters at the given thrusts."""

    def one(body, vehicle, p, q, nu, thrust):
        state = physics.VehicleState(p=p, q=q, nu=nu, force_before=nu, thrust=thrust)
        M, force, _ = physics.smooth_force(
            engine, body, vehicle, state, current, jnp.zeros(()), WATER
        )
        return jnp.linalg.solve(M, force + vehicle.B @ thrust)

    many = jax.vmap(one, (None, None, 0, 0, 0, 0))
    return jax.vmap(many)(body, vehicles, p, q, nu, thrust)
