"""Reference of the files that users write, generated from the models that check them.

``python -m angler_mjx.cli.reference docs/generated`` writes the pages; a test compares them with
the models.
"""

import ast
import inspect
import sys
import textwrap
import types
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAliasType, Union, get_args, get_origin

from pydantic import AfterValidator, BeforeValidator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from angler_mjx.files import FileModel
from angler_mjx.learning.datasets.config import DatasetConfig
from angler_mjx.quantities import MAX_SPEED_MPS, check_speed
from angler_mjx.robot.vehicles import checks
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.thruster_config import ThrusterTable
from angler_mjx.scenario.editing import Changes
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.studies.benchmark.config import BenchmarkConfig
from angler_mjx.studies.fleet_size.config import FleetSizeConfig

_COMMAND = "python -m angler_mjx.cli.reference docs/generated"

PAGES: dict[str, tuple[str, str, tuple[tuple[str, type[FileModel]], ...]]] = {
    "scenario": (
        "Scenario files",
        "A scenario is a TOML file. `angler scenarios show reef_fleet` prints one to begin with. "
        "Types are strict: a whole number will do for a float, but neither text nor `true` for a "
        "number. Keys that are not here are refused. Paths begin at the folder of the file.\n\n"
        "A vehicle flies paths with thrust in surge, heave and yaw, each without the others; where "
        "it has no sway (less than a tenth of surge) controllers turn its bow to where it must go, "
        "and the controller `ardusub` is refused. Fins that turn it in pitch and yaw stand in for "
        "heave and yaw, with the controller `los`. A planar vehicle needs no heave, and water one "
        "cell high (`world.shape = [x, y, 1]`). A vehicle that lacks more is refused by name.",
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
    "study": (
        "Study files",
        "A study file is TOML: a benchmark of planners (`angler benchmark`, "
        "`docs/how_to/benchmark.md`), or a search for the smallest team (`angler study "
        "fleet_size`, `docs/how_to/fleet_size.md`). Those that ship are in "
        "`angler_mjx/studies/benchmark/shipped/` and `angler_mjx/studies/fleet_size/shipped/`. "
        "Sweeps, tunings and trials take flags instead of a file. Types are strict, and keys that "
        "are not here are refused. Paths begin at the folder of the file. Scenario keys are those "
        "of a scenario file (`docs/generated/scenario.md`), in nested tables or dotted.",
        (("Benchmark file", BenchmarkConfig), ("Fleet-size file", FleetSizeConfig)),
    ),
    "dataset": (
        "Dataset requests",
        "A dataset is requested by a TOML file (`angler dataset make`, "
        "`docs/how_to/datasets.md`). Those that ship are in "
        "`angler_mjx/learning/datasets/shipped/`. Types are strict, and keys that are not here "
        "are refused. Paths begin at the folder of the file. Scenario keys are those of a "
        "scenario file (`docs/generated/scenario.md`), in nested tables or dotted. Files of the "
        "finished dataset: `docs/reference/dataset_files.md`.",
        (("", DatasetConfig),),
    ),
}
"""Title, text, and headings and models of each page, by the name of its file."""

_UNITS = (
    ("_mps3_per_rthz", "m/s³/√Hz"), ("_radps2_per_rthz", "rad/s²/√Hz"),
    ("_mps2_per_rthz", "m/s²/√Hz"), ("_radps_per_rthz", "rad/s/√Hz"), ("_kgpm3", "kg/m³"),
    ("_kgm2", "kg m²"), ("_radps", "rad/s"), ("_mps2", "m/s²"), ("_mps", "m/s"), ("_m3", "m³"),
    ("_percent_of_speed", "%"), ("_percent_of_range", "%"), ("_deg", "°"), ("_kg", "kg"),
    ("_db_per_m", "dB/m"), ("_khz", "kHz"), ("_db", "dB"), ("_bps", "bit/s"),
    ("_hz", "Hz"), ("_us", "µs"), ("_m", "m"), ("_s", "s"), ("_v", "V"), ("_n", "N"), ("_w", "W"),
    ("_cells", "cells"), ("_minutes", "min"),
)  # fmt: skip
"""Unit by the suffix of a key."""

_TYPE_NAMES: dict[object, str] = {
    float: "float",
    int: "integer",
    str: "text",
    bool: "true or false",
    object: "anything",
    Any: "anything",
}
_COMMON_MEANINGS = {
    "source": "Where the numbers come from.",
    "type": "Which kind this is.",
    "shape": "Which kind this is.",
}
_BOUND_SIGNS = {"gt": "> ", "ge": "≥ ", "lt": "< ", "le": "≤ "}


def format_page(kind: str) -> str:
    """Return the reference page of a kind of file, in Markdown."""
    title, head, models = PAGES[kind]
    lines = [f"<!-- generated by {_COMMAND} -->", "", f"# {title}", ""]
    lines += [head, ""]
    for name, model in models:
        if name:
            lines += [f"# {name}", ""]
        seen: set[type] = set()
        for path, table in _nested_tables("", model):
            if table not in seen:
                seen.add(table)
                lines += _format_section(path, table)
    return "\n".join(lines).rstrip() + "\n"


def _format_section(path: str, model: type[FileModel]) -> list[str]:
    heading = f"## `{path}`" if path else "## The file itself"
    lines = [heading, "", inspect.getdoc(model) or "", ""]
    meanings = _field_docstrings(model)
    lines += ["| key | type | unit | default | meaning |", "|---|---|---|---|---|"]
    for name, entry in model.model_fields.items():
        inner = next((model for model, _ in _nested_models(entry.annotation, "")), None)
        text = meanings.get(name) or (
            inspect.getdoc(inner) or "" if inner else _COMMON_MEANINGS.get(name, "")
        )
        meaning = " ".join(text.split("\n\n")[0].split())
        key = entry.alias or name
        cells = [f"`{key}`", _format_type(entry), _unit_of(key), _format_default(entry), meaning]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return [*lines, ""]


def _nested_tables(path: str, model: type[FileModel]) -> Iterator[tuple[str, type[FileModel]]]:
    """Yield a model and its nested models, with their headings in a file."""
    yield path, model
    for name, entry in model.model_fields.items():
        key_path = f"{path}.{name}".lstrip(".")
        for inner, mark in _nested_models(entry.annotation, ""):
            heading = f"[[{key_path}]]" if mark == "[]" else f"[{key_path}]"
            kind = inner.model_fields.get("type") or inner.model_fields.get("shape")
            if kind is not None and _format_choices(kind.annotation):
                key = "type" if "type" in inner.model_fields else "shape"
                heading += f" with {key} = {_format_choices(kind.annotation)}"
            inner_path = f"{key_path}.NAME" if mark == "{}" else key_path
            if mark == "{}":
                heading = f"[{inner_path}]"
            for inner_heading, table in _nested_tables(inner_path, inner):
                yield (heading if table is inner else inner_heading), table


def _nested_models(annotation: object, mark: str) -> Iterator[tuple[type[FileModel], str]]:
    """Yield the models in an annotation; the mark gives their container: [] list, {} by name."""
    annotation = _unwrap_annotation(annotation)[0]
    if inspect.isclass(annotation) and issubclass(annotation, FileModel):
        yield annotation, mark
        return
    origin = get_origin(annotation)
    mark = {tuple: "[]", dict: "{}"}.get(origin, mark) if origin else mark
    for inner in get_args(annotation):
        yield from _nested_models(inner, mark)


def _unwrap_annotation(annotation: object) -> tuple[object, list[object]]:
    """Return an annotation without its aliases, and its metadata."""
    metadata: list[object] = []
    while True:
        if isinstance(annotation, TypeAliasType):
            annotation = annotation.__value__
        elif get_origin(annotation) is Annotated:
            annotation, *more = get_args(annotation)
            metadata += more
        else:
            return annotation, metadata


def _format_choices(annotation: object) -> str:
    annotation = _unwrap_annotation(annotation)[0]
    if get_origin(annotation) is not Literal:
        return ""
    values = get_args(annotation)
    return " or ".join(f'"{x}"' if isinstance(x, str) else str(x) for x in values)


def _format_type(entry: FieldInfo) -> str:
    return _describe_type(entry.annotation, entry.metadata)


def _describe_type(annotation: object, metadata: Sequence[object]) -> str:
    if annotation is Changes:
        return "table of scenario keys"
    annotation, alias_metadata = _unwrap_annotation(annotation)
    metadata = [*alias_metadata, *metadata]
    for x in metadata:
        if isinstance(x, BeforeValidator) and x.func in _BEFORE_VALIDATOR_TYPES:
            return _BEFORE_VALIDATOR_TYPES[x.func]
    bounds = _format_bounds(metadata)
    if choices := _format_choices(annotation):
        return choices
    if annotation in _TYPE_NAMES:
        return f"{_TYPE_NAMES[annotation]}{bounds}"
    if inspect.isclass(annotation) and issubclass(annotation, FileModel):
        return "table"
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        inner_types = [_describe_type(x, []) for x in inner if x is not types.NoneType]
        return " or ".join(dict.fromkeys(inner_types)) + bounds
    if origin is dict:
        keys = _format_choices(inner[0])
        return f"table of {_describe_type(inner[1], [])}" + (f" by {keys}" if keys else "")
    if inner[-1] is Ellipsis:
        return f"list of {_describe_type(inner[0], [])}{bounds}"
    return f"list of {len(inner)} {_describe_type(inner[0], [])}{bounds}"


_BEFORE_VALIDATOR_TYPES = {
    checks.check_inertia: "list of 3, or 3 lists of 3 float",
    checks.check_added_mass: "list of 6, or 6 lists of 6 float",
}


def _format_bounds(metadata: Sequence[object]) -> str:
    bounds = []
    metadata = [
        x
        for constraint in metadata
        for x in (constraint.metadata if isinstance(constraint, FieldInfo) else [constraint])
    ]
    for constraint in metadata:
        for name, sign in _BOUND_SIGNS.items():
            bound = getattr(constraint, name, None)
            if bound is not None:
                bounds.append(f"{sign}{_format_number(bound)}")
        if min_length := getattr(constraint, "min_length", None):
            bounds.append(f"{min_length} or more long")
        if (max_length := getattr(constraint, "max_length", None)) is not None:
            bounds.append(f"at most {max_length} long")
        if pattern := getattr(constraint, "pattern", None):
            bounds.append(f"like `{pattern}`")
        if isinstance(constraint, AfterValidator):
            bounds += _AFTER_VALIDATOR_BOUNDS.get(constraint.func, [])
    return f", {', '.join(bounds)}" if bounds else ""


_AFTER_VALIDATOR_BOUNDS: dict[object, list[str]] = {
    check_speed: [f"≤ {MAX_SPEED_MPS:g} either way"],
    checks.check_positive: [f"{checks.SMALLEST:g} to {checks.LARGEST:g}"],
    checks.check_damping: ["six of them, none negative"],
    checks.check_unit_vector: ["a unit vector"],
}


def _format_number(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:g}"


def _unit_of(name: str) -> str:
    return next((unit for end, unit in _UNITS if name.endswith(end)), "")


def _format_default(entry: FieldInfo) -> str:
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


def _field_docstrings(model: type[FileModel]) -> dict[str, str]:
    """Return the docstrings below the fields of a model and of its bases."""
    docstrings: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if not issubclass(base, FileModel) or base is FileModel:
            continue
        body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        assert isinstance(body, ast.ClassDef)
        for statement, next_statement in zip(body.body, body.body[1:], strict=False):
            if (
                isinstance(statement, ast.AnnAssign)
                and isinstance(statement.target, ast.Name)
                and isinstance(next_statement, ast.Expr)
                and isinstance(next_statement.value, ast.Constant)
            ):
                docstrings[statement.target.id] = str(next_statement.value.value)
    return docstrings


def main() -> None:
    """Write all pages into the folder given as argument."""
    folder = Path(sys.argv[1])
    for kind in PAGES:
        (folder / f"{kind}.md").write_text(format_page(kind), encoding="utf-8")


if __name__ == "__main__":
    main()
