"""``angler vehicle``: vehicles, their performance, their MuJoCo models, and import of others."""

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from angler_mjx.robot.vehicles.properties import VehicleProperties


def list_vehicles() -> None:
    """List the shipped vehicles and their parameter sets."""
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import build_text_table as text_table
    from angler_mjx.robot.vehicles.library import list_vehicles, load_vehicle

    table = text_table("vehicle", "thrusters", "parameter sets (default first)", "description")
    for name in list_vehicles():
        config = load_vehicle(name)
        others = [key for key in config.parameter_sets if key != config.default_set]
        table.add_row(
            name,
            str(len(config.thrusters.layout)),
            ", ".join([config.default_set, *others]),
            config.description,
        )
    Console().print(table)


def show_vehicle(
    name: Annotated[str, tyro.conf.Positional],
    parameter_set: Annotated[str | None, tyro.conf.arg(name="set")] = None,
    voltage_v: Annotated[float, tyro.conf.arg(name="voltage")] = 16.0,
) -> None:
    """Show mass, buoyancy, wrench matrix, terminal speeds and natural periods of a vehicle.

    Args:
        name: Name of a shipped vehicle, or path of a vehicle file.
        parameter_set: Parameter set; the vehicle's default if left out.
        voltage_v: Battery voltage, V.
    """
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table

    from angler_mjx.robot.vehicles.library import load_vehicle
    from angler_mjx.robot.vehicles.properties import describe_vehicle

    config = load_vehicle(name)
    properties = describe_vehicle(config, parameter_set, voltage_v)
    console = Console()
    numbers = Table(
        title=f"{config.name}, set {properties.parameter_set}, {voltage_v:g} V, still fresh water",
        show_header=False,
    )
    for label, value in _format_properties(properties):
        numbers.add_row(label, value)
    for fin in config.fins.layout if config.fins else ():
        numbers.add_row(
            f"fin {fin.name}",
            f"{1e4 * fin.area_m2:.3g} cm2, lift slope {fin.lift_slope:.3g} 1/rad, up to "
            f"{math.degrees(fin.limit_rad):.3g} degrees",
        )
    for tank in config.tanks:
        numbers.add_row(
            f"tank {tank.name}",
            f"{1e3 * tank.limit_m3:.3g} l to either side, {1e3 * tank.rate_m3ps:.3g} l/s",
        )
    for mass in config.masses:
        numbers.add_row(
            f"moving mass {mass.name}",
            f"{mass.mass_kg:.3g} kg, {1e3 * mass.limit_m:.3g} mm to either side, "
            f"{1e3 * mass.rate_mps:.3g} mm/s",
        )
    console.print(numbers)
    if not config.thrusters.layout:
        return
    wrench = Table(
        title="Force (N) and moment (N m) at the centre of mass per newton of each thruster; "
        "x forward, y left, z up",
        box=SIMPLE,  # eight thrusters must fit 80 columns
        padding=(0, 1, 0, 0),
    )
    wrench.add_column("")
    for thruster in config.thrusters.layout:
        wrench.add_column(thruster.name.removeprefix("thruster_"), justify="right")
    for label, row in zip(_WRENCH_ROWS, properties.wrench_matrix, strict=True):
        wrench.add_row(label, *(f"{entry + 0.0:.4f}" for entry in row))
    console.print(wrench)


