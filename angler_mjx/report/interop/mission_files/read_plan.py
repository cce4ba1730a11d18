"""QGroundControl's ``.plan`` files: JSON with simple and complex items.

A complex item of a survey or a corridor holds the simple items that it was expanded to; they are
read. Other complex items hold only what QGroundControl computes items from.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import format_path, read_json
from angler_mjx.frames import GeodeticOrigin
from angler_mjx.report.interop.mission_files.items import (
    JUMP,
    ItemLocation,
    Mission,
    MissionItem,
)
from angler_mjx.robot.importing.notes import Notes

_SIMPLE_KEYS = {
    "AMSLAltAboveTerrain",
    "Altitude",
    "AltitudeMode",
    "autoContinue",
    "doJumpId",
    "type",
    "complexItemType",
    "version",
}
"""Keys of a simple item without an effect here: QGroundControl's editor computes the item's
parameters from them."""
_MISSION_KEYS = {
    "cruiseSpeed",
    "firmwareType",
    "globalPlanAltitudeMode",
    "hoverSpeed",
    "vehicleType",
    "version",
}
"""Keys of a mission without an effect: its speeds are for the estimate of the flight's time."""
_N_PARAMETERS = 7
_PLAN_VERSIONS = (1,)
_MAX_ITEMS = 20_000
_MAX_NUMBER = 1e12
"""Numbers of items are degrees, metres, seconds and flags."""


@dataclass
class _Node:
    """Object of a JSON file, with the keys that were read."""

    file: Path
    key: str
    table: Mapping[str, object]
    read: set[str] = field(default_factory=set)

    def get(self, name: str) -> object:
        """Return a value; None where it is missing or null."""
        self.read.add(name)
        return self.table.get(name)

    def locate(self, name: str = "") -> ItemLocation:
        key = ".".join(part for part in (self.key, name) if part)
        return ItemLocation(file=self.file, part=f": {key}" if key else "")

    def fault(self, name: str, text: str) -> ConfigError:
        value = self.table.get(name)
        sign = "" if name not in self.table else f" = {format_value(value)}"
        return self.locate(name).fault(f"{sign}: {text}")

    def child(self, name: str) -> "_Node":
        """Return an object below this one.

        Raises:
            ConfigError: it is missing, or something else.
        """
        value = self.get(name)
        if not isinstance(value, dict):
            raise self.fault(name, "must be an object; save the plan again in QGroundControl")
        key = ".".join(part for part in (self.key, name) if part)
        return _Node(file=self.file, key=key, table=value)

    def children(self, name: str) -> "list[_Node]":
        """Return the objects of a list; empty where it is missing.

        Raises:
            ConfigError: it is no list of objects.
        """
        values = self.get(name)
        if values is None:
            return []
        if not isinstance(values, list) or len(values) > _MAX_ITEMS:
            raise self.fault(name, f"must be a list of at most {_MAX_ITEMS} items")
        prefix = f"{self.key}.{name}" if self.key else name
        nodes = []
        for i, value in enumerate(values):
            if not isinstance(value, dict):
                location = ItemLocation(file=self.file, part=f": {prefix}[{i}]")
                raise location.fault(f" = {format_value(value)}: must be an object")
            nodes.append(_Node(file=self.file, key=f"{prefix}[{i}]", table=value))
        return nodes

    def integer(self, name: str) -> int:
        """Return a whole number.

        Raises:
            ConfigError: it is missing, or something else.
        """
        value = self.get(name)
        number = _to_number(value)
        if number is None or not math.isfinite(number) or number != int(number):
            raise self.fault(name, "must be a whole number")
        return int(number)

    def numbers(self, name: str) -> list[float | None]:
        """Return a list of numbers; None for null and NaN.

        Raises:
            ConfigError: it is something else.
        """
        values = self.get(name)
        if not isinstance(values, list):
            raise self.fault(name, "must be a list of numbers")
        numbers: list[float | None] = []
        for i, value in enumerate(values):
            number = _to_number(value)
            if (number is None and value is not None) or abs(number or 0.0) > _MAX_NUMBER:
                raise self.locate(f"{name}[{i}]").fault(
                    f" = {format_value(value)}: must be a number or null"
                )
            numbers.append(None if number is None or math.isnan(number) else number)
        return numbers


