"""Reader of MovingAI's benchmarks: grid maps and voxel maps with their scenario files.

Formats: https://movingai.com/benchmarks/formats.html for ``.map`` and ``.scen``; ``.3dmap`` begins
with ``voxel X Y Z``, or ``rev_voxel`` where free cells are listed; ``.3dscen`` has version 1 or 2.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import format_path, read_text
from angler_mjx.report.interop.problem_files.foreign_problem import ForeignProblem
from angler_mjx.robot.importing.notes import Location, Notes

MAX_BYTES = 256 * 2**20
FREE, BLOCKED, SWAMP, WATER = ".G", "@OT", "S", "W"
"""Letters of maps: ground, walls, swamp (passable from ground) and water (passable from itself)."""
SUFFIXES = (".scen", ".3dscen")

type Region = tuple[int, ...]
"""First and last cell along each axis: x0, y0, x1, y1, or x0, y0, z0, x1, y1, z1."""


@dataclass(frozen=True, kw_only=True)
class _Text:
    """Lines of a file, whose faults name file and line."""

    path: Path
    lines: list[str] = field(default_factory=list)

    def numbers(self, index: int, count: int, skip: int = 0) -> list[float]:
        """Return numbers of a line, from its field ``skip`` on.

        Raises:
            ConfigError: it has fewer, or something else.
        """
        fields = self.lines[index].split()
        try:
            values = [float(text) for text in fields[skip : skip + count]]
        except ValueError:
            values = []
        if len(values) < count:
            raise self.fault(index, f"must have {count} numbers from its field {skip + 1} on")
        return values

    def fault(self, index: int, text: str) -> ConfigError:
        """Return an error that names file and line."""
        line = self.lines[index] if index < len(self.lines) else ""
        return ConfigError(f"{format_path(self.path)}:{index + 1}: {format_value(line)}: {text}")

    def location(self, index: int) -> Location:
        """Return the location of a line."""
        return Location(file=self.path, line=index + 1)


def _read_lines(path: Path) -> _Text:
    return _Text(path=path, lines=read_text(path, MAX_BYTES).splitlines())


def read_problem(
    path: Path, *, map_file: Path | None, robots: int, region: Region | None
) -> ForeignProblem:
    """Read the first rows of a scenario file as the robots of one problem.

    Args:
        path: ``.scen`` or ``.3dscen``.
        map_file: its map; the file that it names, beside it, if None.
        robots: number of rows.
        region: part of the map that is taken; all if None.

    Raises:
        ConfigError: a file is missing or has a fault, or too few rows lie in the region.
    """
    notes, text = Notes(), _read_lines(path)
    is_voxel = path.suffix == ".3dscen"
    axes = 3 if is_voxel else 2
    version = text.lines[0].split() if text.lines else []
    versions = {"1", "1.0", "1.00", "2"} if is_voxel else {"1", "1.0", "1.00"}
    if len(version) != 2 or version[0] != "version" or version[1] not in versions:
        raise text.fault(0, f"must be version {' or '.join(sorted(versions))}")
    named, first = _find_map_name(text, is_voxel=is_voxel)
    source = map_file or path.parent / Path(named.replace("\\", "/")).name
    if not source.is_file():
        raise ConfigError(
            f"{format_path(path)}: names the map {format_value(named)}; there is no "
            f"{format_path(source)}: give --map"
        )
    cells = _read_voxels(source, notes) if is_voxel else _read_grid(source, notes)
    low, high = _limit_region(cells.shape, region, axes)
    start, goal = [], []
    for index in range(first, len(text.lines)):
        if not text.lines[index].strip():
            continue
        if not is_voxel:
            width, height = text.numbers(index, 2, skip=2)
            if (width, height) != cells.shape:
                raise text.fault(
                    index,
                    f"is for a map of {width:g} x {height:g}, {source.name} has "
                    f"{cells.shape[0]} x {cells.shape[1]}; scaled maps are not read",
                )
        row = np.array(text.numbers(index, 2 * axes, skip=0 if is_voxel else 4)).reshape(2, axes)
        if not np.all((row >= low) & (row < high)):
            notes.add(
                "dropped",
                "rows whose start or goal is outside the region or map",
                text.location(index),
            )
            continue
        for label, position in zip(("start", "goal"), row, strict=True):
            if cells[tuple(position.astype(int))]:
                raise text.fault(index, f"its {label} is blocked in {source.name}")
        start.append(row[0])
        goal.append(row[1])
        if len(start) == robots:
            break
    if len(start) < robots:
        raise ConfigError(
            f"{format_path(path)}: has {len(start)} rows in the region, --robots {robots}"
        )
    notes.add("dropped", "optimal lengths: of single agents on the grid's edges")
    taken = cells[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    shift = 0.5 - low
    if not is_voxel:  # Row 0 of a map is the northernmost.
        taken = taken[:, ::-1]
        for rows in (start, goal):
            for row in rows:
                row[1] = high[1] - 1 + low[1] - row[1]
        notes.add("converted", "rows of the map run from north to south")
    else:
        notes.add("assumed", "the third axis of voxels is up")
    return ForeignProblem(
        name=path.name.split(".")[0],
        low=(0.0,) * axes,
        high=tuple(float(size) for size in taken.shape),
        start=np.array(start) + shift,
        goal=np.array(goal) + shift,
        cells=taken,
        notes=notes,
    )


def _find_map_name(text: _Text, *, is_voxel: bool) -> tuple[str, int]:
    """Return the map's name, and the index of the first row."""
    if len(text.lines) < 2:
        raise text.fault(1, "there must be rows after the version")
    if is_voxel:
        return text.lines[1].strip(), 2
    fields = text.lines[1].split("\t") if "\t" in text.lines[1] else text.lines[1].split()
    if len(fields) < 9:
        raise text.fault(1, "must have 9 fields: bucket, map, width, height, start, goal, length")
    return fields[1], 1