def check_vehicle(
    name: Annotated[str, tyro.conf.Positional],
    parameter_set: Annotated[str | None, tyro.conf.arg(name="set")] = None,
    voltage_v: Annotated[float, tyro.conf.arg(name="voltage")] = 16.0,
    approach: float = 0.5,
    steer: float = 0.2,
    level: bool = False,
    density: float = 1000.0,
    only: tuple[str, ...] = (),
    out: Path | None = None,
) -> None:
    """Do sea trials of a vehicle with open-loop commands: turning, zig-zag, spiral, stops, decay.

    Args:
        name: Name of a shipped vehicle, or path of a vehicle file.
        parameter_set: Parameter set; the vehicle's default if left out.
        voltage_v: Battery voltage, V.
        approach: Surge thrust of the approach, as a fraction of the greatest.
        steer: Steering of circle, zig-zag and spiral, as a fraction of the greatest.
        level: Hold roll and pitch, as a controller would.
        density: Density of the water, kg/m^3.
        only: Beginnings of the names of trials, as in turning zig-zag; all if left out.
        out: Folder to make, for table.csv and figure.png.
    """
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import build_text_table as text_table
    from angler_mjx.errors import ConfigError
    from angler_mjx.report.plotting import style
    from angler_mjx.robot.vehicles.library import load_vehicle
    from angler_mjx.studies.sea_trials import report
    from angler_mjx.studies.sea_trials.check_vehicle import TrialSettings
    from angler_mjx.studies.sea_trials.check_vehicle import check_vehicle as do_trials

    settings = TrialSettings(approach=approach, steer=steer, density_kgpm3=density, level=level)
    config = load_vehicle(name)
    if out is not None and out.exists():
        raise ConfigError(f"--out {out}: exists; remove it or choose another name")
    check = do_trials(
        config, parameter_set=parameter_set, voltage_v=voltage_v, settings=settings, only=only
    )
    if out is not None:
        try:
            out.mkdir(parents=True)
        except OSError as error:
            raise ConfigError(f"--out {out}: cannot be made ({error.strerror})") from error
        report.write_table(check, out / report.TABLE)
        style.save_figure(report.plot_check(check), out / report.FIGURE)
    table = text_table("trial", "quantity", "value", "note")
    last = ""
    for trial, *row in report.list_rows(check):
        table.add_row("" if trial == last else trial, *row)
        last = trial
    Console().print(table)
    if out is not None:
        print(out)


def export_mjcf(
    name: Annotated[str, tyro.conf.Positional],
    out: Annotated[Path, tyro.conf.Positional],
    parameter_set: Annotated[str | None, tyro.conf.arg(name="set")] = None,
) -> None:
    """Write the MuJoCo model (MJCF) of a vehicle; any MuJoCo viewer opens it.

    Args:
        name: Name of a shipped vehicle, or path of a vehicle file.
        out: File to write; must not exist.
        parameter_set: Parameter set; the vehicle's default if left out.
    """
    from angler_mjx.robot.vehicles.library import load_vehicle
    from angler_mjx.robot.vehicles.mjcf import to_xml

    _write_new(out, to_xml(load_vehicle(name), parameter_set))
    print(out)


def import_vehicle(
    file: Annotated[Path, tyro.conf.Positional],
    thruster: str | None = None,
    density: float | None = None,
    out: Path | None = None,
    packages: tuple[Path, ...] = (),
    xacro_args: tuple[str, ...] = (),
    yaml: tuple[Path, ...] = (),
) -> None:
    """Import a vehicle from URDF, xacro, SDF or MJCF; list what was dropped, assumed or converted.

    Args:
        file: File of the vehicle.
        thruster: Name of a shipped thruster, or path of a thruster file.
        density: Density of the water, kg/m^3; that of the file, or 1000, if left out.
        out: Vehicle file to write; must not exist. NAME.toml here if left out.
        packages: Folders in which packages that the file names are looked for.
        xacro_args: Arguments of a xacro file, as NAME:=VALUE.
        yaml: Files of UUV Simulator's thruster manager, compared with the thrusters.
    """
    from angler_mjx.errors import ConfigError, format_value
    from angler_mjx.robot.importing.import_vehicle import import_vehicle

    if thruster is None:
        raise ConfigError(
            f"{file}: files of other simulators do not state thrust and power by PWM; give "
            "--thruster t200, or --thruster FILE.toml"
        )
    arguments = {}
    for text in xacro_args:
        name, sign, value = text.partition(":=")
        if not sign:
            raise ConfigError(f"--xacro-args {format_value(text)}: write NAME:=VALUE")
        arguments[name] = value
    model = None
    if thruster.endswith(".toml"):
        model = os.path.relpath(thruster, Path() if out is None else out.parent)
    result = import_vehicle(
        file,
        thruster,
        thruster_model=model,
        density=density,
        packages=packages,
        arguments=arguments,
        yaml=yaml,
    )
    target = Path(f"{result.name}.toml") if out is None else out
    _write_new(target, result.text)
    for note in result.notes:
        print(note)
    trim = result.trim
    net_kg = trim.density_kgpm3 * trim.volume_m3 - trim.mass_kg
    print(
        f"mass {trim.mass_kg:.4g} kg, net buoyancy {net_kg:+.4g} kg in water of "
        f"{trim.density_kgpm3:g} kg/m^3"
    )
    print(target)