def read_plan(path: Path, notes: Notes) -> Mission:
    """Read a plan.

    Args:
        path: of the file.
        notes: receives what is not flown.

    Raises:
        ConfigError: the file is no plan, or has a fault; names the key and its value.
    """
    value = read_json(path)
    if not isinstance(value, dict):
        raise ConfigError(f"{format_path(path)}: must hold an object, as QGroundControl writes it")
    root = _Node(file=path, key="", table=value)
    if root.get("fileType") != "Plan":
        raise root.fault(
            "fileType",
            'must be "Plan"; other files of QGroundControl (.mission, .fence, .kml) hold no plan: '
            "save the plan as .plan",
        )
    if root.get("version") not in _PLAN_VERSIONS:
        raise root.fault("version", "version 1 can be read; save the plan in a current one")
    root.get("groundStation")
    mission = root.child("mission")
    home = _read_home(mission)
    items: list[MissionItem] = []
    jump_ids: dict[int, int] = {}
    for node in mission.children("items"):
        for simple in _expand(node, notes):
            items.append(_read_item(simple, len(items) + 1, jump_ids, notes))
    _note_unread(mission, _MISSION_KEYS, notes)
    for name, keys in (("geoFence", ("polygons", "circles")), ("rallyPoints", ("points",))):
        if root.get(name) is not None:
            part = root.child(name)
            for key in keys:
                shapes = part.get(key) or []
                if not isinstance(shapes, list):
                    raise part.fault(key, "must be a list")
                if shapes:
                    text = f"{name}.{key}: {len(shapes)}, not checked"
                    notes.add("dropped", text, part.locate(key))
    _note_unread(root, set(), notes)
    return Mission(file=path, home=home, items=_resolve_jumps(items, jump_ids))


def _read_home(mission: _Node) -> GeodeticOrigin | None:
    if mission.get("plannedHomePosition") is None:
        return None
    numbers = mission.numbers("plannedHomePosition")
    match numbers:
        case [float(latitude), float(longitude), *rest] if len(rest) <= 1 and (
            abs(latitude) <= 90.0 and abs(longitude) <= 180.0
        ):
            altitude = rest[0] if rest else 0.0
            return GeodeticOrigin(
                latitude_deg=latitude, longitude_deg=longitude, altitude_m=altitude or 0.0
            )
    raise mission.fault("plannedHomePosition", "must be latitude, longitude and altitude")


def _expand(node: _Node, notes: Notes) -> Iterator[_Node]:
    """Yield the simple items of an item."""
    kind = node.get("type")
    if kind == "SimpleItem":
        yield node
        return
    if kind != "ComplexItem":
        raise node.fault("type", 'must be "SimpleItem" or "ComplexItem"')
    name = node.get("complexItemType")
    if not isinstance(node.table.get("TransectStyleComplexItem"), dict):
        notes.add(
            "dropped",
            f"complex item {format_value(name)}: the file does not hold its way-points; fly it "
            "from QGroundControl once and save the downloaded mission",
            node.locate(),
        )
        return
    transects = node.child("TransectStyleComplexItem")
    simple = transects.children("Items")
    if not simple:
        notes.add("dropped", f"complex item {format_value(name)}: has no Items", node.locate())
    yield from simple


def _read_item(node: _Node, number: int, jump_ids: dict[int, int], notes: Notes) -> MissionItem:
    command, frame = node.integer("command"), node.integer("frame")
    numbers = node.numbers("params")
    if node.table.get("coordinate") is not None:  # of versions before 2017
        position = node.numbers("coordinate")
        numbers = [*numbers[:4], *position] if len(numbers) == _N_PARAMETERS else numbers + position
    if len(numbers) != _N_PARAMETERS:
        raise node.fault("params", f"must be {_N_PARAMETERS} numbers or nulls")
    if node.table.get("doJumpId") is not None:
        jump_ids[node.integer("doJumpId")] = number
    _note_unread(node, _SIMPLE_KEYS | {"coordinate"}, notes)
    p1, p2, p3, p4, latitude, longitude, altitude = numbers
    return MissionItem(
        number=number,
        command=command,
        frame=frame,
        parameters=(p1, p2, p3, p4),
        latitude_deg=latitude,
        longitude_deg=longitude,
        altitude_m=altitude,
        location=node.locate(),
    )


def _resolve_jumps(items: list[MissionItem], jump_ids: dict[int, int]) -> tuple[MissionItem, ...]:
    """Return the items with jumps to sequence numbers, as they are uploaded."""
    resolved = []
    for item in items:
        target = item.parameters[0]
        if item.command == JUMP and target is not None and target in jump_ids:
            item = replace(item, parameters=(jump_ids[int(target)], *item.parameters[1:]))
        resolved.append(item)
    return tuple(resolved)


def _note_unread(node: _Node, without_effect: set[str], notes: Notes) -> None:
    for name in sorted(node.table.keys() - node.read - without_effect):
        notes.add("dropped", f"key {format_value(name)}: not understood", node.locate(name))


def _to_number(value: object) -> float | None:
    """Return a number; None for another type, and for numbers beyond float64."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:
        return None
