"""The vehicles that the physics is tested on, and a rollout of them by the simulator's own step."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from angler_mjx.robot.vehicles import library, mjcf, params
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim.physics import mjx_engine
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.mjx_engine import BodyInertia, MjxPhysics
from angler_mjx.world.currents import Uniform, Vortices

from ...compiling import quickly

WATER = physics.Water()


@dataclass(frozen=True)
class Plants:
    names: list[str]
    configs: list[tuple[VehicleConfig, str]]
    models: list[mujoco.MjModel]
    engine: MjxPhysics
    body: BodyInertia
    params: VehicleParams

    def __len__(self) -> int:
        return len(self.names)


def configs() -> list[tuple[VehicleConfig, str]]:
    """All shipped rigid vehicles with their published sets, and a Heavy whose matrices are full."""
    shipped = [
        (config, name)
        for config in map(library.load_vehicle, library.list_rovs())
        if not config.links
        for name in sorted(config.published_sets)
    ]
    return [*shipped, (skewed(), "wu2018")]


def skewed() -> VehicleConfig:
    """A Heavy with full inertia and added mass, so that no cross term goes untested."""
    data = library.load_vehicle("bluerov2_heavy").model_dump()
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


def coupled() -> VehicleConfig:
    """The skewed Heavy with full damping and the lift of a hull."""
    data = skewed().model_dump()
    damping = data["parameter_sets"]["wu2018"]["damping"]
    rng, size = np.random.default_rng(6), np.sqrt([4.0, 6.2, 5.2, 0.07, 0.07, 0.07])
    half = 0.4 * rng.normal(size=(6, 6)) * size
    turn = rng.normal(size=(6, 6)) * np.outer(size, size)
    damping["linear"] = (np.diag(size**2) + half.T @ half + 0.3 * (turn - turn.T)).tolist()
    root = np.sqrt(damping["quadratic"])
    mixed = 0.2 * rng.normal(size=(6, 6)) * np.outer(root, root)
    damping["quadratic"] = (np.diag(root**2) + mixed - np.diag(np.diag(mixed))).tolist()
    damping["products"] = {"Y_uv": -9.0, "Z_uw": -8.0, "M_wu": 2.0, "N_uv": -3.0, "K_pp": 0.02}
    data["name"] = "coupled"
    return VehicleConfig.model_validate(data)


def build(chosen: list[tuple[VehicleConfig, str]]) -> Plants:
    specs = [mjcf.to_spec(c, name, shapes=False) for c, name in chosen]
    engine, body = mjx_engine.build_engine(specs)
    return Plants(
        names=[f"{config.name}/{name}" for config, name in chosen],
        configs=chosen,
        models=[spec.compile() for spec in specs],
        engine=engine,
        body=body,
        params=params.stack_vehicles(
            [params.build_vehicle(config, name, 16.0) for config, name in chosen]
        ),
    )


def pick(tree: Any, index: int) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], tree)


def random_states(seed: int, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses deep under water at any attitude, velocities of about 1 m/s and 1 rad/s."""
    rng = np.random.default_rng(seed)
    p = rng.uniform([-5, -5, -12], [5, 5, -6], (*shape, 3))
    q = rng.normal(size=(*shape, 4))
    return p, q / np.linalg.norm(q, axis=-1, keepdims=True), rng.normal(size=(*shape, 6))


ROWS, ROW_S = 100, 0.1
"""All rollouts have as many commands, each held as long: one program serves them all."""


def still():
    """Water at rest, with the components that a current of these tests may have."""
    return (
        Uniform(velocity_mps=jnp.zeros(3)),
        Vortices(
            centre_m=jnp.array([[1000.0, 0.0]]),
            circulation_m2ps=jnp.zeros(1),
            core_m=jnp.ones(1),
        ),
    )


def rollout(engine, body, vehicles, states, commands, current, *, dt):
    """States [n, 100] every 0.1 s, by steps of dt; commands [n, 100, n_thruster] are of that time.

    Where there are fewer commands, thrusters are off after the last of them.
    """
    every = np.zeros((len(commands), ROWS, commands.shape[2]))
    every[:, : commands.shape[1]] = commands
    assert len(current) == 2, "another current is another program"
    steps = round(ROW_S / dt)
    return _rollout(engine, body, vehicles, states, every, current, dt, steps)


@quickly
def _rollout(engine, body, vehicles, states, commands, current, dt, steps):
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
            def step(_, carry):
                state, i = carry
                state = physics.step(
                    engine, body, vehicle, state, command, current, i * dt, dt, WATER
                )
                return state, i + 1

            carry = jax.lax.fori_loop(0, steps, step, carry)
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


@quickly
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
