"""The table of a scenario file on contact between bodies, and between bodies and the ground."""

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
from angler_mjx.world.obstacles.config import CapsuleConfig
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

    def spec(self, physics_dt_s: float, grip: GripSpec | None = None) -> ContactSpec:
        """Return the settings of the simulator.

        Args:
            physics_dt_s: physics step, s.
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
        )


def _to_table(rows: ArrayLike) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in row) for row in np.asarray(rows))


def check_bodies(world: WorldConfig) -> None:
    """Refuse obstacles too long to be looked for among rock, and bodies that overlap at the start.

    Raises:
        ValueError: naming all of them.
    """
    resolved, faults = resolve_world(world), []
    explicit = resolved.obstacles.explicit
    if not explicit:
        return
    for i, item in enumerate(explicit):
        if isinstance(item, CapsuleConfig):
            reach_m = 0.5 * item.length_m + item.radius_m
            if reach_m >= resolved.cell_m:
                faults.append(
                    f"world.obstacles.explicit[{i}]: a capsule that reaches {reach_m:g} m from its "
                    f"centre is too long for world.cell_m = {resolved.cell_m:g}; take larger cells"
                )
    for overlap in find_overlaps(explicit_rows(explicit, 1000.0), resolved.floor_z_m):
        names = [f"world.obstacles.explicit[{overlap.first}]", "the sea floor"]
        if overlap.second is not None:
            names[1] = f"world.obstacles.explicit[{overlap.second}]"
        faults.append(f"{names[0]} and {names[1]} overlap by {overlap.depth_m:.3g} m; part them")
    if faults:
        raise ValueError("; ".join(faults))
