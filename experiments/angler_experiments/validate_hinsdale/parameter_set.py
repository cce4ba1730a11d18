"""The identified set and its uncertainty, written into a vehicle file from the study's results.

    python -m angler_experiments.validate_hinsdale.parameter_set results.json VEHICLE.toml ...

The set replaces that of the same name at the end of each file, ``bluerov2_heavy`` or
``bluerov2_heavy_alpha5``. What the campaign's vehicle alone had is left out: the zeros of its
joints, the yaw of its markers, and its trim, as vehicles lie level with their arm at home.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from angler_experiments.validate_hinsdale.parameters import LABELS, SPREAD, apply_parameters
from angler_experiments.validate_hinsdale.vehicle import (
    FILE,
    MASS_KG,
    SOURCE_SET,
    WATER,
    CampaignVehicle,
    build_campaign_vehicle,
    extra_bodies,
)
from angler_mjx.files import JsonTable, JsonValue
from angler_mjx.robot.vehicles.library import load_vehicle
from angler_mjx.robot.vehicles.link_motion import locate_links
from angler_mjx.robot.vehicles.links import WaterCylinder
from angler_mjx.robot.vehicles.params import build_vehicle

type Array = np.ndarray
type Numbers = dict[str, Array]

NAME = "hinsdale2023_identified"
BASE_FILE = "bluerov2_heavy"
DRY_SET = "wu2018"
"""Set with the dry inertia of the base: the data tell its sum with the added one alone."""
LINKS = ("arm_base", "shoulder", "upper_arm", "elbow", "wrist", "jaws")
FRESH_KGPM3 = 1000.0
"""Density for which vehicles of files lie level."""
SOURCE = "Hinsdale campaign of 2023 (hkolano/UVMS-SysID-with-EAs), docs/explanation/real_water.md"
_MASSES = ("link_mass.upper_arm", "link_mass.wrist", "link_mass.jaws")


class Posterior(NamedTuple):
    """Identified parameters, standardised."""

    vector: Array
    """[k]."""
    samples: Array
    """[sample, k] by bootstrap."""


class SetNumbers(NamedTuple):
    """Numbers of the set of one vehicle file, by the keys of `Uncertainty`."""

    numbers: Numbers
    """Of the identified vector."""
    deviations: Numbers
    """Standard deviations of the same shapes, of logarithms where factors are meant."""
    correlation: Array
    """[k, k] in the order of ``numbers``."""


def read_posterior(results: Path) -> Posterior:
    """Return the posterior of the study's results."""
    identification = json.loads(results.read_text())["identification"]
    value = [identification["parameters"][label]["value"] for label in LABELS]
    spread = np.array(SPREAD)
    return Posterior(np.array(value) / spread, np.array(identification["samples"]) / spread)


def describe_set(posterior: Posterior, file: str) -> SetNumbers:
    """Return the numbers of the set of a vehicle file with their spread.

    The added inertia is what is left of the identified sum of both. It is log-normal by its
    moments, as samples of a difference can be negative.
    """
    source = build_campaign_vehicle(SOURCE_SET)

    def numbers(vector: jax.Array) -> dict[str, jax.Array]:
        return _set_numbers(apply_parameters(source, vector), file)

    best = {key: np.asarray(x, float) for key, x in numbers(jnp.asarray(posterior.vector)).items()}
    sampled = jax.vmap(numbers)(jnp.asarray(posterior.samples))
    columns, deviations = [], {}
    for key, value in best.items():
        samples = np.asarray(sampled[key], float).reshape(len(posterior.samples), -1)
        flat = samples if key in ("center_of_buoyancy_m", "volume_m3") else np.log(samples)
        spread = flat.std(axis=0)
        if key == "added_mass":
            flat[:, 3:] = samples[:, 3:]
            ratio = samples[:, 3:].std(axis=0) / value[3:]
            spread[3:] = np.sqrt(np.log1p(ratio**2))
        columns.append(flat)
        deviations[key] = spread.reshape(value.shape)
    return SetNumbers(best, deviations, np.corrcoef(np.hstack(columns).T))


