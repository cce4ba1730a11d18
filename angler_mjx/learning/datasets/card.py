"""Card of a dataset for people and machines: ``README.md`` and ``croissant.json``."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from angler_mjx.errors import format_bytes
from angler_mjx.learning.datasets import croissant, figures, gaps
from angler_mjx.learning.datasets.manifest import INDEX, SPLITS, Manifest
from angler_mjx.learning.datasets.sampling import DIFFICULTIES, FAILED, is_kind
from angler_mjx.runs.multi_run import RUNS_FOLDER
from angler_mjx.runs.storage import atomic_files, folder, results
from angler_mjx.runs.storage.atomic_files import write_json

README, CROISSANT = "README.md", "croissant.json"


def write_card(root: Path, manifest: Manifest, table: pa.Table) -> None:
    """Write both files and the figures of a dataset's folder.

    Args:
        root: folder of the dataset.
        manifest: its manifest; the sums are ignored.
        table: its index.

    Raises:
        ConfigError: a run is damaged.
        RunError: a figure cannot be written.
        OSError: writing failed.
    """
    figures.plot_figures(root, manifest, table)
    write_readme(root, manifest, table)
    write_json(root / CROISSANT, croissant.build_metadata(root, manifest))


def write_readme(root: Path, manifest: Manifest, table: pa.Table) -> None:
    """Write the card alone, with links to files that exist in the folder.

    Raises:
        ConfigError: a run or the spot check is damaged.
        OSError: writing failed.
    """
    card_text = format_card(
        manifest,
        table,
        _count_outcomes(root, manifest),
        _count_bytes(root),
        randomised=_describe_randomisation(root, manifest),
        spotcheck=gaps.format_spot_check(gaps.read_spot_check(root)),
    )
    atomic_files.write_text(root / README, card_text)


def _count_outcomes(root: Path, manifest: Manifest) -> dict[str, Counter[str]]:
    """Count the outcomes of robots, by scene and expert."""
    outcomes: dict[str, Counter[str]] = {}
    for part in manifest.parts:
        ended = folder.Run(root / part.path).episodes["outcome"].to_pylist()
        outcomes.setdefault(f"{part.scene}, {part.expert}", Counter()).update(ended)
    return outcomes


def _describe_randomisation(root: Path, manifest: Manifest) -> list[str]:
    """List the randomised properties of robots, water and instruments, by scene; empty if none."""
    scenes: dict[str, str] = {}
    for part in manifest.parts:
        randomisation = folder.Run(root / part.path).scenario.randomise
        if randomisation.changes_vehicles or randomisation.changes_worlds:
            table = randomisation.model_dump(mode="json", exclude_defaults=True)
            scenes[part.scene] = "; ".join(f"`{key}` {value}" for key, value in table.items())
    if not scenes:
        return []
    return [
        "## Randomisation",
        "",
        "Factors on the values of the files, low and high; `variants.json` of each run folder has "
        "those of every variant, `episodes.parquet` the variant of each robot and the factors of "
        "its world.",
        "",
        *[f"- {scene}: {factors}" for scene, factors in scenes.items()],
        "",
    ]


def _count_bytes(root: Path) -> int:
    """Count the bytes of the run folders; descriptions are written later."""
    return sum(path.stat().st_size for path in (root / RUNS_FOLDER).rglob("*") if path.is_file())


def format_card(
    manifest: Manifest,
    table: pa.Table,
    outcomes: dict[str, Counter[str]],
    n_byte: int,
    *,
    randomised: Sequence[str],
    spotcheck: Sequence[str],
) -> str:
    """Return the text of the card.

    Args:
        manifest: manifest of the dataset.
        table: its index.
        outcomes: number of robots by outcome, by scene and expert.
        n_byte: bytes of its run folders.
        randomised: lines on how robots differ from their files.
        spotcheck: lines on the spot check with real autopilots.
    """
    robots = pc.sum(table["robots"]).as_py()
    hours = pc.sum(pc.multiply(table["duration_s"], pc.cast(table["robots"], pa.float32())))
    environment = manifest.environment
    lines = [
        *_format_hub_fields(manifest),
        "",
        f"# {manifest.name}",
        "",
        *([manifest.description, ""] if manifest.description else []),
        f"{manifest.episodes:,} flights of teams of underwater robots, {robots:,} robots and "
        f"{hours.as_py() / 3600:,.0f} robot-hours at {manifest.time['record_hz']:g} Hz; "
        f"{format_bytes(n_byte)}, {format_bytes(n_byte / manifest.episodes)} an episode. Made by "
        f"`{manifest.command}` with angler-mjx {environment['versions'].get('angler-mjx')} on "
        f"{environment['device']} ({manifest.created}).",
        "",
        "Simulated, not measured at sea. Failed robots are included and labelled: state for "
        "each training whether it uses all episodes, or `success` alone.",
        "",
        "## Read it",
        "",
        "```python",
        "from angler_mjx.learning import datasets",
        "",
        'train = datasets.open("PATH", split="train")',
        "episode = train.episode(0)",
        "```",
        "",
        "Without this package: `index.parquet` has a row an episode; `runs/*/trajectories.zarr` "
        "are Zarr v3 groups (xarray opens them; arrays stored in steps need `pip install "
        "'zarr[cast-value-rs]>=3.4'`), `runs/*/episodes.parquet` has a row a robot. "
        "`sha256sum -c sha256sums.txt` and `angler dataset verify PATH` judge it.",
        "",
        "## Splits",
        "",
        "By environment: the hash of the rock decides, so no rock of one split is in another, in "
        "this or in any other dataset of the same fractions. `test_...` are shifted: `train` has "
        "no scenes like them.",
        "",
        *_format_split_table(table),
        "",
        f"![Counts]({figures.COUNTS_FILE})",
        "",
        *_format_sample_table(manifest, table),
        "## Experts and outcomes",
        "",
        *_format_outcome_table(outcomes),
        "",
        *randomised,
        "## How hard",
        "",
        "`trivial`: every straight line is free and none passes another within 1.5 m; `crossing`: "
        "some do; `blocked`: rock alone is in the way.",
        "",
        *_format_counts(table, "difficulty"),
        "",
        f"![Lengths, times and clearances]({figures.LENGTHS_FILE})",
        "",
        f"![Some flights from above]({figures.FLIGHTS_FILE})",
        "",
        "## On real autopilots",
        "",
        *spotcheck,
        "",
        "## Conventions",
        "",
        *[f"- {key.replace('_', ' ')}: {value}" for key, value in manifest.conventions.items()],
        "",
        "| array | of | unit | stored | description |",
        "|---|---|---|---|---|",
        *[
            f"| `{name}` | {', '.join(entry.dims)} | {entry.unit} | "
            f"{f'in steps of {entry.step:g}' if entry.step else entry.dtype} | "
            f"{entry.description} |"
            for name, entry in manifest.arrays.items()
        ],
        "",
        "## Parts",
        "",
        "| run folder | split | seed | worlds |",
        "|---|---|---|---|",
        *[
            f"| `{part.path}` | {part.split or 'by environment'} | {part.seed} | {part.worlds:,} |"
            for part in manifest.parts
        ],
        "",
        "## Limits",
        "",
        "- The same tile, kernels, kind of device and versions make the same bytes again; others "
        "make flights that part from these as chaotic motion does.",
        "- Contacts end a robot's episode; the dataset has no data after them.",
        "",
    ]
    return "\n".join(lines)


def _format_hub_fields(manifest: Manifest) -> list[str]:
    """Return the head of the card, in YAML, by which hubs of datasets list and preview it."""
    powers = [10**power for power in range(3, 10)]
    below = next((power for power in powers if manifest.episodes < power), powers[-1])
    size = "n<1K" if below == 1000 else f"{_format_power(below // 10)}<n<{_format_power(below)}"
    return [
        "---",
        f"license: {manifest.licence.lower()}",
        f"pretty_name: {manifest.name}",
        f"size_categories: [{size}]",
        "task_categories: [robotics]",
        "tags: [robotics, motion-planning, underwater, multi-robot, simulation]",
        "configs:",
        "- config_name: episodes",
        "  data_files:",
        "  - split: episodes",
        f"    path: {INDEX}",
        "---",
    ]


def _format_power(number: int) -> str:
    """Return a power of ten as 10K or 1M."""
    units = ((10**9, "B"), (10**6, "M"), (10**3, "K"))
    return next(f"{number // unit}{letter}" for unit, letter in units if number >= unit)


def _format_split_table(table: pa.Table) -> list[str]:
    split = np.array(table["split"].to_pylist())
    rock = np.array(table["environment"].to_pylist())
    success = table["success"].to_numpy(zero_copy_only=False)
    chosen = table["chosen"].to_numpy(zero_copy_only=False)
    lines = [
        "| split | episodes | chosen | environments | whole teams that arrive, % |",
        "|---|---|---|---|---|",
    ]
    for name in sorted(set(split.tolist())):
        in_split = split == name
        lines.append(
            f"| {name} | {in_split.sum():,} | {chosen[in_split].sum():,} | "
            f"{len(set(rock[in_split].tolist())):,} | {100 * success[in_split].mean():.1f} |"
        )
    return lines


def _format_sample_table(manifest: Manifest, table: pa.Table) -> list[str]:
    """Return a table of requested and actual fractions of the chosen episodes."""
    if not manifest.sample.has_bounds:
        return []
    thinned = table.filter(pc.is_in(table["split"], pa.array(SPLITS)))
    lines = [
        "Readers get the chosen episodes: of train, val and test each, a subset with the requested "
        "fractions. The others are stored too (`chosen=None`).",
        "",
        "| kind | requested | flown, % | chosen, % |",
        "|---|---|---|---|",
    ]
    chosen = thinned["chosen"].to_numpy(zero_copy_only=False)
    for kind in (*DIFFICULTIES, FAILED):
        flown = is_kind(thinned, kind)
        fractions = " | ".join(_format_percent(flown[rows]) for rows in (slice(None), chosen))
        lines.append(f"| {kind} | {manifest.sample.format_bounds(kind)} | {fractions} |")
    return [*lines, ""]


def _format_percent(values: np.ndarray) -> str:
    return f"{100 * values.mean():.1f}" if values.size else "-"


def _format_outcome_table(outcomes: dict[str, Counter[str]]) -> list[str]:
    names = [name for name in results.OUTCOMES if any(counts[name] for counts in outcomes.values())]
    lines = [
        "| scene, expert | robots | " + " | ".join(f"{name}, %" for name in names) + " |",
        "|---" * (2 + len(names)) + "|",
    ]
    for key, counts in outcomes.items():
        total = counts.total()
        cells = " | ".join(f"{100 * counts[name] / total:.1f}" for name in names)
        lines.append(f"| {key} | {total:,} | {cells} |")
    return lines


def _format_counts(table: pa.Table, column: str) -> list[str]:
    counts = Counter(table[column].to_pylist())
    rows: Sequence[str] = [
        f"| {name} | {count:,} | {100 * count / len(table):.1f} |"
        for name, count in sorted(counts.items())
    ]
    return [f"| {column} | episodes | % |", "|---|---|---|", *rows]
