"""What a scenario file says about the robots of its fleet."""

from typing import Any, Self

from pydantic import Field, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel
from angler_mjx.scenario import instrumented
from angler_mjx.sensing.config import SensorsConfig
from angler_mjx.sim.fleet import Member, Variant
from angler_mjx.vehicles import library
from angler_mjx.vehicles.rotor_config import RotorResponse


class FleetEntry(FileModel):
    """One or more robots of a kind."""

    vehicle: str
    """Name of a shipped vehicle, or path of a vehicle file."""
    count: int = Field(default=1, ge=1, le=1024)
    parameter_set: str | None = None
    """Name of one set of the vehicle; its default set if left out."""
    parameter_mix: dict[str, float] = Field(default_factory=dict)
    """Weights of several sets, drawn anew for each robot of each world; instead of one set."""
    battery_v: float = Field(default=16.0, ge=10.0, le=20.0)
    cruise_speed_mps: float = Field(default=0.5, gt=0.0, le=3.0)
    thruster_health: dict[str, float] = Field(default_factory=dict)
    """Share of its thrust that each faulty thruster gives, 0 (dead) to 1 (sound), by its name in
    the vehicle file."""
    fault_known: bool = True
    """Whether the allocation knows thruster_health; if not, it takes all thrusters for sound."""
    rotor_response: RotorResponse | None = None
    """First or third order; what the vehicle file says if left out. The same for a whole fleet."""
    estimate: instrumented.Source = "truth"
    """What the controllers are told: the true state, that with noise, or a navigation filter's."""
    sensors: SensorsConfig | None = None
    """Instruments, and the noise of "noisy"; the defaults if left out."""

    @model_validator(mode="after")
    def _one_of_two(self) -> Self:
        if self.parameter_mix and self.parameter_set is not None:
            raise ValueError("give parameter_set or parameter_mix, not both")
        if self.estimate == "truth" and self.sensors is not None:
            raise ValueError(
                'sensors: not used with estimate = "truth"; set estimate = "noisy" or "ekf"'
            )
        bad = {name: weight for name, weight in self.parameter_mix.items() if weight <= 0}
        if bad:
            raise ValueError(f"parameter_mix: weights must be positive: {bad}")
        config = _load_vehicle(self.vehicle)
        try:
            config.find_health(self.thruster_health)
            config.find_response(self.rotor_response)
        except ConfigError as error:
            raise ValueError(str(error)) from error
        for name in self._weights(config.default_set):
            if name not in config.parameter_sets:
                raise ValueError(
                    f"parameter set {name!r} is not in vehicle {self.vehicle!r}; "
                    f"there is {', '.join(sorted(config.parameter_sets))}"
                )
        return self

    def _weights(self, default: str) -> dict[str, float]:
        return self.parameter_mix or {self.parameter_set or default: 1.0}

    def told(self) -> tuple[instrumented.Source, SensorsConfig]:
        """What the controllers are told, and the instruments."""
        return self.estimate, self.sensors or SensorsConfig()

    def member(self) -> Member:
        """The robots of this entry as the simulator takes them."""
        weights = self._weights(library.load(self.vehicle).default_set)
        return Member(
            variants=tuple(
                Variant(
                    vehicle=self.vehicle,
                    parameter_set=name,
                    battery_v=self.battery_v,
                    thruster_health=tuple(self.thruster_health.items()),
                    fault_known=self.fault_known,
                    rotor_response=self.rotor_response,
                )
                for name in weights
            ),
            weights=tuple(weights.values()),
            cruise_speed_mps=self.cruise_speed_mps,
        )


def _load_vehicle(name: str) -> Any:
    try:
        return library.load(name)
    except ConfigError as error:
        raise ValueError(str(error)) from error