def _set_numbers(vehicle: CampaignVehicle, file: str) -> dict[str, jax.Array]:
    """Return the numbers of a file's set for a vehicle of the campaign, by uncertain key."""
    params, extras = vehicle.params, extra_bodies(MASS_KG)
    dry = load_vehicle(BASE_FILE).find_set(DRY_SET).rigid_body.inertia_kgm2
    base = jnp.diag(jnp.asarray(dry) + extras.inertia_kgm2)
    total = jnp.diag(params.inertia_kgm2) + jnp.diag(params.M_A)[3:]
    find_hull = _hull_with_arm if file == FILE else _hull_without_extras
    volume, center = find_hull(vehicle)
    numbers = {
        "center_of_buoyancy_m": center,
        "volume_m3": volume,
        "added_mass": jnp.append(jnp.diag(params.M_A)[:3], total - base),
        "linear_damping": params.D_l,
        "quadratic_damping": params.D_q,
    }
    if file != FILE:
        return numbers
    links = vehicle.links
    plain = build_campaign_vehicle(SOURCE_SET).links
    scaled = (
        (links.added_volume, plain.added_volume),
        (links.normal_area_m2, plain.normal_area_m2),
    )
    added, drag = (a.ravel()[jnp.argmax(b)] / b.max() for a, b in scaled)
    masses = {key: links.mass_kg[LINKS.index(key.rpartition(".")[2])] for key in _MASSES}
    return {**numbers, "link_added_mass": added, "link_drag": drag, **masses}


def _hull_with_arm(vehicle: CampaignVehicle) -> tuple[jax.Array, jax.Array]:
    """Return volume [] and centre of buoyancy [3] of the base with extras.

    The arm of the file hangs where the centre of mass without extras is; the centre of buoyancy
    takes the difference, so that the moments of weight and buoyancy stay.
    """
    params, links = vehicle.params, vehicle.links
    net_kg = jnp.sum(WATER.density_kgpm3 * links.volume_m3 - links.mass_kg)
    shift = net_kg * extra_bodies(MASS_KG).center_of_mass_m / WATER.density_kgpm3
    return params.volume_m3, params.p_cb_m - shift / params.volume_m3


def _hull_without_extras(vehicle: CampaignVehicle) -> tuple[jax.Array, jax.Array]:
    """Return volume [] and centre of buoyancy [3] of the base alone."""
    params, extras = vehicle.params, extra_bodies(MASS_KG)
    volume = params.volume_m3 - extras.volume_m3.sum()
    first = params.volume_m3 * (params.p_cb_m + extras.center_of_mass_m)
    return volume, (first - extras.volume_m3 @ extras.position_m) / volume


def set_tables(numbers: SetNumbers, file: str) -> dict[str, JsonTable]:
    """Return the tables of the set in a vehicle file, by their path below the set's name."""
    parts = "with the campaign's ballast, foam and velocity log" if file == FILE else "bare vehicle"
    tables: dict[str, JsonTable] = {
        "": {
            "description": "Identified from motion capture of a drifting vehicle whose arm moves, "
            f"with its uncertainty; {parts}. Surge, sway and yaw are hardly told by the data"
        },
        "rigid_body": _body_table(file, parts),
        **_water_tables(numbers, file),
    }
    if file == FILE:
        tables |= _link_tables(numbers)
    return {**tables, "uncertainty": _uncertainty_table(numbers)}


