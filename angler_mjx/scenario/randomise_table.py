"""The table of a scenario file on variations of robots, water and instruments about the files.

Vehicles are sampled on the host, once a run: a bank of variants of each parameter set, of which
each robot of each world gets one, as with the sets of a ``parameter_mix``. The fleet data in device
programs therefore stay as small as the bank. Current and noise are numbers of each world.
"""

import itertools
from collections.abc import Mapping, Sequence
from statistics import NormalDist
from typing import Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.uncertainty import Uncertainty
from angler_mjx.robot.vehicles.variation import Variation, heave_forces


def _check_ascending(span: tuple[float, float]) -> tuple[float, float]:
    low, high = span
    if low > high:
        raise ValueError(f"[{low:g}, {high:g}]: the lower end comes first")
    return span


type Factor = Annotated[float, Field(ge=0.01, le=100.0)]
type FactorRange = Annotated[tuple[Factor, Factor], AfterValidator(_check_ascending)]
type Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
type FractionRange = Annotated[tuple[Fraction, Fraction], AfterValidator(_check_ascending)]
type Gain = Annotated[float, Field(ge=0.01, le=2.0)]
type GainRange = Annotated[tuple[Gain, Gain], AfterValidator(_check_ascending)]
type Voltage = Annotated[float, Field(gt=0.0, le=1000.0)]
type VoltageRange = Annotated[tuple[Voltage, Voltage], AfterValidator(_check_ascending)]
type Scale = Annotated[float, Field(ge=0.0, le=100.0)]
type ScaleRange = Annotated[tuple[Scale, Scale], AfterValidator(_check_ascending)]

UNCHANGED = (1.0, 1.0)
MAX_HEAVE_FRACTION = 0.5
"""Max fraction of the thrust in heave to hold the depth; the rest is for motion."""
_MIN_TAIL = 1e-5
"""Least probability of the tails of sampled normal numbers: 4.3 standard deviations."""


