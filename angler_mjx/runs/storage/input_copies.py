"""Copies of the files that a run used, in its folder: ``inputs/``, listed in ``inputs.json``.

A vehicle's copy names the copy of its thrusters, so that it can be loaded like any vehicle file.
Shipped files are copied too: another version of this program may come with others.
"""

import hashlib
import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from angler_mjx._moved import renamed as _renamed
from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse_model
from angler_mjx.quantities import SchemaVersion
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.storage import atomic_files
from angler_mjx.runs.storage.checksums import hash_file, is_inside
from angler_mjx.runs.storage.read_errors import read_table, wrap_read_errors
from angler_mjx.world.config import WorldConfig

INPUTS_FOLDER, INDEX_FILE = "inputs", "inputs.json"
VEHICLE, THRUSTER, PLANNER, OCEAN = "vehicle", "thruster", "planner", "ocean"
LAW, POLICY = "law", "policy"
"""Roles of files of control laws and policies."""

type Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]

_MODEL = re.compile(r"""\bmodel["']?[ \t]*=[ \t]*("[^"\n]*"|'[^'\n]*')""")


class Input(FileModel):
    """A file that a run used."""

    role: Annotated[str, Field(pattern="^[a-z_]+$")]
    """vehicle, thruster, planner, law, policy, ocean, plan, parameters."""
    named: str
    """As the scenario, the vehicle file or the command line named it."""
    source: str
    """Where it was."""
    sha256: Sha256
    """Of the file as it was."""
    copy_path: str
    """Below ``inputs/``."""
    copy_sha256: Sha256
    """Of the copy: a vehicle's names the copy of its thrusters."""


class _Index(FileModel):
    """``inputs.json``."""

    schema_version: SchemaVersion = 1
    files: tuple[Input, ...]


@dataclass(frozen=True, kw_only=True)
class _CurrentFile:
    """A file as it is now."""

    role: str
    named: str
    path: Path
    data: bytes

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.data).hexdigest()


def copy_inputs(
    building: Path, vehicles: Iterable[str], extra_files: Iterable[tuple[str, Path]] = ()
) -> tuple[Input, ...]:
    """Copy the files that a run uses into its folder.

    Args:
        building: folder of the run.
        vehicles: as the scenario names them.
        extra_files: role and file of what else is used.

    Raises:
        ConfigError: a file cannot be read or copied.
        OSError: the copies cannot be written.
    """
    folder = building / INPUTS_FOLDER
    folder.mkdir()
    inputs: list[Input] = []
    names: set[str] = set()
    for named in dict.fromkeys(vehicles):
        vehicle, thruster = _vehicle_files(named)
        if thruster is None:
            inputs.append(_write_copy(folder, vehicle, vehicle.data, names))
            continue
        thruster_copies = [
            entry for entry in inputs if (entry.role, entry.named) == (THRUSTER, thruster.named)
        ]
        if not thruster_copies:
            thruster_copies = [_write_copy(folder, thruster, thruster.data, names)]
            inputs += thruster_copies
        vehicle_data = _point_to_thruster(vehicle, f"../{thruster_copies[0].copy_path}")
        inputs.append(_write_copy(folder, vehicle, vehicle_data, names))
    for role, path in extra_files:
        current = _read_file(role, str(path), path)
        inputs.append(_write_copy(folder, current, current.data, names))
    index = _Index(files=tuple(inputs))
    atomic_files.write_json(folder / INDEX_FILE, index.model_dump())
    return index.files


def read_inputs(run: Path) -> tuple[Input, ...]:
    """Read the list of files that a run used; empty for versions that kept no copies.

    Raises:
        ConfigError: the list is damaged, or a copy is not what was written.
    """
    folder = run / INPUTS_FOLDER
    if not folder.exists():
        return ()
    source = folder / INDEX_FILE
    files = parse_model(_Index, read_table(source), source=str(source)).files
    for entry in files:
        if not is_inside(entry.copy_path):
            raise ConfigError(f"{source}: copy_path = {entry.copy_path!r} leads out of the folder")
        path = folder / entry.copy_path
        with wrap_read_errors(path):
            digest = hash_file(path)
        if digest != entry.copy_sha256:
            raise ConfigError(
                f"{path}: is not the copy that the run made of {entry.named} (sha256 "
                f"{digest[:12]}, not {entry.copy_sha256[:12]}); put that file back"
            )
    return files