def _body_table(file: str, parts: str) -> JsonTable:
    """Return mass and dry inertia, which are not identified."""
    extras = extra_bodies(MASS_KG)
    dry = np.array(load_vehicle(BASE_FILE).find_set(DRY_SET).rigid_body.inertia_kgm2)
    source = f"{SOURCE}: mass of the authors, {parts}, not identified; inertia of {DRY_SET}"
    end = ": the data tell its sum with the added one"
    if file != FILE:
        return {
            "mass_kg": MASS_KG,
            "inertia_kgm2": _rows(np.diag(dry)),
            "source": source + end,
        }
    return {
        "mass_kg": _number(MASS_KG + extras.mass_kg.sum()),
        "inertia_kgm2": _rows(dry + extras.inertia_kgm2),
        "source": f"{source} and those parts{end}",
    }


def _water_tables(numbers: SetNumbers, file: str) -> dict[str, JsonTable]:
    """Return buoyancy, added mass and damping."""
    value = numbers.numbers
    horizontal = _level_center(numbers) if file == FILE else [0.0, 0.0]
    trim = "with the arm at home" if file == FILE else "by trim"
    return {
        "buoyancy": {
            "volume_m3": _number(value["volume_m3"]),
            "center_of_buoyancy_m": [*horizontal, _number(value["center_of_buoyancy_m"][2])],
            "source": f"{SOURCE}: volume and height identified; level {trim}, our choice",
        },
        "added_mass": {"coefficients": _rows(value["added_mass"]), "source": SOURCE},
        "damping": {
            "linear": _rows(value["linear_damping"]),
            "quadratic": _rows(value["quadratic_damping"]),
            "source": f"{SOURCE}; priors about those of {DRY_SET}",
        },
    }


def _level_center(numbers: SetNumbers) -> list[float]:
    """Return the horizontal centre of buoyancy [2] m at which the arm at home is balanced."""
    links = _identified_links(numbers)
    file = build_vehicle(load_vehicle(FILE), DRY_SET, 16.0).links
    if file is None:
        raise ValueError(f"{FILE}: no links")
    poses = locate_links(file, file.home)
    rotation, origin = np.asarray(poses.rotation, float), np.asarray(poses.origin, float)
    moment = sum(
        FRESH_KGPM3 * row["volume"] * (rotation[i] @ row["buoyancy"] + origin[i])
        - row["mass"] * (rotation[i] @ row["center"] + origin[i])
        for i, row in enumerate(links)
    )
    center = -np.asarray(moment)[:2] / (FRESH_KGPM3 * numbers.numbers["volume_m3"])
    return [_number(x, 6) for x in center]


def _identified_links(numbers: SetNumbers) -> list[Numbers]:
    """Return mass, volume and centres of the authors' links, masses as identified."""
    plain = build_campaign_vehicle(SOURCE_SET).links
    fields = {
        "mass": plain.mass_kg,
        "volume": plain.volume_m3,
        "center": plain.center_of_mass_m,
        "buoyancy": plain.center_of_buoyancy_m,
    }
    rows = [{key: np.asarray(x[i], float) for key, x in fields.items()} for i in range(len(LINKS))]
    for i, name in enumerate(LINKS):
        rows[i]["mass"] = numbers.numbers.get(f"link_mass.{name}", rows[i]["mass"])
    return rows


def _link_tables(numbers: SetNumbers) -> dict[str, JsonTable]:
    """Return the tables of the links: the authors' arm with identified masses and water."""
    shipped = {link.name: link for link in load_vehicle(FILE).links}
    tables: dict[str, JsonTable] = {}
    for name, row in zip(LINKS, _identified_links(numbers), strict=True):
        is_fitted = f"link_mass.{name}" in numbers.numbers
        origin = f"{SOURCE}: {'identified about the authors' if is_fitted else 'the authors'}' arm"
        tables[f"links.{name}.rigid_body"] = {
            "mass_kg": _number(row["mass"]),
            "center_of_mass_m": _rows(row["center"]),
            "inertia_kgm2": _rows(np.array(shipped[name].rigid_body.inertia_kgm2)),
            "source": f"{origin}; inertia of the table of the link",
        }
        tables[f"links.{name}.buoyancy"] = {
            "volume_m3": _number(row["volume"]),
            "center_of_buoyancy_m": _rows(row["buoyancy"]),
            "source": f"{SOURCE}: the authors' arm",
        }
        tables[f"links.{name}.water"] = {
            "cylinders": [
                _cylinder_table(cylinder, numbers) for cylinder in shipped[name].water.cylinders
            ],
            "source": f"{SOURCE}: the table of the link times identified factors",
        }
    return tables