def _write_new(out: Path, text: str) -> None:
    """Write a file that must not exist.

    Raises:
        ConfigError: it exists, or cannot be written.
    """
    from angler_mjx.errors import ConfigError

    try:
        file = out.open("x", encoding="utf-8")
    except FileExistsError as error:
        raise ConfigError(f"{out}: exists; remove it or choose another name") from error
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written ({error.strerror})") from error
    try:
        with file:
            file.write(text)
    except OSError as error:
        out.unlink()
        raise ConfigError(f"{out}: cannot be written ({error.strerror})") from error


_WRENCH_ROWS = ("x", "y", "z", "roll", "pitch", "yaw")


def _format_properties(properties: "VehicleProperties") -> list[tuple[str, str]]:
    has_thrust = properties.wrench_matrix.shape[1] > 0
    by = "at full thrust" if has_thrust else "gliding by a full tank"
    speeds = zip(
        ("surge", "sway", "heave") if has_thrust else ("over ground", "sway", "in depth"),
        properties.terminal_speed_mps,
        properties.speed_time_constant_s,
        strict=True,
    )
    return [
        ("mass", f"{properties.mass_kg:.3f} kg"),
        ("weight", f"{properties.weight_n:.2f} N"),
        ("buoyancy", f"{properties.buoyancy_n:.2f} N"),
        ("net (up is positive)", f"{properties.buoyancy_n - properties.weight_n:+.2f} N"),
        *(
            (f"{axis} {by if speed > 0 else 'at full thrust'}", _format_speed(speed, lag))
            for axis, speed, lag in speeds
        ),
        ("natural roll period", _format_period(properties.roll_period_s)),
        ("natural pitch period", _format_period(properties.pitch_period_s)),
        ("trim at rest", _format_trim(properties.trim_rad)),
        *_format_lag(properties.rotor_time_constant_s),
        *_format_gain(properties.damping_gain_w),
    ]


def _format_lag(seconds: float | None) -> list[tuple[str, str]]:
    """Return the row on the lag of rotors; none of a vehicle without them."""
    return [] if seconds is None else [("rotor time constant", f"{seconds:g} s")]


def _format_gain(power_w: float | None) -> list[tuple[str, str]]:
    """Return the row on damping between axes; none of diagonal damping."""
    if power_w is None:
        return []
    if power_w <= 0:
        return [("damping between axes", "takes energy at all velocities ahead that were tried")]
    text = f"gives up to {power_w:.3g} W at 1 m/s and rad/s: still water drives the vehicle"
    return [("damping between axes", text)]


def _format_speed(speed: float, lag: float) -> str:
    return f"{speed:.2f} m/s, time constant {lag:.2f} s" if speed > 0 else "none by itself"


def _format_trim(trim_rad: tuple[float, float] | None) -> str:
    if trim_rad is None:
        return "none: nothing rights it"
    roll, pitch = (round(math.degrees(angle), 1) + 0.0 for angle in trim_rad)
    return f"roll {roll:.1f}, pitch {pitch:.1f} degrees"


def _format_period(seconds: float | None) -> str:
    return "none: nothing rights it" if seconds is None else f"{seconds:.2f} s"
