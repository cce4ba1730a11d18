"""Readings of the robots' instruments, as the scenario's ``[fleet.sensors]`` describe them.

Robots whose controllers use a filter publish the readings that the filter takes. Those of robots
whose controllers use the truth are exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.sensing import suite
from angler_mjx.robot.sensing.config import SensorsConfig
from angler_mjx.robot.sensing.params import SensorParams, build_sensors
from angler_mjx.robot.sensing.readings import Reading, SensorCarry, Truth
from angler_mjx.sim.state import FleetWorld
from angler_mjx.world.rock.grid import Grid, height_above_bottom

type Motion = tuple[np.ndarray | jax.Array, np.ndarray | jax.Array, np.ndarray | jax.Array]
"""Positions [R, 3], attitudes [R, 4] and velocities [R, 6], as of `Estimate`."""


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
                stacked: SensorParams = jax.tree.map(_stack_leaves, *(built[i] for i in rows))
                self._groups.append((rows, stacked))

    def reset(self, worlds: FleetWorld, seed: int, truth: Estimate) -> None:
        """Switch the instruments on.

        Args:
            worlds: world of the session, [1] leads.
            seed: of the random numbers of robots whose controllers use the truth.
            truth: true motion at the reset.
        """
        # On the host: an index on the device is a program each.
        grid, floor_z_m = jax.device_get((worlds.environment.grid, worlds.environment.floor_z_m))
        self._grid, self._floor_z_m = jax.tree.map(lambda leaf: leaf[0], (grid, floor_z_m))
        keys = (
            _make_keys(np.uint32(seed), self._count)
            if worlds.sensing_key is None
            else np.asarray(worlds.sensing_key)[0]
        )
        self._step, motion = 0, _motion(truth)
        self._keys = [as_leaf(np.asarray(keys)[np.array(rows)]) for rows, _ in self._groups]
        self._memory = [
            _reset_group(params, group_keys, self._grid, self._floor_z_m, _rows(motion, rows))
            for (rows, params), group_keys in zip(self._groups, self._keys, strict=True)
        ]

    def read(self, truth: Estimate) -> FleetReading:
        """Read all instruments; call once in each step.

        Args:
            truth: true motion now.
        """
        parts, step = [], np.int32(self._step)
        seen = _motion(truth)
        for i, (rows, params) in enumerate(self._groups):
            motion = seen if len(self._groups) == 1 else _rows(seen, rows)
            self._memory[i], *read = _read_group(
                params,
                self._memory[i],
                self._keys[i],
                step,
                self._grid,
                self._floor_z_m,
                motion,
            )
            parts.append(jax.device_get(tuple(read)))
        self._step += 1
        if len(parts) == 1:
            return FleetReading(reading=parts[0][0], altitude_m=parts[0][1])
        order = np.argsort(np.concatenate([rows for rows, _ in self._groups]))
        reading, altitude = jax.tree.map(lambda *leaves: np.concatenate(leaves)[order], *parts)
        return FleetReading(reading=reading, altitude_m=altitude)


def _motion(truth: Estimate) -> Motion:
    return np.asarray(truth.p), np.asarray(truth.q), np.asarray(truth.nu)


def _rows[T](tree: T, rows: list[int]) -> T:
    selected: T = jax.tree.map(lambda leaf: leaf[np.array(rows)], tree)
    return selected


def _expose(grid: Grid, floor_z_m: jax.Array, motion: Motion) -> Truth:
    """Return what instruments are exposed to, [R] leading. Obstacles are no bottom."""
    p, q, nu = map(jnp.asarray, motion)
    altitude = jax.vmap(height_above_bottom, (None, None, 0))(grid, floor_z_m, p)
    return Truth(p=p, q=q, nu=nu, altitude_m=altitude)


def _stack_leaves(*leaves: np.ndarray) -> jax.Array:
    stacked = np.stack([np.asarray(leaf) for leaf in leaves])
    return as_leaf(stacked)


@partial(jax.jit, static_argnums=1)
def _make_keys(seed: jax.Array, count: int) -> jax.Array:
    """Return the keys [R, ...] of robots whose controllers use the truth."""
    base = jax.random.key(seed)
    return jnp.stack([jax.random.key_data(jax.random.fold_in(base, i)) for i in range(count)])


@jax.jit
def _reset_group(
    params: SensorParams, keys: jax.Array, grid: Grid, floor_z_m: jax.Array, motion: Motion
) -> SensorCarry:
    memory: SensorCarry = jax.vmap(suite.reset)(params, keys, _expose(grid, floor_z_m, motion))
    return memory


@jax.jit
def _read_group(
    params: SensorParams,
    memory: SensorCarry,
    keys: jax.Array,
    step: jax.Array,
    grid: Grid,
    floor_z_m: jax.Array,
    motion: Motion,
) -> tuple[SensorCarry, Reading, jax.Array]:
    seen = _expose(grid, floor_z_m, motion)
    read = jax.vmap(suite.step, (0, 0, 0, None, 0))
    memory, reading = read(params, memory, keys, step, seen)
    return memory, reading, seen.altitude_m
