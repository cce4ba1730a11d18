"""State of worlds as kernels keep it from step to step: planes of lanes."""

from dataclasses import dataclass, field, fields, replace
from typing import Any

import jax
import jax.numpy as jnp

from angler_kernels.lanes.planes import PlaneLayout
from angler_mjx.sim.engines.cuda.launch import LaunchShape
from angler_mjx.sim.engines.cuda.packing import pack_by_name
from angler_mjx.sim.state import WorldState
from angler_mjx.sim.step import RobotState
from angler_mjx.sim.world_phases import WorldMemory

_STATIC = {"static": True}
BODIES = "bodies"
"""Name of the planes of `ObstacleState`; the others are fields of `RobotState`."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PackedState:
    """`WorldState` of worlds [W], and of more until blocks are full, which repeat the last one."""

    planes: dict[str, jax.Array]
    """Flat arrays by name."""
    memory: WorldMemory
    """[filled W] leads: what robots know of themselves is not the kernels' work."""
    step: jax.Array
    """int32 [filled W]."""
    layouts: tuple[tuple[str, PlaneLayout[Any]], ...] = field(metadata=_STATIC)
    """Layouts of the flat arrays by name."""
    worlds: int = field(metadata=_STATIC)
    """Number of worlds, without the repeated ones."""

    @classmethod
    def of(cls, state: WorldState, block: int, packing: LaunchShape | None) -> "PackedState":
        """Pack a state.

        Args:
            state: [W] leads.
            block: lanes of a block.
            packing: threads of the kernels that pack it; None to leave it to XLA.
        """
        worlds = state.step.shape[0]
        full = fill(state, -worlds % block)
        robots = {"vehicle": full.vehicles, "memory": full.carry, "tally": full.tally}
        dtype = full.vehicles.p.dtype
        packed = pack_by_name(packing, robots, dtype)
        packed |= pack_by_name(packing, {BODIES: full.obstacles}, dtype)
        return cls(
            planes={name: flat for name, (_, flat) in packed.items()},
            memory=WorldMemory.of(full),
            step=full.step,
            layouts=tuple((name, layout) for name, (layout, _) in packed.items()),
            worlds=worlds,
        )

    @property
    def filled(self) -> int:
        """Return the number of worlds with the repeated ones."""
        return self.step.shape[0]

    def layout(self, name: str) -> PlaneLayout[Any]:
        """Return the layout of a flat array."""
        return dict(self.layouts)[name]

    def shapes(self, name: str) -> Any:
        """Return the tree of a flat array, with the shapes of one body as leaves."""
        layout = self.layout(name)
        return jax.tree.unflatten(
            layout.tree, [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in layout.leaves]
        )

    def unpack_planes(self, name: str) -> Any:
        """Return the tree of a flat array, [filled W, rows] leading."""
        layout = self.layout(name)
        return layout.unpack(self.planes[name], (self.filled, layout.lanes // self.filled))

    def unpack_filled(self) -> WorldState:
        """Return the state with the repeated worlds."""
        robots = RobotState(**{x.name: self.unpack_planes(x.name) for x in fields(RobotState)})
        return WorldState(
            vehicles=robots.vehicle,
            carry=robots.memory,
            obstacles=self.unpack_planes(BODIES),
            tally=robots.tally,
            step=self.step,
            **vars(self.memory),
        )

    def unpack(self) -> WorldState:
        """Return the state."""
        state: WorldState = jax.tree.map(lambda leaf: leaf[: self.worlds], self.unpack_filled())
        return state

    def select(self, rows: jax.Array) -> "PackedState":
        """Return the states of worlds ``rows`` int32, as many as blocks hold."""

        def select_lanes(name: str, flat: jax.Array) -> jax.Array:
            return self._by_world(name, flat)[:, rows].reshape(-1)

        memory, step = jax.tree.map(lambda leaf: leaf[rows], (self.memory, self.step))
        lanes = {name: layout.lanes // self.filled for name, layout in self.layouts}
        return replace(
            self,
            planes={name: select_lanes(name, flat) for name, flat in self.planes.items()},
            memory=memory,
            step=step,
            layouts=tuple(
                (name, replace(layout, lanes=lanes[name] * len(rows)))
                for name, layout in self.layouts
            ),
            worlds=len(rows),
        )

    def replace_worlds(
        self, ended: jax.Array, initial: "PackedState", rows: jax.Array
    ) -> "PackedState":
        """Return a state whose ended worlds are worlds of another state.

        Args:
            ended: bool [W].
            initial: state that they are taken from.
            rows: int32 [W] whose of its worlds.
        """
        extra = self.filled - self.worlds
        ended, rows = fill((ended, rows), extra)
        new = initial.select(rows)

        def replace_planes(name: str) -> jax.Array:
            old, other = (self._by_world(name, x.planes[name]) for x in (self, new))
            return jnp.where(ended, other, old).reshape(-1)

        def replace_leaf(other: jax.Array, old: jax.Array) -> jax.Array:
            return jnp.where(ended.reshape(-1, *(1,) * (old.ndim - 1)), other, old)

        memory, step = jax.tree.map(replace_leaf, (new.memory, new.step), (self.memory, self.step))
        planes = {name: replace_planes(name) for name in self.planes}
        return replace(self, planes=planes, memory=memory, step=step)

    def replace_energy(self, energy_j: jax.Array) -> "PackedState":
        """Return a state with other energies [W, R] in its tally."""
        layout = self.layout("tally")
        leaf = jax.tree.unflatten(layout.tree, layout.leaves).energy_j
        lanes = fill(energy_j, self.filled - self.worlds).T.reshape(-1)
        first = leaf.first * layout.lanes
        tally = self.planes["tally"].at[first : first + layout.lanes].set(lanes)
        return replace(self, planes={**self.planes, "tally": tally})

    def _by_world(self, name: str, flat: jax.Array) -> jax.Array:
        """Return a flat array as [planes and rows, W]."""
        layout = self.layout(name)
        rows = layout.lanes // self.filled
        return flat.reshape(layout.planes * rows, -1)


def fill[T](tree: T, extra: int) -> T:
    """Return arrays with ``extra`` repetitions of their last rows."""

    def fill_leaf(leaf: jax.Array) -> jax.Array:
        return jnp.concatenate([leaf, jnp.repeat(leaf[-1:], extra, axis=0)]) if extra else leaf

    filled: T = jax.tree.map(fill_leaf, tree)
    return filled
