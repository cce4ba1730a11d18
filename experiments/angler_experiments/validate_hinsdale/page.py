"""Tables of the page on real water, from the study's committed results.

    python -m angler_experiments.validate_hinsdale.page docs/validation/hinsdale.json

``--fleet-sizes docs/fleet_size/survey_sets.json`` adds that of team sizes. A test finds
each table in ``docs/explanation/real_water.md`` as it is printed here.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypedDict

type Scores = Mapping[str, float | None]
type Held = Mapping[str, Mapping[str, Mapping[str, Mapping[str, float]]]]


class Horizons(TypedDict):
    """Errors after a few steps."""

    steps: list[int]
    errors: dict[str, dict[str, list[float]]]
    published: dict[str, list[float]]


class Identification(TypedDict):
    """Identified parameters and coverage."""

    parameters: dict[str, dict[str, float]]
    coverage: Held


class FleetSize(TypedDict):
    """Result of one size of a team."""

    size: int
    rate: float
    mean_s: dict[str, float]
    energy_j: float


class Condition(TypedDict):
    """Result of one condition of a fleet-size study."""

    name: str
    answer: dict[str, int]
    sizes: list[FleetSize]


class FleetSizes(TypedDict):
    """The part of a fleet-size study that the page has."""

    conditions: list[Condition]


class Results(TypedDict):
    """The part of the study's results that the page has."""

    medians: dict[str, dict[str, Scores]]
    better: dict[str, dict[str, int]]
    horizons: Horizons
    identification: Identification


NAMES = {
    "constant": "constant: each run's own mean",
    "persistence": "first second held: attitude and velocity",
    "balance": "balance of weights, quasi-static",
    "balance_from_start": "balance, from the first second's attitude",
    "balance_identified": "balance, from the first second's attitude, identified weights",
    "wu2018": "`wu2018`",
    "blue_gazebo": "`blue_gazebo`",
    "von_benzon2022": "`von_benzon2022`",
    "hinsdale2023_authors": "the authors' set-up",
    "hinsdale2023_identified": "`hinsdale2023_identified`",
    "constant_velocity": "velocity and rates held",
}
"""Names of predictions on the page."""


def format_tables(results: Results) -> dict[str, str]:
    """Return the page's tables in Markdown, by name."""
    return {
        "medians": format_medians(results),
        "coverage": format_coverage(results),
        "horizons": format_horizons(results),
        "parameters": format_parameters(results),
    }


def format_medians(results: Results) -> str:
    """Return medians of the test half, and on how many runs the identified set is better."""
    rows = []
    for name, scores in results["medians"]["test"].items():
        better = results["better"].get(name)
        of = f" of {better['runs']}" if better else ""
        counts = [
            f"{better[key]}{of}" if better and scores[key] is not None else "-"
            for key in ("roll", "pitch", "heave")
        ]
        values = [_number(scores[key], 4) for key in ("roll", "pitch", "heave")]
        rows.append([NAMES[name], *values, *counts])
    head = ["prediction", "roll, rad", "pitch, rad", "heave, m", "better in roll", "pitch", "heave"]
    return _table(head, rows)


def format_coverage(results: Results) -> str:
    """Return which fraction of the test half's recorded values the bands hold."""
    names = {
        "parameters_and_errors": "samples and errors of other runs",
        "parameters": "samples alone",
    }
    rows = [
        [label, f"{100 * float(level):.0f} %", *(f"{held[key]:.2f}" for key in _COVERED)]
        for name, label in names.items()
        for level, held in results["identification"]["coverage"][name]["test"].items()
    ]
    return _table(["fleet", "band", *_COVERED], rows)


_COVERED = ("roll", "pitch", "heave")


def format_horizons(results: Results) -> str:
    """Return errors after one, ten and a hundred steps, ours beside the published ones."""
    table = results["horizons"]
    rows = [
        [
            NAMES[name],
            *(f"{x:.4f}" for x in errors["states"]),
            *(f"{errors[key][-1]:.4f}" for key in ("position_m", "attitude_rad")),
        ]
        for name, errors in table["errors"].items()
    ]
    names = {
        "fossen_thrusters": "tank, thrusters on: Fossen's model",
        "double_integrator": "tank, thrusters on: double integrator",
    }
    rows += [
        [names[name], *(f"{x:.4f}" for x in errors), "-", "-"]
        for name, errors in table["published"].items()
    ]
    steps = [f"{n} {'step' if n == 1 else 'steps'}" for n in table["steps"]]
    return _table(["prediction", *steps, "position, m", "attitude, rad"], rows)


def format_fleet_sizes(study: FleetSizes) -> str:
    """Return the answers of a fleet-size study by parameter set."""
    rows = []
    for condition in study["conditions"]:
        answer = condition["answer"]
        sizes = {row["size"]: row for row in condition["sizes"]}
        six = sizes[_SHOWN_SIZES[1]]
        rows.append(
            [
                NAMES[condition["name"]],
                f"{answer['estimate']} ({answer['low']} to {answer['high']})",
                *(f"{sizes[n]['rate']:.2f}" for n in _SHOWN_SIZES),
                f"{six['mean_s']['mean']:.1f} s",
                f"{six['energy_j'] / 1000.0:.0f} kJ",
            ]
        )
    sizes_head = [f"{n} robots" for n in _SHOWN_SIZES]
    return _table(["parameter set", "smallest team", *sizes_head, "time", "energy"], rows)


_SHOWN_SIZES = (5, 6, 7)


def format_parameters(results: Results) -> str:
    """Return the identified parameters with deviations of posterior and prior."""
    rows = []
    for label, entry in results["identification"]["parameters"].items():
        ratio = entry["bootstrap_sd"] / entry["prior_sd"]
        numbers = [entry["value"], entry["bootstrap_sd"], entry["prior_sd"]]
        rows.append([label, *(f"{x:.3g}" for x in numbers), f"{ratio:.2f}"])
    return _table(["parameter", "change", "posterior", "prior", "posterior / prior"], rows)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def main() -> None:
    """Print the tables of the results of the command line."""
    parser = argparse.ArgumentParser(description="Tables of the page on real water.")
    parser.add_argument("results", type=Path, help="results.json of the study")
    parser.add_argument("--fleet-sizes", type=Path, help="study.json of docs/fleet_size")
    arguments = parser.parse_args()
    results: Results = json.loads(arguments.results.read_text())
    tables = [*format_tables(results).values()]
    if arguments.fleet_sizes is not None:
        tables.append(format_fleet_sizes(json.loads(arguments.fleet_sizes.read_text())))
    print("\n\n".join(tables))


if __name__ == "__main__":
    main()
