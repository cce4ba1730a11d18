"""Results of a spot check for the page, from the folder that it wrote.

    angler spotcheck runs/reef --episodes 8 --out runs/spot
    python -m angler_experiments.spotcheck_result runs/spot --json docs/validation/spotcheck.json

Needs no ArduSub: everything is in ``spotcheck.json`` and ``gaps.csv``.
"""

import csv
import json as json_text
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from angler_mjx.errors import ConfigError
from angler_mjx.testing.validation.results import StudyNumber, write_json

HEAD = ("flown by", "against", "same outcome", "track, m", "way, m", "endpoint, m")


def read_gaps(folder: Path) -> list[dict[str, str]]:
    """Read the rows of ``gaps.csv``: one for each robot, level and reference.

    Raises:
        ConfigError: the file does not exist, or has no rows.
    """
    path = folder / "gaps.csv"
    try:
        rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not rows:
        raise ConfigError(f"{path}: holds no flights; finish the spot check with --resume")
    return rows


def summarise_gaps(rows: list[dict[str, str]]) -> dict[tuple[str, str], dict[str, float]]:
    """Return by level and reference: robots, other outcomes, medians of the distances."""
    summaries = {}
    for pair in dict.fromkeys((row["level"], row["against"]) for row in rows):
        pair_rows = [row for row in rows if (row["level"], row["against"]) == pair]
        same_outcome = [row for row in pair_rows if row["outcome"] == row["other_outcome"]]
        sums = {
            "robots": float(len(pair_rows)),
            "other_outcome": float(len(pair_rows) - len(same_outcome)),
        }
        for name, selected in (
            ("track_rms_m", pair_rows),
            ("path_rms_m", pair_rows),
            ("endpoint_m", same_outcome),
        ):
            values = np.array([float(row[name]) for row in selected])
            median, quantile_90 = (
                np.nanquantile(values, [0.5, 0.9]) if values.size else (np.nan, np.nan)
            )
            sums |= {name: float(median), f"{name}_90": float(quantile_90)}
        summaries[pair] = sums
    return summaries


def to_markdown(sums: dict[tuple[str, str], dict[str, float]], autopilot: str) -> str:
    """Format the table and the meaning of its columns."""
    lines = [" | ".join(HEAD), " | ".join(["---", "---", *["---:"] * (len(HEAD) - 2)])]
    for (level, reference), summary in sums.items():
        n_same = summary["robots"] - summary["other_outcome"]
        cells = [level, reference, f"{n_same:.0f} of {summary['robots']:.0f}"]
        cells += [
            f"{summary[name]:.3f}, {summary[f'{name}_90']:.2f}"
            for name in ("track_rms_m", "path_rms_m", "endpoint_m")
        ]
        lines.append(" | ".join(cells))
    body = "\n".join(f"| {line} |" for line in lines)
    return (
        f"{body}\n\nArduSub {autopilot}. `recorded` is the batch run itself. Track is the root "
        "mean square distance of the two at the same time, way that to the other's way, endpoint "
        "lies between the places where those ended that ended alike; each median, and nine of ten "
        "below."
    )


def main(folder: Annotated[Path, tyro.conf.Positional], json: Path) -> None:
    """Write the results of a spot check for the page of `angler validate`.

    Args:
        folder: folder of the spot check.
        json: file for the result.
    """
    table = folder / "spotcheck.json"
    try:
        spotcheck = json_text.loads(table.read_text(encoding="utf-8"))
        origin, autopilot = spotcheck["provenance"], spotcheck["asked"]["ardusub"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{table}: is no table of a spot check ({error})") from error
    sums = summarise_gaps(read_gaps(folder))
    numbers = {}
    for (level, reference), summary in sums.items():
        name = f"{level}.{reference}"
        numbers[f"{name}.other_outcome"] = StudyNumber(
            value=summary["other_outcome"], unit="robots", worse="count"
        )
        numbers[f"{name}.track_median"] = StudyNumber(
            value=summary["track_rms_m"], unit="m", worse="behaviour"
        )
    written = datetime.fromtimestamp(table.stat().st_mtime, UTC)
    about_keys = ("versions", "python", "platform", "cpu_count", "backend", "device", "commit")
    about = {name: origin[name] for name in about_keys} | {"ardusub": True}
    about["at_utc"] = written.isoformat(timespec="seconds")
    result = {name: number.model_dump() for name, number in numbers.items()}
    text = to_markdown(sums, autopilot)
    write_json(json, {"about": about, "numbers": result, "text": text})
    print(text)


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except ConfigError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
