"""The house as docs/architecture.md draws it, against the house as it stands."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PLACES = {
    "angler_mjx": ROOT / "angler_mjx",
    "angler_kernels": ROOT / "kernels" / "angler_kernels",
    "angler_sitl": ROOT / "sitl_bridge" / "angler_sitl",
    "angler_experiments": ROOT / "experiments" / "angler_experiments",
}
DRAWN = re.findall(r"^    (angler_[a-z_]+(?:\.[a-z_]+)?)(?: |$)", PAGE, re.M)
"""Rooms in the drawing, from the top down."""


def rooms(package):
    """Folders and modules of a package that stand at its top."""
    for entry in sorted(PLACES[package].iterdir()):
        if entry.suffix == ".py" and not entry.name.startswith("_"):
            yield entry.stem
        elif (entry / "__init__.py").is_file():
            yield entry.name


def layers():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    order = next(c for c in contracts["contracts"] if c["type"] == "layers")
    return [set(line.split(" | ")) for line in order["layers"]]


def test_every_room_that_is_drawn_exists_and_every_room_is_drawn():
    standing = {f"angler_mjx.{room}" for room in rooms("angler_mjx")}
    assert set(DRAWN) == standing | (set(PLACES) - {"angler_mjx"})
    assert len(DRAWN) == len(set(DRAWN))


def test_the_drawing_has_the_order_that_imports_are_held_to():
    assert set(DRAWN) == set().union(*layers())
    level = {room: i for i, line in enumerate(layers()) for room in line}
    assert [level[room] for room in DRAWN] == sorted(level[room] for room in DRAWN)


def test_the_rooms_of_the_bridge_are_all_named():
    said = re.search(r"not used by the batch simulator:\n +(.*)\n", PAGE)[1].split(", ")
    # What a driver of ArduSub calls, and the session itself, are no rooms.
    assert set(said) == set(rooms("angler_sitl")) - {"session", "teleop_opener"}


NAMES = sorted(
    set(re.findall(r"`((?:angler_[a-z]+\.)?[a-z_]+(?:\.[a-z_0-9]+)+)(?:\.[A-Z]\w*)?`", PAGE))
)


@pytest.mark.parametrize("name", NAMES)
def test_what_the_page_names_is_there(name):
    """Modules, and functions in them; what is no module of ours (`dataclasses.replace`) is not."""
    package, _, rest = (
        name.partition(".") if name.split(".")[0] in PLACES else ("angler_mjx", "", name)
    )
    parts = rest.split(".")
    if parts[0] not in set(rooms(package)):
        assert parts[0] in {"dataclasses", "jax", "pyproject"}, f"{name}: no room of that name"
        return
    place = PLACES[package].joinpath(*parts)
    module = place.parent.with_suffix(".py")
    there = place.is_dir() or place.with_suffix(".py").is_file()
    assert there or re.search(
        rf"^(?:def|class) {parts[-1]}\b|^{parts[-1]}\b", module.read_text(), re.M
    )
