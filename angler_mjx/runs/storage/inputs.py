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
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

from pydantic import Field

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse
from angler_mjx.quantities import SchemaVersion
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.storage import atomic
from angler_mjx.runs.storage.damage import read_table, reading
from angler_mjx.world.config import WorldConfig

FOLDER, INDEX = "inputs", "inputs.json"
VEHICLE, THRUSTER, PLANNER, OCEAN = "vehicle", "thruster", "planner", "ocean"

type Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]

_MODEL = re.compile(r"""\bmodel["']?[ \t]*=[ \t]*("[^"\n]*"|'[^'\n]*')""")


class Input(FileModel):
    """A file that a run used."""

    role: Annotated[str, Field(pattern="^[a-z_]+$")]
    """vehicle, thruster, planner, ocean, plan, parameters."""
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


def take(
    building: Path, vehicles: Iterable[str], others: Iterable[tuple[str, Path]] = ()
) -> tuple[Input, ...]:
    """Copy the files that a run uses into its folder.

    Args:
        building: folder of the run.
        vehicles: as the scenario names them.
        others: role and file of what else is used.

    Raises:
        ConfigError: a file cannot be read or copied.
        OSError: the copies cannot be written.
    """
    place = building / FOLDER
    place.mkdir()
    kept: list[Input] = []
    names: set[str] = set()
    for named in dict.fromkeys(vehicles):
        vehicle, thruster = _of_vehicle(named)
        same = [one for one in kept if (one.role, one.named) == (THRUSTER, thruster.named)]
        if not same:
            same = [_keep(place, thruster, thruster.data, names)]
            kept += same
        pointed = _pointed(vehicle, f"../{same[0].copy_path}")
        kept.append(_keep(place, vehicle, pointed, names))
    for role, path in others:
        found = _find(role, str(path), path)
        kept.append(_keep(place, found, found.data, names))
    index = _Index(files=tuple(kept))
    atomic.write_text(place / INDEX, json.dumps(index.model_dump(), indent=2) + "\n")
    return index.files


def read_inputs(run: Path) -> tuple[Input, ...]:
    """What a run used; nothing for runs of versions that kept no copies.

    Raises:
        ConfigError: the list is damaged, or a copy is not what was written.
    """
    place = run / FOLDER
    if not place.exists():
        return ()
    source = place / INDEX
    files = parse(_Index, read_table(source), source=str(source)).files
    for one in files:
        within = PurePosixPath(one.copy_path)
        if within.is_absolute() or ".." in within.parts:
            raise ConfigError(f"{source}: copy_path = {one.copy_path!r} leads out of the folder")
        path = place / within
        with reading(path):
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
        if digest != one.copy_sha256:
            raise ConfigError(
                f"{path}: is not the copy that the run made of {one.named} (sha256 {digest[:12]}, "
                f"not {one.copy_sha256[:12]}); put that file back"
            )
    return files


def copies(run: Path) -> dict[str, Path]:
    """Copies of a run's vehicle files by the names that its scenario gives them."""
    place = (run / FOLDER).resolve()
    return {one.named: place / one.copy_path for one in read_inputs(run) if one.role == VEHICLE}


def stand_ins(run: Path) -> dict[str, str]:
    """Vehicles that are not there any more as a run used them, and the copies to use instead.

    Returns:
        Path of the copy by the name in the scenario.
    """
    used = {(one.role, one.named): one.sha256 for one in read_inputs(run)}
    return {
        named: str(path) for named, path in copies(run).items() if _state(named, used) != "same"
    }


def ocean_stand_ins(run: Path) -> dict[str, str]:
    """As `stand_ins`, of files of ocean models."""
    place = (run / FOLDER).resolve()
    return {
        one.named: str(place / one.copy_path)
        for one in read_inputs(run)
        if one.role == OCEAN and _edited(one) is not False
    }


def planner_stand_in(run: Path, name: str) -> str:
    """Return the planner of a run by a name that can be loaded as it was.

    Args:
        run: folder of the run.
        name: of the planner in its scenario.

    Returns:
        The name; of FILE.py:CLASS whose file was edited or is gone, that of the run's copy.
    """
    path, _, qualname = name.rpartition(":")
    for one in read_inputs(run):
        same = one.role == PLANNER and Path(path).resolve() == Path(one.source).resolve()
        if same and _edited(one) is not False:
            return f"{(run / FOLDER).resolve() / one.copy_path}:{qualname}"
    return name


