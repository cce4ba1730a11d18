"""The house as docs/explanation/architecture.md lists it, against the house as it stands."""

import ast
import re
import tomllib
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "explanation" / "architecture.md").read_text(encoding="utf-8")
ROOTS = {
    "angler_mjx": ROOT / "angler_mjx",
    "angler_kernels": ROOT / "kernels" / "angler_kernels",
    "angler_sitl": ROOT / "sitl_bridge" / "angler_sitl",
    "angler_experiments": ROOT / "experiments" / "angler_experiments",
}
LISTED = re.findall(r"^\| `(angler_[a-z_]+(?:\.[a-z_]+)?)` \| ", PAGE, re.M)
"""Rooms in the table, from the top down."""


def rooms(package):
    """Folders and modules of a package that stand at its top."""
    for entry in sorted(ROOTS[package].iterdir()):
        if entry.suffix == ".py" and not entry.name.startswith("_"):
            yield entry.stem
        elif (entry / "__init__.py").is_file():
            yield entry.name


def layers():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    order = next(c for c in contracts["contracts"] if c["type"] == "layers")
    return [set(line.split(" | ")) for line in order["layers"]]


def test_every_listed_room_exists_and_every_room_is_listed():
    standing = {f"angler_mjx.{room}" for room in rooms("angler_mjx")}
    assert set(LISTED) == standing | (set(ROOTS) - {"angler_mjx"})
    assert len(LISTED) == len(set(LISTED))


def test_the_table_has_the_order_that_imports_are_held_to():
    assert set(LISTED) == set().union(*layers())
    level = {room: i for i, line in enumerate(layers()) for room in line}
    assert [level[room] for room in LISTED] == sorted(level[room] for room in LISTED)


def test_the_rooms_of_the_bridge_are_all_named():
    unused = re.search(r"not used by the batch simulator: (.*) \|\n", PAGE)[1].split(", ")
    # What a driver of ArduSub calls, and the sessions themselves, are no rooms.
    sessions = {"autopilot_session", "session", "teleop_opener"}
    assert set(unused) == set(rooms("angler_sitl")) - sessions


NAMES = sorted(
    set(re.findall(r"`((?:angler_[a-z]+\.)?[a-z_]+(?:\.[a-z_0-9]+)+)(?:\.[A-Z]\w*)?`", PAGE))
)


@pytest.mark.parametrize("name", NAMES)
def test_what_the_page_names_is_there(name):
    """Modules, and functions in them; what is no module of ours (`dataclasses.replace`) is not."""
    package, _, rest = (
        name.partition(".") if name.split(".")[0] in ROOTS else ("angler_mjx", "", name)
    )
    parts = rest.split(".")
    if parts[0] not in set(rooms(package)):
        assert parts[0] in {"dataclasses", "jax", "pyproject"}, f"{name}: no room of that name"
        return
    path = ROOTS[package].joinpath(*parts)
    module = path.parent.with_suffix(".py")
    there = path.is_dir() or path.with_suffix(".py").is_file()
    assert there or re.search(
        rf"^(?:def|class) {parts[-1]}\b|^{parts[-1]}\b", module.read_text(), re.M
    )


def folder(module):
    """Return the folder of a module, dotted; None if it is not ours."""
    top, *parts = module.split(".")
    if top not in ROOTS:
        return None
    place, name = ROOTS[top], top
    for part in parts:
        if not (place / part).is_dir():
            break
        place, name = place / part, f"{name}.{part}"
    return name


def imported_folders(file):
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from map(folder, (node.module, *(f"{node.module}.{a.name}" for a in node.names)))
        elif isinstance(node, ast.Import):
            yield from (folder(alias.name) for alias in node.names)


def test_no_two_folders_import_each_other():
    """A package's own top folder is left out: its ``__init__`` exports from all rooms."""
    imports = defaultdict(set)
    for top, root in ROOTS.items():
        for file in root.rglob("*.py"):
            name = ".".join((top, *file.parent.relative_to(root).parts))
            imports[name].update(imported_folders(file))
    pairs = {(a, b) for a in imports for b in imports[a] if b and a < b and a in imports[b]}
    assert {pair for pair in pairs if not set(pair) & set(ROOTS)} == set()
