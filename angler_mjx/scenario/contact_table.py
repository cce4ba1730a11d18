"""The table of a scenario file on contact between bodies, and between bodies and the ground."""

import math

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, field_validator

from angler_mjx.files import FileModel
from angler_mjx.sim.physics.contact.grips import GripSpec
from angler_mjx.sim.physics.contact.overlap import find_overlaps
from angler_mjx.sim.physics.contact.resolve import ContactSpec
from angler_mjx.world.config import WorldConfig, resolve_world
from angler_mjx.world.materials import (
    damping_ratio,
    find_material,
    pair_friction,
    pair_restitution,
)
from angler_mjx.world.obstacles.config import BoxConfig, CapsuleConfig, DriftMotion
from angler_mjx.world.obstacles.explicit import explicit_rows

RATE_STEPS = 4.0
"""Physics steps in the time 1 / omega of a contact. With 4 the coefficient of restitution is that
of continuous time to within 0.03 (`contact.restitution` of the validation), and a fleet at 0.5 m/s
overlaps by at most 1 cm at steps of 5 ms."""


class ContactConfig(FileModel):
    """Materials in contact, and how hard an impact a robot survives.

    Materials are those of `angler_mjx/world/data/materials.toml`, which has their friction and
    restitution, and sources.
    """

    robot: str = "hdpe"
    """Material of the robots and their arms."""
    obstacle: str = "pvc"
    """Material of the obstacles."""
    rock: str = "rock"
    """Material of the rock."""
    floor: str = "sand"
    """Material of the sea floor."""
    damage_energy_j: float | None = Field(default=None, gt=0.0, le=1e6)
    """Energy of an impact above which a robot is damaged and its episode ends as `damaged`: half
    the effective mass at the point (added mass included) times the closing speed squared. If left
    out, no impact ends an episode."""

    @field_validator("robot", "obstacle", "rock", "floor")
    @classmethod
    def _check_material(cls, name: str) -> str:
        find_material(name)
        return name

    def grip_friction(self) -> float:
        """Return Coulomb's coefficient of robots on obstacles."""
        robot, obstacle = find_material(self.robot), find_material(self.obstacle)
        return float(pair_friction(robot.friction, obstacle.friction))

    def spec(
        self, physics_dt_s: float, world: WorldConfig, grip: GripSpec | None = None
    ) -> ContactSpec:
        """Return the settings of the simulator.

        Args:
            physics_dt_s: physics step, s.
            world: of the scenario.
            grip: of the robots on a body that they carry; None where they carry nothing.
        """
        materials = [find_material(n) for n in (self.robot, self.obstacle, self.rock, self.floor)]
        friction = np.array([material.friction for material in materials])
        restitution = np.array([material.restitution for material in materials])
        zeta = damping_ratio(pair_restitution(restitution[:, None], restitution))
        return ContactSpec(
            friction=_to_table(pair_friction(friction[:, None], friction)),
            damping_ratio=_to_table(zeta),
            rate_radps=1.0 / (RATE_STEPS * physics_dt_s),
            damage_energy_j=self.damage_energy_j,
            grip=grip,
            axis_pieces=cut_axes(world),
        )


def _to_table(rows: ArrayLike) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in row) for row in np.asarray(rows))


def cut_axes(world: WorldConfig) -> tuple[int, ...]:
    """Return `ContactSpec.axis_pieces` of the explicit obstacles of a world.

    The nearest rock is found of a segment up to a cell long that reaches less than a cell from its
    middle, radius included. Pieces of long axes are even in number, so that what carries a pipe on
    either side of its centre touches different pieces.
    """
    resolved = resolve_world(world)
    cell_m, pieces = resolved.cell_m, []
    for item in resolved.obstacles.explicit:
        if not isinstance(item, CapsuleConfig) or _reach(item) < cell_m:
            pieces.append(1)
        elif not isinstance(item.motion, DriftMotion):
            pieces.append(0)
        else:
            within_m = 2.0 * (cell_m - item.radius_m)
            count = max(math.ceil(item.length_m / cell_m), int(item.length_m / within_m) + 1)
            pieces.append(count + count % 2)
    return tuple(pieces) if any(count != 1 for count in pieces) else ()


def _reach(item: CapsuleConfig) -> float:
    """Return the distance of the ends of a capsule from its centre, m."""
    return 0.5 * item.length_m + item.radius_m


def check_bodies(world: WorldConfig) -> None:
    """Refuse bodies too large to meet rock or the region's sides, and those that overlap at t = 0.

    Raises:
        ValueError: naming all of them.
    """
    resolved, faults = resolve_world(world), []
    explicit = resolved.obstacles.explicit
    if not explicit:
        return
    for i, item in enumerate(explicit):
        if isinstance(item, BoxConfig) or not isinstance(item.motion, DriftMotion):
            continue
        name = f"world.obstacles.explicit[{i}]"
        if item.radius_m >= resolved.cell_m:
            faults.append(
                f"{name}.radius_m = {item.radius_m:g}: a drifting {item.type} has to be smaller in "
                f"radius than world.cell_m = {resolved.cell_m:g}; take larger cells"
            )
        elif isinstance(item, CapsuleConfig) and _reach(item) >= resolved.cell_m:
            low = np.array(resolved.origin_m)
            high = low + resolved.cell_m * np.array(resolved.shape)
            position = np.array(item.position_m)
            room_m = min(np.min((position - low)[:2]), np.min(high - position))
            if room_m < _reach(item):
                faults.append(
                    f"{name}.position_m = {item.position_m}: a drifting capsule that reaches "
                    f"{_reach(item):g} m from its centre has to begin as far from the sides and "
                    f"the top of the region, and is {room_m:g} m from one; move or shorten it"
                )
    for overlap in find_overlaps(explicit_rows(explicit, 1000.0), resolved.floor_z_m):
        names = [f"world.obstacles.explicit[{overlap.first}]", "the sea floor"]
        if overlap.second is not None:
            names[1] = f"world.obstacles.explicit[{overlap.second}]"
        faults.append(f"{names[0]} and {names[1]} overlap by {overlap.depth_m:.3g} m; part them")
    if faults:
        raise ValueError("; ".join(faults))
