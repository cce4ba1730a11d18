"""The table of a scenario file that says how robots, water and instruments differ from the files.

Vehicles are drawn on the host, once a run: a bank of variants of each parameter set, from which
every robot of every world is one, as it is with the sets of a ``parameter_mix``. So what programs
hold of a fleet stays as small as the bank. Current and noise are numbers of each world.
"""

import itertools
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.variation import Variation, heave


def _rises(span: tuple[float, float]) -> tuple[float, float]:
    low, high = span
    if low > high:
        raise ValueError(f"[{low:g}, {high:g}]: the lower end comes first")
    return span


type Factor = Annotated[float, Field(ge=0.01, le=100.0)]
type Factors = Annotated[tuple[Factor, Factor], AfterValidator(_rises)]
type Share = Annotated[float, Field(ge=0.0, le=1.0)]
type Shares = Annotated[tuple[Share, Share], AfterValidator(_rises)]
type Gain = Annotated[float, Field(ge=0.01, le=2.0)]
type Gains = Annotated[tuple[Gain, Gain], AfterValidator(_rises)]
type Volt = Annotated[float, Field(gt=0.0, le=1000.0)]
type Volts = Annotated[tuple[Volt, Volt], AfterValidator(_rises)]
type FromNothing = Annotated[float, Field(ge=0.0, le=100.0)]
type FromNothings = Annotated[tuple[FromNothing, FromNothing], AfterValidator(_rises)]

AS_SAID = (1.0, 1.0)
SPARE = 0.5
"""Share of the thrust in heave that a vehicle may need to hold its depth: the rest is to move."""