def vehicle_copies(run: Path) -> dict[str, Path]:
    """Return the copies of a run's vehicle files by their names in its scenario."""
    folder = (run / INPUTS_FOLDER).resolve()
    return {
        entry.named: folder / entry.copy_path for entry in read_inputs(run) if entry.role == VEHICLE
    }


def stand_ins(run: Path) -> dict[tuple[str, str], str]:
    """Return the copies of vehicles, ocean models and classes that are missing or edited since.

    Returns:
        Path of the copy by role and name in the scenario; of planners, control laws and policies,
        by role and resolved path of the file.
    """
    inputs, folder = read_inputs(run), (run / INPUTS_FOLDER).resolve()
    used = {(entry.role, entry.named): entry.sha256 for entry in inputs}
    copies = {}
    for entry in inputs:
        if entry.role == VEHICLE and _vehicle_state(entry, folder, used) != "same":
            copies[VEHICLE, entry.named] = str(folder / entry.copy_path)
        elif entry.role in (OCEAN, PLANNER, LAW, POLICY) and _is_edited(entry) is not False:
            name = entry.named if entry.role == OCEAN else str(Path(entry.source).resolve())
            copies[entry.role, name] = str(folder / entry.copy_path)
    return copies


def use_stand_ins(table: dict[str, Any], run: Path) -> None:
    """Name the copies of `stand_ins` in the table of a run's scenario."""
    copies = stand_ins(run)

    def replace_class(role: str, name: str) -> str:
        path, _, qualname = name.rpartition(":")
        copy = copies.get((role, str(Path(path).resolve())))
        return name if copy is None else f"{copy}:{qualname}"

    for entry in table["fleet"]:
        entry["vehicle"] = copies.get((VEHICLE, entry["vehicle"]), entry["vehicle"])
    world, planner = table["world"], table.get("planner", {})
    for part in (*world.get("currents", ()), world.get("bathymetry") or {}):
        if "file" in part:
            part["file"] = copies.get((OCEAN, part["file"]), part["file"])
    if "name" in planner:
        planner["name"] = replace_class(PLANNER, planner["name"])
    policy = table.get("policy", {})
    if "name" in policy:
        policy["name"] = replace_class(POLICY, policy["name"])
    controller = table.get("controller", {})
    if controller.get("stages"):
        controller["stages"] = [replace_class(LAW, name) for name in controller["stages"]]


def world_files(world: WorldConfig) -> list[tuple[str, Path]]:
    """Return role and file of each file of an ocean model that a world uses."""
    return [(OCEAN, Path(file)) for file in world.files]


def _is_edited(entry: Input) -> bool | None:
    """Return whether a file was edited; None if it is missing."""
    try:
        return hash_file(Path(entry.source)) != entry.sha256
    except OSError:
        return None


def require_unchanged(run: Path, *, flag: str) -> None:
    """Refuse to go on with files other than those with which a run began.

    Files that are gone are no obstacle: their copies are there. Of planners the copy is used where
    the file is another one now.

    Raises:
        ConfigError: naming them.
    """
    inputs = read_inputs(run)
    used = {(entry.role, entry.named): entry.sha256 for entry in inputs}
    for entry in inputs:
        if entry.role == OCEAN and _is_edited(entry):
            raise ConfigError(
                f"{flag}: {entry.source} was edited since the run began (what it was lies in "
                f"{run / INPUTS_FOLDER}): put the old file back, or begin a new run"
            )
    folder = run / INPUTS_FOLDER
    edited = [
        entry.named
        for entry in inputs
        if entry.role == VEHICLE and _vehicle_state(entry, folder, used) == "edited"
    ]
    if edited:
        raise ConfigError(
            f"{flag}: {', '.join(edited)} or its thruster file was edited since the run began "
            f"(what it was lies in {run / INPUTS_FOLDER}): put the old file back, or begin a new "
            "run"
        )


