"""The reference of scenario and vehicle files, written from the models that check them.

``python -m angler_mjx.scenario.reference docs`` writes the pages; a test holds them to the models.
"""

import ast
import inspect
import sys
import textwrap
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, TypeAliasType, Union, get_args, get_origin

from pydantic import AfterValidator, BeforeValidator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from angler_mjx.files import FileModel
from angler_mjx.quantities import FASTEST_MPS, no_faster
from angler_mjx.robot.vehicles import checks
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.thruster_config import ThrusterTable
from angler_mjx.scenario.scenario import Scenario

type Kind = Literal["scenario", "vehicle"]

_PAGES: dict[str, tuple[str, str, tuple[tuple[str, type[FileModel]], ...]]] = {
    "scenario": (
        "Scenario files",
        "A scenario is a TOML file. `angler scenarios show reef_fleet` prints one to begin with. "
        "Types are strict: a whole number will do for a float, but neither text nor `true` for a "
        "number. Keys that are not here are refused. Paths begin at the folder of the file.\n\n"
        "A vehicle flies paths with thrust in surge, heave and yaw, each without the others; where "
        "it has no sway (less than a tenth of surge) controllers turn its bow to where it must go, "
        "and the controller `ardusub` is refused. A vehicle that lacks more is refused by name.",
        (("", Scenario),),
    ),
    "vehicle": (
        "Vehicle and thruster files",
        "A vehicle is a TOML file; `angler vehicle list` names those that ship, in "
        "`angler_mjx/robot/vehicles/data/`. Its base frame has the axes of F (x forward, y left, "
        "z up) and an origin of the file's choice; everything under `parameter_sets` is about the "
        "centre of mass. Every group of numbers carries its `source`. Types are strict, and keys "
        "that are not here are refused.",
        (("", VehicleConfig), ("Thruster file", ThrusterTable)),
    ),
}

_UNITS = (
    ("_mps3_per_rthz", "m/s³/√Hz"), ("_radps2_per_rthz", "rad/s²/√Hz"),
    ("_mps2_per_rthz", "m/s²/√Hz"), ("_radps_per_rthz", "rad/s/√Hz"), ("_kgpm3", "kg/m³"),
    ("_kgm2", "kg m²"), ("_radps", "rad/s"), ("_mps2", "m/s²"), ("_mps", "m/s"), ("_m3", "m³"),
    ("_percent_of_speed", "%"), ("_percent_of_range", "%"), ("_deg", "°"), ("_kg", "kg"),
    ("_db_per_m", "dB/m"), ("_khz", "kHz"), ("_db", "dB"), ("_bps", "bit/s"),
    ("_hz", "Hz"), ("_us", "µs"), ("_m", "m"), ("_s", "s"), ("_v", "V"), ("_n", "N"), ("_w", "W"),
    ("_cells", "cells"),
)  # fmt: skip
"""Unit by the end of a key."""

_WORDS: dict[Any, str] = {
    float: "float",
    int: "integer",
    str: "text",
    bool: "true or false",
    Any: "anything",
}
_COMMON = {
    "source": "Where the numbers come from.",
    "type": "Which kind this is.",
    "shape": "Which kind this is.",
}
_LIMITS = {"gt": "> ", "ge": "≥ ", "lt": "< ", "le": "≤ "}


def page(kind: str) -> str:
    """The page of a kind of file, in Markdown."""
    title, head, models = _PAGES[kind]
    lines = [f"# {title}", "", "<!-- made by python -m angler_mjx.scenario.reference docs -->", ""]
    lines += [head, ""]
    for name, model in models:
        if name:
            lines += [f"# {name}", ""]
        seen: set[type] = set()
        for path, table in _tables("", model):
            if table not in seen:
                seen.add(table)
                lines += _section(path, table)
    return "\n".join(lines).rstrip() + "\n"


def _section(path: str, model: type[FileModel]) -> list[str]:
    heading = f"## `{path}`" if path else "## The file itself"
    lines = [heading, "", inspect.getdoc(model) or "", ""]
    meanings = _docstrings(model)
    lines += ["| key | type | unit | default | meaning |", "|---|---|---|---|---|"]
    for name, entry in model.model_fields.items():
        inner = next((model for model, _ in _models(entry.annotation, "")), None)
        said = meanings.get(name) or (
            inspect.getdoc(inner) or "" if inner else _COMMON.get(name, "")
        )
        meaning = " ".join(said.split("\n\n")[0].split())
        cells = [f"`{name}`", _type(entry), _unit(name), _default(entry), meaning]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return [*lines, ""]


def _tables(path: str, model: type[FileModel]) -> Iterator[tuple[str, type[FileModel]]]:
    """A model and those within it, by where they stand in a file."""
    yield path, model
    for name, entry in model.model_fields.items():
        here = f"{path}.{name}".lstrip(".")
        for inner, mark in _models(entry.annotation, ""):
            place = f"[[{here}]]" if mark == "[]" else f"[{here}]"
            kind = inner.model_fields.get("type") or inner.model_fields.get("shape")
            if kind is not None and _choices(kind.annotation):
                key = "type" if "type" in inner.model_fields else "shape"
                place += f" with {key} = {_choices(kind.annotation)}"
            under = f"{here}.NAME" if mark == "{}" else here
            if mark == "{}":
                place = f"[{under}]"
            for where, table in _tables(under, inner):
                yield (place if table is inner else where), table