def of_world(world: WorldConfig) -> list[tuple[str, Path]]:
    """Role and file of each file of an ocean model that a world uses."""
    return [(OCEAN, Path(file)) for file in world.files]


def put_ocean(world: dict[str, Any], instead: Mapping[str, str]) -> None:
    """Name other files of ocean models in the table of a world."""
    for table in (*world.get("currents", ()), world.get("bathymetry") or {}):
        if "file" in table:
            table["file"] = instead.get(table["file"], table["file"])


def _edited(one: Input) -> bool | None:
    """Whether a file is not what it was; None where it is gone."""
    try:
        return hashlib.sha256(Path(one.source).read_bytes()).hexdigest() != one.sha256
    except OSError:
        return None


def require_unchanged(run: Path, *, flag: str) -> None:
    """Refuse to go on with files other than those with which a run began.

    Files that are gone are no obstacle: their copies are there. Of planners the copy is used where
    the file is another one now.

    Raises:
        ConfigError: naming them.
    """
    kept = read_inputs(run)
    used = {(one.role, one.named): one.sha256 for one in kept}
    for one in kept:
        if one.role == OCEAN and _edited(one):
            raise ConfigError(
                f"{flag}: {one.source} was edited since the run began (what it was lies in "
                f"{run / FOLDER}): put the old file back, or begin a new run"
            )
    edited = [named for named in copies(run) if _state(named, used) == "edited"]
    if edited:
        raise ConfigError(
            f"{flag}: {', '.join(edited)} or its thruster file was edited since the run began "
            f"(what it was lies in {run / FOLDER}): put the old file back, or begin a new run"
        )


def vehicle_file(run: Path, label: str) -> str:
    """The vehicle of a row of results, as `library.load` takes it: its copy where there is one."""
    found = copies(run)
    for named, name in library.labels(str(path) for path in found.values()).items():
        if name == label:
            return named
    return str(found.get(label, label))


def _state(named: str, used: Mapping[tuple[str, str], str]) -> Literal["same", "edited", "gone"]:
    """How a vehicle's files are now, against those that were used."""
    try:
        now = _of_vehicle(named)
    except ConfigError:
        try:
            there = library.locate(named).exists()
        except (ConfigError, OSError):
            there = False
        return "edited" if there else "gone"
    same = all(used.get((one.role, one.named)) == one.sha256 for one in now)
    return "same" if same else "edited"


def _of_vehicle(named: str) -> tuple[_CurrentFile, _CurrentFile]:
    """A vehicle's file and that of its thrusters, as they are now."""
    vehicle = _find(VEHICLE, named, library.locate(named))
    model = library.load(named).rotor.model
    return vehicle, _find(THRUSTER, model, library.locate_thruster(model))


def _find(role: str, named: str, path: Path) -> _CurrentFile:
    try:
        return _CurrentFile(role=role, named=named, path=path.absolute(), data=path.read_bytes())
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error


def _keep(place: Path, found: _CurrentFile, data: bytes, names: set[str]) -> Input:
    """Write a copy, under a name that no other copy has."""
    stem, end = found.path.stem[:60], found.path.suffix
    kind = f"{found.role.rstrip('s')}s"
    tries = (f"{kind}/{stem}{f'_{i}' if i > 1 else ''}{end}" for i in range(1, len(names) + 2))
    name = next(one for one in tries if one not in names)
    names.add(name)
    (place / name).parent.mkdir(exist_ok=True)
    with atomic.whole(place / name) as writing:
        writing.write_bytes(data)
    return Input(
        role=found.role,
        named=found.named,
        source=str(found.path),
        sha256=found.sha256,
        copy_path=name,
        copy_sha256=hashlib.sha256(data).hexdigest(),
    )


def _pointed(vehicle: _CurrentFile, model: str) -> bytes:
    """A vehicle file that names another thruster file, and is the same else."""
    text = vehicle.data.decode("utf-8-sig")
    wanted = tomllib.loads(text)
    wanted["rotor"]["model"] = model
    for found in _MODEL.finditer(text):
        made = text[: found.start(1)] + json.dumps(model) + text[found.end(1) :]
        try:
            if tomllib.loads(made) == wanted:
                return made.encode("utf-8")
        except tomllib.TOMLDecodeError:
            continue
    raise ConfigError(
        f"{vehicle.path}: rotor.model cannot be found in the text; write it in one line in plain "
        'quotation marks, as in model = "t200"'
    )