class RandomiseConfig(FileModel):
    """Ranges, low and high, drawn from evenly; factors of what the files say, [1, 1] for as said.

    See `docs/randomise.md`.
    """

    variants: int = Field(default=16, ge=1, le=1024)
    """Drawn of each parameter set of each entry of the fleet; each robot of each world is one."""
    seed: int = Field(default=0, ge=0, lt=2**31)
    """Of the variants; the same for all seeds of the run."""
    mass: Factors = AS_SAID
    """Of the dry mass; the inertia goes with it."""
    buoyancy: Factors = AS_SAID
    """Of the displaced volume."""
    damping: Factors = AS_SAID
    """Of linear and quadratic damping, drawn for each axis."""
    added_mass: Factors = AS_SAID
    """Drawn for each axis; off the diagonal the root of the product of two."""
    thrust: Gains = AS_SAID
    """Of the thrust of each thruster by itself, at the power of the table."""
    fault_probability: float = Field(default=0.0, ge=0.0, le=1.0)
    """Of each thruster to be faulty."""
    fault_health: Shares = (0.0, 0.0)
    """Share of its thrust that a faulty one gives: 0 is dead."""
    battery_v: Volts | None = None
    """Instead of the robots' own; within the voltages of the thruster file."""
    current: FromNothings = AS_SAID
    """Of the speed of the current, drawn for each world; 0 is still water."""
    sensor_noise: FromNothings = AS_SAID
    """Of the noise of all instruments, drawn for each robot of each world; filters go on believing
    what the file says."""
    known: bool = False
    """Whether controllers and planners are told what was drawn of the vehicle; if not, they take it
    for what its files say."""

    @model_validator(mode="after")
    def _faults_can_be(self) -> "RandomiseConfig":
        if self.fault_probability == 0.0 and self.fault_health != (0.0, 0.0):
            raise ValueError("fault_health: no thruster is faulty; give fault_probability")
        return self

    @property
    def of_vehicles(self) -> bool:
        """Whether vehicles differ from their files."""
        spans = (self.mass, self.buoyancy, self.damping, self.added_mass, self.thrust)
        return (
            any(span != AS_SAID for span in spans)
            or self.fault_probability > 0.0
            or self.battery_v is not None
        )

    @property
    def of_worlds(self) -> bool:
        """Whether worlds have numbers of their own."""
        return self.current != AS_SAID or self.sensor_noise != AS_SAID

    def bank(self, entry: int, parameter_set: str, thrusters: int) -> tuple[Variation, ...]:
        """The variants of one parameter set of an entry of the fleet.

        Every quantity takes each n-th of its range once (a Latin hypercube: McKay, Beckman and
        Conover 1979), so few variants cover it too. Numbers are bits of Philox, which NumPy keeps
        the same for all time; a set's draws hang on nothing but seed, entry and set.
        """
        words = np.frombuffer(f"{entry}/{parameter_set}".encode(), np.uint8)
        bits = np.random.Philox(np.random.SeedSequence([self.seed, *words.tolist()]))
        n = self.variants

        def shares() -> np.ndarray:
            raw = bits.random_raw(2 * n).astype(np.uint64)
            inside = (raw[:n] >> np.uint64(11)).astype(float) * 2.0**-53
            return (np.argsort(raw[n:], kind="stable") + inside) / n

        def drawn(span: tuple[float, float], columns: int) -> np.ndarray:
            low, high = span
            return low + (high - low) * np.stack([shares() for _ in range(columns)], axis=1)

        mass, buoyancy = drawn(self.mass, 1), drawn(self.buoyancy, 1)
        damping, added = drawn(self.damping, 6), drawn(self.added_mass, 6)
        gain, faulty = drawn(self.thrust, thrusters), drawn((0.0, 1.0), thrusters)
        health, volts = drawn(self.fault_health, thrusters), drawn(self.battery_v or AS_SAID, 1)
        thrust = np.where(faulty < self.fault_probability, health * gain, gain)
        return tuple(
            Variation(
                number=i,
                mass=float(mass[i, 0]),
                buoyancy=float(buoyancy[i, 0]),
                damping=_six(damping[i]),
                added_mass=_six(added[i]),
                thrust=tuple(map(float, thrust[i])),
                battery_v=None if self.battery_v is None else float(volts[i, 0]),
            )
            for i in range(n)
        )

    def check(
        self,
        config: VehicleConfig,
        parameter_sets: Sequence[str],
        battery_v: float,
        density_kgpm3: float,
    ) -> None:
        """Refuse ranges with vehicles in them that cannot hold their depth, faults aside.

        A vehicle that cannot by its own file is not looked at: the ranges are not to blame.

        Args:
            config: vehicle file.
            parameter_sets: that robots can have.
            battery_v: of the robots.
            density_kgpm3: of the water.

        Raises:
            ConfigError: naming the ranges.
        """
        volts: Sequence[float | None] = self.battery_v or (None,)
        corners = list(itertools.product(self.mass, self.buoyancy, volts))
        for name in parameter_sets:
            lift_n, force_n = heave(config, name, Variation(), battery_v, density_kgpm3)
            able = abs(lift_n) <= SPARE * force_n
            for mass, buoyancy, volt in corners:
                least = Variation(
                    mass=mass, buoyancy=buoyancy, battery_v=volt, thrust=(self.thrust[0],)
                )
                try:
                    lift_n, force_n = heave(config, name, least, battery_v, density_kgpm3)
                except ConfigError as error:
                    raise ConfigError(f"randomise.battery_v: {error}") from error
                if able and abs(lift_n) > SPARE * force_n:
                    raise ConfigError(
                        f"[randomise]: vehicle {config.name!r}, parameter set {name!r}, with "
                        f"{mass:g} times its mass and {buoyancy:g} times its displaced volume "
                        f"{'rises' if lift_n > 0 else 'sinks'} with {abs(lift_n):.1f} N, and its "
                        f"thrusters give {force_n:.1f} N in heave at {volt or battery_v:g} V; half "
                        "of that may go into holding depth: narrow the ranges"
                    )


def _six(row: np.ndarray) -> tuple[float, float, float, float, float, float]:
    a, b, c, d, e, f = map(float, row)
    return a, b, c, d, e, f
