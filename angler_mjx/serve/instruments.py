"""Readings of the robots' instruments, as the scenario's ``[fleet.sensors]`` describe them.

Robots whose controllers use a filter publish the readings that the filter takes. Those of robots
whose controllers use the truth are exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.sensing import suite
from angler_mjx.robot.sensing.config import SensorsConfig
from angler_mjx.robot.sensing.params import SensorParams, build_sensors
from angler_mjx.robot.sensing.readings import Reading, SensorCarry, Truth
from angler_mjx.sim.state import FleetWorld
from angler_mjx.world.rock.grid import Grid, height_above_bottom


@dataclass(frozen=True, kw_only=True)
class FleetReading:
    """Readings of a fleet at one step; [R] leads, on the host."""

    reading: Reading
    altitude_m: np.ndarray
    """[R] true height above the bottom."""


class FleetInstruments:
    """Instruments of the robots of one world, read once in each step from the reset on."""

    def __init__(
        self,
        configs: Sequence[SensorsConfig],
        *,
        dt_s: float,
        gravity_mps2: float,
    ) -> None:
        """Compile the instruments.

        Args:
            configs: instruments of each robot.
            dt_s: control period, s.
            gravity_mps2: m/s^2.
        """
        self._count = len(configs)
        built = [build_sensors(config, dt_s, gravity_mps2) for config in configs]
        # Whether there is noise is fixed while the instruments are compiled.
        self._groups: list[tuple[list[int], SensorParams]] = []
        for noise in (False, True):
            rows = [i for i, params in enumerate(built) if params.noise == noise]
            if rows:
                stacked: SensorParams = jax.tree.map(
                    lambda *leaves: jnp.stack(leaves), *(built[i] for i in rows)
                )
                self._groups.append((rows, stacked))

    def reset(self, worlds: FleetWorld, seed: int, truth: Estimate) -> None:
        """Switch the instruments on.

        Args:
            worlds: world of the session, [1] leads.
            seed: of the random numbers of robots whose controllers use the truth.
            truth: true motion at the reset.
        """
        environment = jax.tree.map(lambda leaf: leaf[0], worlds.environment)
        self._grid, self._floor_z_m = environment.grid, environment.floor_z_m
        if worlds.sensing_key is not None:
            keys = worlds.sensing_key[0]
        else:
            base = jax.random.key(seed)
            keys = jnp.stack(
                [jax.random.key_data(jax.random.fold_in(base, i)) for i in range(self._count)]
            )
        self._keys, self._step = keys, 0
        seen = _expose(self._grid, self._floor_z_m, truth)
        self._memory = [
            jax.vmap(suite.reset)(params, keys[np.array(rows)], _rows(seen, rows))
            for rows, params in self._groups
        ]

    def read(self, truth: Estimate) -> FleetReading:
        """Read all instruments; call once in each step.

        Args:
            truth: true motion now.
        """
        parts = []
        for i, (rows, params) in enumerate(self._groups):
            self._memory[i], reading, altitude = _read_group(
                params,
                self._memory[i],
                self._keys[np.array(rows)],
                self._step,
                self._grid,
                self._floor_z_m,
                _rows(truth, rows),
            )
            parts.append((reading, altitude))
        self._step += 1
        order = np.argsort(np.concatenate([rows for rows, _ in self._groups]))
        reading, altitude = jax.tree.map(
            lambda *leaves: np.concatenate([np.asarray(leaf) for leaf in leaves])[order], *parts
        )
        return FleetReading(reading=reading, altitude_m=altitude)


def _rows[T](tree: T, rows: list[int]) -> T:
    selected: T = jax.tree.map(lambda leaf: leaf[np.array(rows)], tree)
    return selected


def _expose(grid: Grid, floor_z_m: jax.Array, truth: Estimate) -> Truth:
    """Return what instruments are exposed to, [R] leading. Obstacles are no bottom."""
    p, q, nu = (jnp.asarray(part) for part in (truth.p, truth.q, truth.nu))
    altitude = jax.vmap(height_above_bottom, (None, None, 0))(grid, floor_z_m, p)
    return Truth(p=p, q=q, nu=nu, altitude_m=altitude)


@jax.jit
def _read_group(
    params: SensorParams,
    memory: SensorCarry,
    keys: jax.Array,
    step: jax.Array,
    grid: Grid,
    floor_z_m: jax.Array,
    truth: Estimate,
) -> tuple[SensorCarry, Reading, jax.Array]:
    seen = _expose(grid, floor_z_m, truth)
    read = jax.vmap(suite.step, (0, 0, 0, None, 0))
    memory, reading = read(params, memory, keys, step, seen)
    return memory, reading, seen.altitude_m