def vehicle_file(run: Path, label: str) -> str:
    """Return the vehicle of a row of results for `library.load_vehicle`: its copy, if any."""
    vehicle_paths = vehicle_copies(run)
    for named, name in library.label_vehicles(str(path) for path in vehicle_paths.values()).items():
        if name == label:
            return named
    return str(vehicle_paths.get(label, label))


def _vehicle_state(
    entry: Input, folder: Path, used: Mapping[tuple[str, str], str]
) -> Literal["same", "edited", "gone"]:
    """Compare a vehicle's files with those that were used, of which copies lie in a folder."""
    try:
        vehicle, thruster = _vehicle_files(entry.named)
    except ConfigError:
        try:
            exists = library.locate_vehicle(entry.named).exists()
        except (ConfigError, OSError):
            exists = False
        return "edited" if exists else "gone"
    if thruster is not None and used.get((THRUSTER, thruster.named)) != thruster.sha256:
        return "edited"
    is_same = vehicle.sha256 == entry.sha256
    return "same" if is_same or _only_gained_sets(folder / entry.copy_path, vehicle) else "edited"


def _only_gained_sets(copy: Path, current: _CurrentFile) -> bool:
    """Return whether a vehicle file differs from its copy by more sets with an uncertainty alone.

    A run takes these by name only, so one that began before them goes on as it was.
    """
    try:
        before = tomllib.loads(copy.read_text(encoding="utf-8-sig"))
        now = tomllib.loads(current.data.decode("utf-8-sig"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        return False
    before["rotor"]["model"] = now["rotor"]["model"]  # a copy names the copy of its thrusters
    sets, old_sets = now["parameter_sets"], before["parameter_sets"]
    gained = sets.keys() - old_sets.keys()
    if not all("uncertainty" in sets[name] for name in gained):
        return False
    kept = {name: numbers for name, numbers in sets.items() if name not in gained}
    same: bool = before == {**now, "parameter_sets": kept}
    return same


def _vehicle_files(named: str) -> tuple[_CurrentFile, _CurrentFile | None]:
    """Read a vehicle's file and that of its thrusters, if it has any, as they are now."""
    vehicle = _read_file(VEHICLE, named, library.locate_vehicle(named))
    rotor = library.load_vehicle(named).rotor
    if rotor is None:
        return vehicle, None
    return vehicle, _read_file(THRUSTER, rotor.model, library.locate_thruster(rotor.model))


def _read_file(role: str, named: str, path: Path) -> _CurrentFile:
    try:
        return _CurrentFile(role=role, named=named, path=path.absolute(), data=path.read_bytes())
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error


def _write_copy(folder: Path, current: _CurrentFile, data: bytes, names: set[str]) -> Input:
    """Write a copy, under a name that no other copy has."""
    stem, suffix = current.path.stem[:60], current.path.suffix
    kind = f"{current.role.rstrip('s')}s"
    candidates = (
        f"{kind}/{stem}{f'_{i}' if i > 1 else ''}{suffix}" for i in range(1, len(names) + 2)
    )
    name = next(entry for entry in candidates if entry not in names)
    names.add(name)
    (folder / name).parent.mkdir(exist_ok=True)
    atomic_files.write_bytes(folder / name, data)
    return Input(
        role=current.role,
        named=current.named,
        source=str(current.path),
        sha256=current.sha256,
        copy_path=name,
        copy_sha256=hashlib.sha256(data).hexdigest(),
    )


def _point_to_thruster(vehicle: _CurrentFile, model: str) -> bytes:
    """Return a vehicle file that names another thruster file and is otherwise the same."""
    text = vehicle.data.decode("utf-8-sig")
    expected = tomllib.loads(text)
    expected["rotor"]["model"] = model
    for match in _MODEL.finditer(text):
        edited = text[: match.start(1)] + json.dumps(model) + text[match.end(1) :]
        try:
            if tomllib.loads(edited) == expected:
                return edited.encode("utf-8")
        except tomllib.TOMLDecodeError:
            continue
    raise ConfigError(
        f"{vehicle.path}: rotor.model cannot be found in the text; write it in one line in plain "
        'quotation marks, as in model = "t200"'
    )


def __getattr__(name: str) -> object:
    """Return what had another name before 0.2."""
    return _renamed(__name__, name)