def _limit_region(
    shape: tuple[int, ...], region: Region | None, axes: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the first cell and the one after the last along each axis."""
    if region is None:
        return np.zeros(axes, int), np.array(shape)
    if len(region) != 2 * axes:
        raise ConfigError(
            f"--region: must be {2 * axes} numbers, first and last cell along each axis"
        )
    low, last = np.array(region[:axes]), np.array(region[axes:])
    if np.any(low < 0) or np.any(last < low) or np.any(last >= np.array(shape)):
        raise ConfigError(
            f"--region {' '.join(map(str, region))}: must lie in the map, {shape} cells"
        )
    return low, last + 1


def _read_grid(path: Path, notes: Notes) -> np.ndarray:
    """Read a ``.map``: bool [width, height] whether each cell is blocked, row 0 at the top."""
    text = _read_lines(path)
    head = [line.split() for line in text.lines[:4]]
    keys = [fields[0] if fields else "" for fields in head]
    if keys[:1] != ["type"] or sorted(keys[1:3]) != ["height", "width"] or keys[3:] != ["map"]:
        raise text.fault(0, "the map must begin with the lines type, height, width and map")
    sizes = {keys[i]: int(text.numbers(i, 1, skip=1)[0]) for i in (1, 2)}
    rows = text.lines[4 : 4 + sizes["height"]]
    if len(rows) < sizes["height"]:
        raise text.fault(len(text.lines), f"the map must have {sizes['height']} rows")
    for i, row in enumerate(rows):
        if len(row) != sizes["width"]:
            raise text.fault(4 + i, f"must have {sizes['width']} letters, has {len(row)}")
    letters = np.array([list(row) for row in rows]).T
    unknown = set(np.unique(letters)) - set(FREE + BLOCKED + SWAMP + WATER)
    if unknown:
        raise ConfigError(
            f"{format_path(path)}: has the letters {format_value(''.join(sorted(unknown)))}; "
            f"known are {FREE}{SWAMP} (free) and {BLOCKED}{WATER} (blocked)"
        )
    for letter, text_of in ((SWAMP, "swamp is free"), (WATER, "water of the map is blocked")):
        if np.any(letters == letter):
            notes.add("converted", f"{text_of} ({letter})")
    blocked: np.ndarray = np.isin(letters, list(BLOCKED + WATER))
    return blocked


def _read_voxels(path: Path, notes: Notes) -> np.ndarray:
    """Read a ``.3dmap``: bool [x, y, z] whether each voxel is blocked."""
    text = _read_lines(path)
    head = text.lines[0].split() if text.lines else []
    if len(head) != 4 or head[0] not in ("voxel", "rev_voxel"):
        raise text.fault(0, "the map must begin with voxel X Y Z, or rev_voxel X Y Z")
    shape = tuple(int(size) for size in text.numbers(0, 3, skip=1))
    if min(shape) < 1 or np.prod(shape, dtype=float) > 2**33:
        raise text.fault(0, "sizes must be above 0, and less than 2^33 voxels in all")
    listed = np.zeros(shape, bool)
    for index in range(1, len(text.lines)):
        if text.lines[index].strip():
            voxel = tuple(int(value) for value in text.numbers(index, 3))
            if any(not 0 <= v < size for v, size in zip(voxel, shape, strict=True)):
                raise text.fault(index, f"lies outside the map, {shape} voxels")
            listed[voxel] = True
    if head[0] == "rev_voxel":
        notes.add("converted", "the map lists free voxels (rev_voxel)")
        return ~listed
    return listed