def _models(annotation: Any, mark: str) -> Iterator[tuple[type[FileModel], str]]:
    """Models that an annotation holds; the mark says how: [] many in a row, {} by name."""
    annotation = _open(annotation)[0]
    if inspect.isclass(annotation) and issubclass(annotation, FileModel):
        yield annotation, mark
        return
    origin = get_origin(annotation)
    mark = {tuple: "[]", dict: "{}"}.get(origin, mark) if origin else mark
    for inner in get_args(annotation):
        yield from _models(inner, mark)


def _open(annotation: Any) -> tuple[Any, list[Any]]:
    """An annotation without its aliases, and what was said beside it."""
    beside: list[Any] = []
    while True:
        if isinstance(annotation, TypeAliasType):
            annotation = annotation.__value__
        elif hasattr(annotation, "__metadata__"):
            beside += annotation.__metadata__
            annotation = annotation.__origin__
        else:
            return annotation, beside


def _choices(annotation: Any) -> str:
    annotation = _open(annotation)[0]
    if get_origin(annotation) is not Literal:
        return ""
    values = get_args(annotation)
    return " or ".join(f'"{x}"' if isinstance(x, str) else str(x) for x in values)


def _type(entry: FieldInfo) -> str:
    return _describe(entry.annotation, entry.metadata)


def _describe(annotation: Any, beside: list[Any]) -> str:
    annotation, more = _open(annotation)
    beside = [*more, *beside]
    if any(isinstance(x, BeforeValidator) and x.func in _BEFORE for x in beside):
        return next(_BEFORE[x.func] for x in beside if getattr(x, "func", None) in _BEFORE)
    bounds = _bounds(beside)
    if choices := _choices(annotation):
        return choices
    if annotation in _WORDS:
        return f"{_WORDS[annotation]}{bounds}"
    if inspect.isclass(annotation) and issubclass(annotation, FileModel):
        return "table"
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        held = [_describe(x, []) for x in inner if x is not types.NoneType]
        return " or ".join(dict.fromkeys(held)) + bounds
    if origin is dict:
        return f"table of {_describe(inner[1], [])}"
    if inner[-1] is Ellipsis:
        return f"list of {_describe(inner[0], [])}{bounds}"
    return f"list of {len(inner)} {_describe(inner[0], [])}{bounds}"


_BEFORE = {
    checks.inertia: "list of 3, or 3 lists of 3 float",
    checks.added_mass: "list of 6, or 6 lists of 6 float",
}


def _bounds(beside: list[Any]) -> str:
    said = []
    beside = [x for one in beside for x in (one.metadata if isinstance(one, FieldInfo) else [one])]
    for one in beside:
        said += [f"{sign}{_number(getattr(one, name))}" for name, sign in _LIMITS.items()
                 if getattr(one, name, None) is not None]  # fmt: skip
        if getattr(one, "min_length", None):
            said.append(f"{one.min_length} or more long")
        if getattr(one, "max_length", None) is not None:
            said.append(f"at most {one.max_length} long")
        if getattr(one, "pattern", None):
            said.append(f"like `{one.pattern}`")
        if isinstance(one, AfterValidator):
            said += _AFTER.get(one.func, [])
    return f", {', '.join(said)}" if said else ""


_AFTER: dict[Any, list[str]] = {
    no_faster: [f"≤ {FASTEST_MPS:g} either way"],
    checks.positive: [f"{checks.SMALLEST:g} to {checks.LARGEST:g}"],
    checks.damping: ["six of them, none negative"],
    checks.unit_vector: ["a unit vector"],
}


def _number(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:g}"


def _unit(name: str) -> str:
    return next((unit for end, unit in _UNITS if name.endswith(end)), "")


def _default(entry: FieldInfo) -> str:
    if entry.is_required():
        return "required"
    default = entry.default
    if default is PydanticUndefined:
        default = entry.get_default(call_default_factory=True, validated_data={})
    if default is None or default in ((), {}):
        return "none"
    if isinstance(default, FileModel):
        return "its defaults"
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, tuple):
        return str(list(default))
    return f'"{default}"' if isinstance(default, str) else f"{default:g}"


def _docstrings(model: type[FileModel]) -> dict[str, str]:
    """What stands below each field of a model and of its bases."""
    found: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if not issubclass(base, FileModel) or base is FileModel:
            continue
        body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        assert isinstance(body, ast.ClassDef)
        for before, after in zip(body.body, body.body[1:], strict=False):
            if (
                isinstance(before, ast.AnnAssign)
                and isinstance(before.target, ast.Name)
                and isinstance(after, ast.Expr)
                and isinstance(after.value, ast.Constant)
            ):
                found[before.target.id] = str(after.value.value)
    return found


def main() -> None:
    """Write all pages into the folder that is named."""
    folder = Path(sys.argv[1])
    for kind in _PAGES:
        (folder / f"reference_{kind}.md").write_text(page(kind), encoding="utf-8")


if __name__ == "__main__":
    main()
