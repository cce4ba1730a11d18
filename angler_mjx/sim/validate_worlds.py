"""Worlds that enter a simulator: what they hold twice must agree, as engines read one or the other.

A `World` holds its robots' parameters beside the variants that they are, and a packed form of its
cells beside the cells. Programs read what is fastest: numbers of the fleet that were compiled in,
or the packed cells. So whoever edits a world by ``dataclasses.replace`` is either seen by all
engines, or refused here:

- cells are packed anew where they are not those that the packed form was made of;
- parameters and multibody fields that are not the fleet's are refused, as is a variant that its
  robot cannot be, and an obstacle of a kind or motion that programs are not made for.

The rest of a world (paths, goals, starts, currents, floor, sizes and places of obstacles, cruise
speeds) is read as it is by every engine. Nothing is looked at twice: arrays do not change, so those
that were found right are known again by identity, without waiting for a device.
"""

import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.physics.mjx_engine import BodyInertia
from angler_mjx.sim.state import World

type PackCells = Callable[[jax.Array], jax.Array]
"""Cells [W, nx, ny, nz] to `clearance.cell_neighbours` of each world."""
type SelectParameters = Callable[[jax.Array], tuple[ControlParams, BodyInertia]]
"""Variants [W, R] to `fleet.parameters`."""


@dataclass(frozen=True, kw_only=True)
class _ValidatedWorlds:
    """What was found right."""

    leaves: tuple[weakref.ref[Any], ...]
    """They are not kept alive."""
    packed: Callable[[], jax.Array | None]
    """Their cells; not kept alive where they came with the worlds."""

    def is_same(self, leaves: Sequence[Any]) -> bool:
        return len(leaves) == len(self.leaves) and all(
            reference() is leaf for reference, leaf in zip(self.leaves, leaves, strict=True)
        )


class WorldValidator:
    """Where worlds enter the engine of one fleet."""

    def __init__(self, fleet: Fleet, *, take: SelectParameters, pack: PackCells | None) -> None:
        """A gate that knows no world yet.

        Args:
            fleet: what the engine's programs are made of.
            take: its parameters.
            pack: for engines that look cells up in the packed form.
        """
        self._select_parameters, self._pack_cells = take, pack
        self._possible = np.isfinite(np.asarray(fleet.log_weight))
        self._leaves = _name_leaves({"control": fleet.control, "body": fleet.body})
        self._validated: list[_ValidatedWorlds] = []

    def accept_sampled(self, worlds: World) -> World:
        """Worlds that were made of this fleet: they are taken as they are from now on."""
        came = worlds.cell_neighbours
        traced = came is None or isinstance(came, jax.core.Tracer)
        self._remember_worlds(
            _list_guarded(worlds), (lambda: None) if traced else weakref.ref(came)
        )
        return worlds

    def validate_worlds(self, worlds: World) -> World:
        """Worlds as the engine may read them; those that are traced are taken as they are.

        Raises:
            ConfigError: they hold what the engine would not see.
        """
        guarded = _list_guarded(worlds)
        if any(isinstance(leaf, jax.core.Tracer) for leaf in guarded):
            return worlds
        for validated in self._validated:
            if validated.is_same(guarded):
                return _with_packed(worlds, validated.packed())
        self._check_worlds(worlds)
        cells = worlds.environment.grid.occupied
        packed = None if self._pack_cells is None else self._pack_cells(cells)
        self._remember_worlds(guarded, lambda: packed)
        return _with_packed(worlds, packed)

    def adopt(self, worlds: World) -> World:
        """Worlds with the parameters that this fleet gives to their variants.

        Raises:
            ConfigError: a robot cannot be its variant.
        """
        self._check_variants(worlds)
        control, body = self._select_parameters(worlds.variant)
        speed = worlds.control.cruise_speed_mps
        return replace(worlds, control=replace(control, cruise_speed_mps=speed), body=body)

    def _remember_worlds(
        self, leaves: Sequence[Any], packed: Callable[[], jax.Array | None]
    ) -> None:
        # NumPy's arrays can be written to, and a tracer is gone after its trace.
        fixed = all(isinstance(leaf, jax.Array) for leaf in leaves)
        if not fixed or any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            return
        alive = [
            validated
            for validated in self._validated
            if all(ref() is not None for ref in validated.leaves)
        ]
        self._validated = [
            *alive,
            _ValidatedWorlds(leaves=tuple(map(weakref.ref, leaves)), packed=packed),
        ]

    def _check_worlds(self, worlds: World) -> None:
        """Refuse what would not be seen (host side)."""
        self._check_variants(worlds)
        variant = np.asarray(worlds.variant)
        leaves = _name_leaves({"control": worlds.control, "body": worlds.body})
        if other := leaves.keys() ^ self._leaves.keys():
            names = ", ".join(f"World.{name}" for name in sorted(other)[:3])
            raise ConfigError(f"{names}: this fleet and the worlds do not both have it; {_ADVICE}")
        for name, leaf in leaves.items():
            if name != _SPEED:
                _check_leaf(name, np.asarray(leaf), np.asarray(self._leaves[name]), variant)
        _check_obstacles(worlds)

    def _check_variants(self, worlds: World) -> None:
        variant, possible = np.asarray(worlds.variant), self._possible
        robots, kinds = possible.shape
        if variant.shape[1:] != (robots,):
            raise ConfigError(
                f"World.variant has the shape {variant.shape}: must be [world, robot] with "
                f"{robots} robots"
            )
        inside = (variant >= 0) & (variant < kinds)
        right = inside & possible[np.arange(robots), np.where(inside, variant, 0)]
        if not right.all():
            world, robot = np.argwhere(~right)[0]
            can = ", ".join(map(str, np.flatnonzero(possible[robot])))
            raise ConfigError(
                f"World.variant of world {world}, robot {robot} is {variant[world, robot]}: this "
                f"robot can be {can}; say in the scenario's [[fleet]] what it can be"
            )


