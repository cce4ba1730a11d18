"""Import of a foreign vehicle file: which reader, and the text and notes it leads to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.files import parse_model
from angler_mjx.robot.importing import sdf, urdf, xacro
from angler_mjx.robot.importing.build_vehicle import Trim, build_vehicle
from angler_mjx.robot.importing.foreign_vehicle import ForeignVehicle
from angler_mjx.robot.importing.notes import Note, Notes
from angler_mjx.robot.importing.packages import Packages, open_packages
from angler_mjx.robot.importing.toml_text import format_tables
from angler_mjx.robot.importing.uuv_yaml import compare_yaml
from angler_mjx.robot.importing.xml_tree import note_unread, read_xml
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.library import load_thruster


@dataclass(frozen=True, kw_only=True)
class ImportedVehicle:
    """Vehicle file, and how it differs from the file that it was imported from."""

    name: str
    text: str
    """TOML text of the vehicle file, with the notes as comments."""
    notes: tuple[Note, ...]
    trim: Trim


def import_vehicle(
    path: Path,
    thruster: str,
    *,
    thruster_model: str | None = None,
    density: float | None = None,
    packages: Sequence[Path] = (),
    arguments: Mapping[str, str] | None = None,
    yaml: Sequence[Path] = (),
) -> ImportedVehicle:
    """Import a vehicle from URDF, xacro, SDF or MJCF.

    Args:
        path: file of the vehicle.
        thruster: name or path of a thruster file.
        thruster_model: how the vehicle file names the thruster; None: as ``thruster``.
        density: of the water, kg/m^3; None: that of the file, or 1000.
        packages: folders in which packages are looked for.
        arguments: of a xacro file.
        yaml: files of UUV Simulator's thruster manager, to be compared.

    Raises:
        ConfigError: a fault of a file; names file, line and element.
    """
    if density is not None and not 500 <= density <= 2000:
        raise ConfigError(f"density = {density:g}: water has about 1000 kg/m^3")
    for folder in packages:
        if not folder.is_dir():
            raise ConfigError(f"{folder}: is no folder; --packages names folders")
    table = load_thruster(thruster)
    notes = Notes()
    try:
        vehicle = _read(path, open_packages(path, packages), arguments or {}, notes)
    except RecursionError as error:
        raise ConfigError(
            f"{path}: macros, elements or expressions are nested too deep; flatten them"
        ) from error
    model = thruster if thruster_model is None else thruster_model
    tables, trim = build_vehicle(vehicle, model, table, density, notes)
    for file in yaml:
        compare_yaml(file, tables["thrusters"]["layout"], notes)
    config = parse_model(VehicleConfig, tables, source=f"{path} as a vehicle file")
    listed = tuple(notes)
    head = [f"# Imported from {path.name} ({vehicle.format}) by `angler vehicle import`."]
    head += [f"# {_one_line(str(note))}" for note in listed]
    text = "\n".join(head) + "\n\n" + format_tables(tables)
    return ImportedVehicle(name=config.name, text=text, notes=listed, trim=trim)


def _read(
    path: Path, packages: Packages, arguments: Mapping[str, str], notes: Notes
) -> ForeignVehicle:
    root = read_xml(path)
    if root.tag == "robot" and xacro.uses_xacro(root):
        root = xacro.expand_xacro(root, packages, arguments)
    elif arguments:
        raise ConfigError(f"{path}: --xacro-args are for xacro files; leave them out")
    root.is_read = True
    if root.tag == "robot":
        vehicle = urdf.read_urdf(root, packages, notes)
    elif root.tag == "sdf":
        vehicle = sdf.read_sdf(root, packages, notes)
    elif root.tag == "mujoco":
        from angler_mjx.robot.importing import mjcf  # brings MuJoCo

        vehicle = mjcf.read_mjcf(root, packages, notes)
    else:
        raise ConfigError(
            f"{path}:{root.location.line}: <{root.tag}> is the root; a vehicle is described by "
            "<robot> (URDF, xacro), <sdf> or <mujoco>"
        )
    note_unread(root, notes)
    return vehicle


def _one_line(text: str) -> str:
    return "".join(char if char.isprintable() else " " for char in text)
