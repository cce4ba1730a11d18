"""The table of a scenario file on the robots of its fleet."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Annotated, ClassVar, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import FileModel, absolute_path
from angler_mjx.robot.sensing.config import SensorsConfig
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.abilities import compute_abilities
from angler_mjx.robot.vehicles.drive import Drive, require_flyable
from angler_mjx.robot.vehicles.rotor_config import RotorResponse
from angler_mjx.robot.vehicles.thrust_curves import build_thrust_tables
from angler_mjx.scenario import instrumented
from angler_mjx.scenario.randomise_table import RandomiseConfig
from angler_mjx.sim.fleet import Member, Variant

type Weight = Annotated[float, Field(gt=0, le=1e9)]


class FleetEntry(FileModel):
    """One or more equal robots."""

    renamed_keys: ClassVar[Mapping[str, str]] = {"fault_known": "fault_visible"}

    vehicle: str
    """Name of a shipped vehicle, or path of a vehicle file (.toml), relative to the folder of the
    scenario file; stored as an absolute path."""
    count: int = Field(default=1, ge=1, le=1024)
    """Number of robots."""
    parameter_set: str | None = None
    """Name of a parameter set of the vehicle; its default set if left out."""
    parameter_mix: dict[str, Weight] = Field(default_factory=dict)
    """Weights of several parameter sets, sampled for each robot of each world; instead of one
    set."""
    battery_v: float = Field(default=16.0, gt=0.0)
    """Battery voltage, within the voltages of the thruster file: 10 to 20 V for the T200."""
    cruise_speed_mps: float = Field(default=0.5, gt=0.0, le=3.0)
    """Max speed along a path; at most 60 % of the vehicle's terminal speed in surge."""
    thruster_health: dict[str, float] = Field(default_factory=dict)
    """Fraction of its thrust that each faulty thruster gives, 0 (dead) to 1 (sound), by its name in
    the vehicle file."""
    fault_visible: bool = True
    """Whether the allocation knows thruster_health; if not, it assumes sound thrusters."""
    rotor_response: RotorResponse | None = None
    """Rotor response, first or third order; that of the vehicle file if left out. The same for a
    whole fleet."""
    estimate: instrumented.Source = "truth"
    """State that the controllers use: the true state, the true state with noise, or the estimate of
    a navigation filter."""
    sensors: SensorsConfig | None = None
    """Instruments, and the noise of "noisy"; the defaults if left out."""

    @field_validator("vehicle")
    @classmethod
    def _resolve_vehicle(cls, name: str, info: ValidationInfo) -> str:
        """Return the vehicle with an absolute path; refuse a file with faults."""
        if name.endswith(".toml"):
            name = absolute_path(name, info)
        rotor = library.load_vehicle(name).rotor
        if rotor is not None:
            library.load_thruster(rotor.model)
        return name

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        faults = []
        if self.parameter_mix and self.parameter_set is not None:
            faults.append("give parameter_set or parameter_mix, not both")
        if self.estimate == "truth" and self.sensors is not None:
            faults.append(
                'sensors: not used with estimate = "truth"; set estimate = "noisy" or "ekf"'
            )
        config = library.load_vehicle(self.vehicle)
        for name in self._parameter_weights(config.default_set):
            if name not in config.parameter_sets:
                faults.append(
                    f"parameter set {format_value(name)} is not in vehicle {config.name!r}; "
                    f"there is {', '.join(sorted(config.parameter_sets))}"
                )
        checks: tuple[Callable[[], object], ...] = (
            lambda: config.find_health(self.thruster_health),
            lambda: config.find_response(self.rotor_response),
            self._require_flyable,
        )
        for check in checks if not faults else checks[:2]:
            try:
                check()
            except ConfigError as error:
                faults.append(str(error))
        if faults:
            raise ValueError("; ".join(faults))
        return self

    def _parameter_weights(self, default: str) -> dict[str, float]:
        return self.parameter_mix or {self.parameter_set or default: 1.0}

    def _require_flyable(self) -> None:
        config = library.load_vehicle(self.vehicle)
        for limits in self.drive_limits():
            require_flyable(config, limits)

    def drive_limits(self) -> list[Drive]:
        """Return the limits of the vehicle's motion, for each of its possible parameter sets.

        Raises:
            ConfigError: battery_v lies outside the thruster file.
        """
        config = library.load_vehicle(self.vehicle)
        try:
            thrust_n, _ = build_thrust_tables(config, self.battery_v)
        except ConfigError as error:
            raise ConfigError(f"battery_v: {error}") from error
        return [
            compute_abilities(config, config.find_set(name), thrust_n)
            for name in self._parameter_weights(config.default_set)
        ]

    def state_source(self) -> tuple[instrumented.Source, SensorsConfig]:
        """Return the source of the controllers' state, and the instruments."""
        return self.estimate, self.sensors or SensorsConfig()

    def build_member(self, number: int, randomise: RandomiseConfig) -> Member:
        """Return the robots of this entry in the form that the simulator takes.

        Args:
            number: index of the entry.
            randomise: variation of the robots about their files.
        """
        config = library.load_vehicle(self.vehicle)
        weights = self._parameter_weights(config.default_set)
        variants, probabilities = [], []
        for name, weight in weights.items():
            variant = Variant(
                vehicle=self.vehicle,
                parameter_set=name,
                battery_v=self.battery_v,
                thruster_health=tuple(self.thruster_health.items()),
                fault_known=self.fault_visible,
                rotor_response=self.rotor_response,
            )
            bank = [variant]
            if randomise.changes_vehicles:
                variations = randomise.sample_variations(
                    number, name, len(config.thrusters.layout), config.find_set(name).uncertainty
                )
                is_variation_visible = randomise.visible
                bank = [
                    replace(variant, variation=v, variation_known=is_variation_visible)
                    for v in variations
                ]
            variants += bank
            probabilities += [weight / len(bank)] * len(bank)
        return Member(
            variants=tuple(variants),
            weights=tuple(probabilities),
            cruise_speed_mps=self.cruise_speed_mps,
        )

    def parameter_set_names(self) -> list[str]:
        """Return the parameter sets that its robots can have."""
        return list(self._parameter_weights(library.load_vehicle(self.vehicle).default_set))