def _cylinder_table(cylinder: WaterCylinder, numbers: SetNumbers) -> JsonTable:
    """Return a cylinder with its coefficients times the identified factors."""
    drag, added = (float(numbers.numbers[key]) for key in ("link_drag", "link_added_mass"))
    return {
        "from_m": list(cylinder.from_m),
        "to_m": list(cylinder.to_m),
        "radius_m": cylinder.radius_m,
        "normal_drag": _number(drag * cylinder.normal_drag),
        "axial_drag": _number(drag * cylinder.axial_drag),
        "added_mass": _number(added * cylinder.added_mass),
    }


def _uncertainty_table(numbers: SetNumbers) -> JsonTable:
    """Return the table of standard deviations and correlation."""
    table: JsonTable = {}
    masses: JsonTable = {}
    for key, spread in numbers.deviations.items():
        if key.startswith("link_mass."):
            masses[key.rpartition(".")[2]] = _number(spread, 4)
        else:
            table[key] = _rows(spread, 4) if spread.ndim else _number(spread, 4)
    if masses:
        table["link_mass"] = masses
    correlation = np.round(numbers.correlation, 3) + 0.0
    np.fill_diagonal(correlation, 1.0)
    table["correlation"] = correlation.tolist()
    table["source"] = (
        f"{SOURCE}: bootstrap over training runs, with samples of the prior; what the data do not "
        "tell spreads as the prior, which is our choice"
    )
    return table


def _number(value: float | Array, digits: int = 5) -> float:
    """Return a number [] with so many significant digits."""
    return float(f"{float(value):.{digits}g}")


def _rows(values: Array, digits: int = 5) -> list[JsonValue]:
    """Return an array of one or two dimensions as lists of numbers with so many digits."""
    if values.ndim == 2:
        return [_rows(row, digits) for row in values]
    return [_number(entry, digits) for entry in values]


def format_toml(tables: Mapping[str, JsonTable]) -> str:
    """Return the tables of a set as TOML."""
    lines = []
    for path, table in tables.items():
        head = ".".join(["parameter_sets", NAME, *([path] if path else [])])
        lines += ["", f"[{head}]", *(f"{key} = {_toml(x)}" for key, x in table.items())]
    return "\n".join(lines).lstrip("\n") + "\n"


def _toml(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(x)}" for key, x in value.items()) + " }"
    if isinstance(value, list) and value and isinstance(value[0], list | dict):
        return "[\n" + "".join(f"  {_toml(row)},\n" for row in value) + "]"
    return json.dumps(value)


def write_set(results: Path, vehicle_file: Path) -> None:
    """Write the set at the end of a vehicle file, in place of one of that name."""
    text = vehicle_file.read_text(encoding="utf-8")
    head = text.partition(f"\n[parameter_sets.{NAME}]")[0].rstrip("\n")
    numbers = describe_set(read_posterior(results), vehicle_file.stem)
    block = format_toml(set_tables(numbers, vehicle_file.stem))
    vehicle_file.write_text(f"{head}\n\n{block}", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the set into the vehicle files of the command line."""
    parser = argparse.ArgumentParser(description="Write the identified set into vehicle files.")
    parser.add_argument("results", type=Path, help="results.json of the study")
    parser.add_argument("vehicles", type=Path, nargs="+", help="files with the name of a vehicle")
    chosen = parser.parse_args(arguments)
    for path in chosen.vehicles:
        write_set(chosen.results, path)


if __name__ == "__main__":
    main()
