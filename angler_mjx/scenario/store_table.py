"""The table of a scenario file on the resolution of stored trajectories."""

from pydantic import Field, field_validator

from angler_mjx.files import FileModel
from angler_mjx.sim.record import RecordOption


class StoreConfig(FileModel):
    """Stored arrays of trajectories, and their resolution: exact, in float32, or in steps.

    Steps take a sixth of the space; see `docs/how_to/datasets.md`. Plans, joints and the last
    states are always exact.
    """

    also: tuple[RecordOption, ...] = ()
    """Arrays beside those of all runs: the thrusters' `wrench`; `clearance`, distances to the
    nearest obstacles; `acoustics`, fraction of packets received and age of information; `grips`,
    who holds the body of a task `carry`, with the force and moment of each grip."""
    position_mm: float | None = Field(default=None, ge=0.01, le=1000.0)
    """Step of positions and distances; exact if left out, as are the following."""
    velocity_mmps: float | None = Field(default=None, ge=0.01, le=1000.0)
    """Step of velocities, also of the water, and in mrad/s of angular velocities."""
    attitude_mrad: float | None = Field(default=None, ge=0.01, le=100.0)
    """Step of angles; of the components of quaternions half of it, in thousandths."""
    force_mn: float | None = Field(default=None, ge=0.01, le=1e5)
    """Step of forces, and in mN m of moments."""
    pwm_us: float | None = Field(default=None, ge=0.01, le=100.0)
    """Step of the pulse widths of the thrusters."""

    @field_validator("also")
    @classmethod
    def _check_unique(cls, also: tuple[RecordOption, ...]) -> tuple[RecordOption, ...]:
        repeated = sorted({name for name in also if also.count(name) > 1})
        if repeated:
            raise ValueError(f"{repeated[0]} is named twice; name it once")
        return also

    def step(self, unit: str, dims: tuple[str, ...]) -> float | None:
        """Return the step of an array in its own unit; None where it is stored exactly.

        Args:
            unit: as in the arrays of a run.
            dims: names of its dimensions.
        """
        if "wxyz" in dims:
            return self.attitude_mrad and 0.5e-3 * self.attitude_mrad
        steps = {
            "m": self.position_mm,
            "m/s": self.velocity_mmps,
            "m/s, rad/s": self.velocity_mmps,
            "rad": self.attitude_mrad,
            "N, N m": self.force_mn,
        }
        if unit == "us":
            return self.pwm_us
        step = steps.get(unit)
        return step and 1e-3 * step