class RandomiseConfig(FileModel):
    """Uniform ranges [low, high] of factors on the values of the files; [1, 1] for no change.

    See `docs/how_to/randomise.md`.
    """

    renamed_keys: ClassVar[Mapping[str, str]] = {"known": "visible"}

    variants: int = Field(default=16, ge=1, le=1024)
    """Number of variants of each parameter set of each fleet entry; each robot of each world is one
    of them."""
    seed: int = Field(default=0, ge=0, lt=2**31)
    """Seed of the variants; the same for all seeds of the run."""
    mass: FactorRange = UNCHANGED
    """Factor on the dry mass; the inertia scales with it."""
    buoyancy: FactorRange = UNCHANGED
    """Factor on the displaced volume."""
    damping: FactorRange = UNCHANGED
    """Factors on linear and quadratic damping, sampled for each axis."""
    added_mass: FactorRange = UNCHANGED
    """Factors on the added mass, sampled for each axis; off the diagonal the root of the product of
    two."""
    thrust: GainRange = UNCHANGED
    """Factor on the thrust of each single thruster, at the power of the table."""
    fault_probability: float = Field(default=0.0, ge=0.0, le=1.0)
    """Probability that a thruster is faulty."""
    fault_health: FractionRange = (0.0, 0.0)
    """Fraction of its thrust that a faulty thruster gives: 0 is dead."""
    battery_v: VoltageRange | None = None
    """Battery voltage instead of the robots' own; within the voltages of the thruster file."""
    current: ScaleRange = UNCHANGED
    """Factor on the speed of the current, sampled for each world; 0 is still water."""
    sensor_noise: ScaleRange = UNCHANGED
    """Factor on the noise of all instruments, sampled for each robot of each world; filters keep
    the values of the file."""
    uncertainty: bool = False
    """Whether parameter sets are sampled within the uncertainty that their vehicle file states;
    factors apply to the sampled set."""
    visible: bool = False
    """Whether controllers and planners know the sampled vehicle; if not, they assume that of its
    files."""

    @model_validator(mode="after")
    def _check_faults(self) -> "RandomiseConfig":
        if self.fault_probability == 0.0 and self.fault_health != (0.0, 0.0):
            raise ValueError("fault_health: no thruster is faulty; give fault_probability")
        return self

    @property
    def changes_vehicles(self) -> bool:
        """Return whether vehicles differ from their files."""
        spans = (self.mass, self.buoyancy, self.damping, self.added_mass, self.thrust)
        return (
            any(span != UNCHANGED for span in spans)
            or self.fault_probability > 0.0
            or self.battery_v is not None
            or self.uncertainty
        )

    @property
    def changes_worlds(self) -> bool:
        """Return whether worlds have numbers of their own."""
        return self.current != UNCHANGED or self.sensor_noise != UNCHANGED

    def sample_variations(
        self,
        entry: int,
        parameter_set: str,
        thrusters: int,
        uncertainty: Uncertainty | None = None,
    ) -> tuple[Variation, ...]:
        """Sample the variants of one parameter set of an entry of the fleet.

        ``uncertainty`` is that of the parameter set; unused without the key `uncertainty`.

        Every quantity takes each n-th of its range once (a Latin hypercube: McKay, Beckman and
        Conover 1979), so few variants cover it too. Numbers are bits of Philox, which NumPy keeps
        stable; the samples of a set depend only on seed, entry and set.
        """
        key_bytes = np.frombuffer(f"{entry}/{parameter_set}".encode(), np.uint8)
        bit_generator = np.random.Philox(np.random.SeedSequence([self.seed, *key_bytes.tolist()]))
        n = self.variants

        def stratified_fractions() -> np.ndarray:
            raw_bits = bit_generator.random_raw(2 * n).astype(np.uint64)
            offset = (raw_bits[:n] >> np.uint64(11)).astype(float) * 2.0**-53
            return (np.argsort(raw_bits[n:], kind="stable") + offset) / n

        def sample(span: tuple[float, float], columns: int) -> np.ndarray:
            low, high = span
            return low + (high - low) * np.stack(
                [stratified_fractions() for _ in range(columns)], axis=1
            )

        mass, buoyancy = sample(self.mass, 1), sample(self.buoyancy, 1)
        damping, added_mass = sample(self.damping, 6), sample(self.added_mass, 6)
        healthy_gain, faulty = sample(self.thrust, thrusters), sample((0.0, 1.0), thrusters)
        health, battery_v = (
            sample(self.fault_health, thrusters),
            sample(self.battery_v or UNCHANGED, 1),
        )
        deviations = np.zeros((n, 0))
        if self.uncertainty and uncertainty is not None:
            root = uncertainty.root
            deviations = _normal_quantiles(sample((0.0, 1.0), len(root))) @ root.T
        thrust = np.where(faulty < self.fault_probability, health * healthy_gain, healthy_gain)
        return tuple(
            Variation(
                number=i,
                mass=float(mass[i, 0]),
                buoyancy=float(buoyancy[i, 0]),
                damping=_six_floats(damping[i]),
                added_mass=_six_floats(added_mass[i]),
                thrust=tuple(map(float, thrust[i])),
                battery_v=None if self.battery_v is None else float(battery_v[i, 0]),
                deviations=tuple(map(float, deviations[i])),
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
        """Refuse ranges with vehicles that cannot hold their depth, faults aside.

        Also refuse sets without an uncertainty that is asked for.

        A vehicle that cannot hold its depth by its own file is not checked.

        Args:
            config: vehicle file.
            parameter_sets: that robots can have.
            battery_v: of the robots.
            density_kgpm3: of the water.

        Raises:
            ConfigError: naming the ranges.
        """
        volts: Sequence[float | None] = self.battery_v or (None,)
        for name in parameter_sets:
            volumes = self._buoyancy_range(config, name)
            corners = list(itertools.product(self.mass, volumes, volts))
            lift_n, force_n = heave_forces(config, name, Variation(), battery_v, density_kgpm3)
            can_hold = abs(lift_n) <= MAX_HEAVE_FRACTION * force_n
            for mass, buoyancy, battery_or_none in corners:
                weakest = Variation(
                    mass=mass,
                    buoyancy=buoyancy,
                    battery_v=battery_or_none,
                    thrust=(self.thrust[0],),
                )
                try:
                    lift_n, force_n = heave_forces(config, name, weakest, battery_v, density_kgpm3)
                except ConfigError as error:
                    raise ConfigError(f"randomise.battery_v: {error}") from error
                if can_hold and abs(lift_n) > MAX_HEAVE_FRACTION * force_n:
                    raise ConfigError(
                        f"[randomise]: vehicle {config.name!r}, parameter set {name!r}, with "
                        f"{mass:g} times its mass and {buoyancy:g} times its displaced volume "
                        f"{'rises' if lift_n > 0 else 'sinks'} with {abs(lift_n):.1f} N, and its "
                        f"thrusters give {force_n:.1f} N in heave at "
                        f"{battery_or_none or battery_v:g} V; half "
                        "of that may go into holding depth: narrow the ranges"
                    )

    def _buoyancy_range(self, config: VehicleConfig, name: str) -> tuple[float, float]:
        """Return the factors [2] of the displaced volume, with three deviations if uncertain.

        Raises:
            ConfigError: the set has no uncertainty, which is asked for.
        """
        if not self.uncertainty:
            return self.buoyancy
        chosen = config.find_set(name)
        if chosen.uncertainty is None:
            stated = [key for key in config.parameter_sets if key not in config.published_sets]
            raise ConfigError(
                f"randomise.uncertainty: parameter set {name!r} of vehicle {config.name!r} has no "
                f"table [uncertainty]; sets with one: {', '.join(stated) or 'none'}"
            )
        spread = 3.0 * (chosen.uncertainty.volume_m3 or 0.0) / chosen.buoyancy.volume_m3
        low, high = self.buoyancy
        return low * (1.0 - spread), high * (1.0 + spread)


def _normal_quantiles(fractions: np.ndarray) -> np.ndarray:
    """Return the standard normal numbers [n, k] below which fractions [n, k] lie."""
    inverse = np.vectorize(NormalDist().inv_cdf, otypes=[float])
    quantiles: np.ndarray = inverse(np.clip(fractions, _MIN_TAIL, 1.0 - _MIN_TAIL))
    return quantiles


def _six_floats(row: np.ndarray) -> tuple[float, float, float, float, float, float]:
    a, b, c, d, e, f = map(float, row)
    return a, b, c, d, e, f