_SPEED = "control.cruise_speed_mps"
"""The one number of the parameters that is each world's own."""

_ADVICE = (
    "vehicles' parameters are the fleet's: edit a vehicle file or a parameter set and make another "
    "Simulator, or take Simulator.adopt(worlds) for this fleet's"
)


def _list_guarded(worlds: World) -> list[Any]:
    """The arrays that are looked at."""
    obstacles = worlds.environment.obstacles
    return [
        worlds.variant,
        *jax.tree.leaves((worlds.control.vehicle, worlds.control.allocation)),
        *jax.tree.leaves(worlds.body),
        *(obstacles.kind, obstacles.motion, obstacles.exists),
        worlds.environment.grid.occupied,
        *jax.tree.leaves(worlds.cell_neighbours),
    ]


def _name_leaves(trees: dict[str, Any]) -> dict[str, Any]:
    """Leaves by the names that a user sees."""
    return {
        name + jax.tree_util.keystr(path): leaf
        for name, tree in trees.items()
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree)
    }


def _check_leaf(name: str, values: np.ndarray, ours: np.ndarray, variant: np.ndarray) -> None:
    """Refuse a leaf [W, R, ...] that is not that of the fleet [n_variant, ...]."""
    right = ours[variant]
    if values.shape != right.shape:
        raise ConfigError(
            f"World.{name} has the shape {values.shape}: must be {right.shape}; {_ADVICE}"
        )
    wrong = values != right
    if right.dtype.kind == "f":
        wrong &= ~(np.isnan(values) & np.isnan(right))
    if wrong.any():
        world, robot, *element = at = tuple(int(i) for i in np.argwhere(wrong)[0])
        where = f"[{', '.join(map(str, element))}]" if element else ""
        raise ConfigError(
            f"World.{name}{where} of world {world}, robot {robot} is {float(values[at]):g}: its "
            f"variant, {variant[world, robot]}, has {float(right[at]):g}; {_ADVICE}"
        )


def _with_packed(worlds: World, packed: jax.Array | None) -> World:
    """The same worlds with other packed cells."""
    if worlds.cell_neighbours is packed:
        return worlds
    return replace(worlds, cell_neighbours=packed)


def _check_obstacles(worlds: World) -> None:
    """Refuse obstacles that programs are not made for: `Obstacles.kinds` and ``motions`` say so."""
    obstacles = worlds.environment.obstacles
    exists = np.asarray(obstacles.exists)
    for name, made in (("kind", obstacles.kinds), ("motion", obstacles.motions)):
        values = np.asarray(getattr(obstacles, name))
        wrong = exists & ~np.isin(values, made)
        if wrong.any():
            world, which = np.argwhere(wrong)[0]
            raise ConfigError(
                f"World.environment.obstacles.{name} of world {world}, obstacle {which} is "
                f"{values[world, which]}: obstacles.{name}s = {made} says what programs are made "
                f"for; replace {name}s too"
            )
