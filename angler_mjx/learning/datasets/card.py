"""What a person, and a machine, read of a dataset first: ``README.md`` and ``croissant.json``."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from angler_mjx.errors import size
from angler_mjx.learning.datasets import croissant, figures, gaps
from angler_mjx.learning.datasets.manifest import SPLITS, Manifest
from angler_mjx.learning.datasets.sampling import DIFFICULTIES, FAILED, is_of
from angler_mjx.runs.several import RUNS
from angler_mjx.runs.storage import atomic, folder, results

README, CROISSANT = "README.md", "croissant.json"


def write(place: Path, manifest: Manifest, table: pa.Table) -> None:
    """Write both, and the figures, of what lies in a dataset's folder.

    Args:
        place: of the dataset.
        manifest: of it; what its sums are does not matter.
        table: its index.

    Raises:
        ConfigError: a run is damaged.
        RunError: a figure cannot be written.
        OSError: the disk gave out.
    """
    figures.draw(place, manifest, table)
    write_text(place, manifest, table)
    folder.write_json(place / CROISSANT, croissant.table(place, manifest))


def write_text(place: Path, manifest: Manifest, table: pa.Table) -> None:
    """Write the card alone; what else it names lies there.

    Raises:
        ConfigError: a run or the spot check is damaged.
        OSError: the disk gave out.
    """
    said = text(
        manifest,
        table,
        _outcomes(place, manifest),
        _bytes(place),
        drawn=_randomised(place, manifest),
        flown=gaps.text(gaps.read(place)),
    )
    atomic.write_text(place / README, said)


def _outcomes(place: Path, manifest: Manifest) -> dict[str, Counter[str]]:
    """How robots ended, by scene and expert."""
    found: dict[str, Counter[str]] = {}
    for part in manifest.parts:
        ended = folder.Run(place / part.path).episodes["outcome"].to_pylist()
        found.setdefault(f"{part.scene}, {part.expert}", Counter()).update(ended)
    return found


def _randomised(place: Path, manifest: Manifest) -> list[str]:
    """What was drawn of robots, water and instruments, by scene; nothing where nothing was."""
    scenes: dict[str, str] = {}
    for part in manifest.parts:
        given = folder.Run(place / part.path).scenario.randomise
        if given.of_vehicles or given.of_worlds:
            table = given.model_dump(mode="json", exclude_defaults=True)
            scenes[part.scene] = "; ".join(f"`{key}` {value}" for key, value in table.items())
    if not scenes:
        return []
    return [
        "## What was drawn",
        "",
        "Factors of what the files say, low and high; `variants.json` of each run folder has those "
        "of every variant, `episodes.parquet` which one a robot was and what its world has.",
        "",
        *[f"- {scene}: {said}" for scene, said in scenes.items()],
        "",
    ]


def _bytes(place: Path) -> int:
    """Of the run folders: what tells of them is written after this."""
    return sum(path.stat().st_size for path in (place / RUNS).rglob("*") if path.is_file())


def text(
    manifest: Manifest,
    table: pa.Table,
    outcomes: dict[str, Counter[str]],
    n_byte: int,
    *,
    drawn: Sequence[str],
    flown: Sequence[str],
) -> str:
    """The card.

    Args:
        manifest: of the dataset.
        table: its index.
        outcomes: of robots, by scene and expert.
        n_byte: of its run folders.
        drawn: lines on how robots differ from their files.
        flown: lines on what real autopilots made of it.
    """
    robots = pc.sum(table["robots"]).as_py()
    hours = pc.sum(pc.multiply(table["duration_s"], pc.cast(table["robots"], pa.float32())))
    made = manifest.environment
    lines = [
        "---",
        f"license: {manifest.licence}",
        "tags: [robotics, motion-planning, underwater, multi-robot, simulation]",
        "---",
        "",
        f"# {manifest.name}",
        "",
        *([manifest.description, ""] if manifest.description else []),
        f"{manifest.episodes:,} flights of teams of underwater robots, {robots:,} robots and "
        f"{hours.as_py() / 3600:,.0f} robot-hours at {manifest.time['record_hz']:g} Hz; "
        f"{size(n_byte)}, {size(n_byte / manifest.episodes)} an episode. Made by "
        f"`{manifest.command}` with angler-mjx {made['versions'].get('angler-mjx')} on "
        f"{made['device']} ({manifest.created}).",
        "",
        "Simulated, not measured at sea. Robots that failed are in it, labelled: who learns from "
        "this is to say whether from all, or from `success` alone.",
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
        "By environment: the hash of the rock decides, so no rock of one split is in another, here "
        "or in any other dataset of the same shares. `test_...` are shifted: nothing like them is "
        "in `train`.",
        "",
        *_split_table(table),
        "",
        f"![Counts]({figures.COUNTS})",
        "",
        *_chosen(manifest, table),
        "## Who flew, and how it ended",
        "",
        *_outcome_table(outcomes),
        "",
        *drawn,
        "## How hard",
        "",
        "`trivial`: every straight line is free and none passes another within 1.5 m; `crossing`: "
        "some do; `blocked`: rock alone is in the way.",
        "",
        *_counts(table, "difficulty"),
        "",
        f"![Lengths, times and clearances]({figures.LENGTHS})",
        "",
        f"![Some flights from above]({figures.FLIGHTS})",
        "",
        "## On real autopilots",
        "",
        *flown,
        "",
        "## Conventions",
        "",
        *[f"- {key.replace('_', ' ')}: {value}" for key, value in manifest.conventions.items()],
        "",
        "| array | of | unit | stored | what it is |",
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
        "- Contacts end a robot's episode; nothing is learned here about what comes after.",
        "",
    ]
    return "\n".join(lines)


def _split_table(table: pa.Table) -> list[str]:
    split = np.array(table["split"].to_pylist())
    rock = np.array(table["environment"].to_pylist())
    success = table["success"].to_numpy(zero_copy_only=False)
    chosen = table["chosen"].to_numpy(zero_copy_only=False)
    lines = [
        "| split | episodes | chosen | environments | whole teams that arrive, % |",
        "|---|---|---|---|---|",
    ]
    for name in sorted(set(split.tolist())):
        mine = split == name
        lines.append(
            f"| {name} | {mine.sum():,} | {chosen[mine].sum():,} | "
            f"{len(set(rock[mine].tolist())):,} | {100 * success[mine].mean():.1f} |"
        )
    return lines


def _chosen(manifest: Manifest, table: pa.Table) -> list[str]:
    """What was wished of the chosen episodes, and what they have."""
    if not manifest.sample.asks:
        return []
    thinned = table.filter(pc.is_in(table["split"], pa.array(SPLITS)))
    lines = [
        "Readers are given the chosen episodes: of train, val and test each as many as have the "
        "shares that were wished. The others lie there too (`chosen=None`).",
        "",
        "| share | wished | flown, % | chosen, % |",
        "|---|---|---|---|",
    ]
    chosen = thinned["chosen"].to_numpy(zero_copy_only=False)
    for kind in (*DIFFICULTIES, FAILED):
        flown = is_of(thinned, kind)
        shares = " | ".join(_percent(flown[which]) for which in (slice(None), chosen))
        lines.append(f"| {kind} | {manifest.sample.said(kind)} | {shares} |")
    return [*lines, ""]


def _percent(values: np.ndarray) -> str:
    return f"{100 * values.mean():.1f}" if values.size else "-"


def _outcome_table(outcomes: dict[str, Counter[str]]) -> list[str]:
    names = [name for name in results.OUTCOMES if any(found[name] for found in outcomes.values())]
    lines = [
        "| scene, expert | robots | " + " | ".join(f"{name}, %" for name in names) + " |",
        "|---" * (2 + len(names)) + "|",
    ]
    for key, found in outcomes.items():
        total = found.total()
        cells = " | ".join(f"{100 * found[name] / total:.1f}" for name in names)
        lines.append(f"| {key} | {total:,} | {cells} |")
    return lines


def _counts(table: pa.Table, column: str) -> list[str]:
    found = Counter(table[column].to_pylist())
    share: Sequence[str] = [
        f"| {name} | {count:,} | {100 * count / len(table):.1f} |"
        for name, count in sorted(found.items())
    ]
    return [f"| {column} | episodes | % |", "|---|---|---|", *share]
