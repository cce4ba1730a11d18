"""Index of a dataset: a row per episode, computed from the parts' own files alone."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets.config import SplitConfig
from angler_mjx.learning.datasets.manifest import INDEX, SPLITS, Manifest
from angler_mjx.learning.datasets.sampling import select_episodes
from angler_mjx.progress import Progress
from angler_mjx.runs.storage import atomic_files, trajectory_layout
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.runs.stored_arrays import stored_array, stored_group

_COLUMNS: tuple[tuple[str, pa.DataType, str, str], ...] = (
    ("episode", pa.int64(), "1", "number of the row"),
    ("part", pa.int32(), "1", "index in the manifest's parts"),
    ("world", pa.int64(), "1", "index of the world in the part"),
    ("seed", pa.int64(), "1", "seed of the part; with the index it determines the world"),
    ("scene", pa.string(), "", "scene of the dataset file"),
    ("preset", pa.string(), "", "preset of the world"),
    ("expert", pa.string(), "", "planner or policy"),
    ("knows_obstacles", pa.string(), "", "information level of moving obstacles"),
    ("knows_current", pa.string(), "", "information level of the current"),
    ("robots", pa.int32(), "1", "number of robots"),
    ("split", pa.string(), "", "train, val, test, or test_SCENE of a shifted scene"),
    (
        "environment",
        pa.string(),
        "",
        "hash of the rock; without rock, of all samples",
    ),
    ("samples", pa.int32(), "1", "number of samples until the last robot ended"),
    ("duration_s", pa.float32(), "s", "time until the last robot ended"),
    ("planned", pa.int32(), "1", "robots with a path"),
    ("reached", pa.int32(), "1", "robots that arrived"),
    ("success", pa.bool_(), "1", "whether all robots arrived"),
    ("energy_j", pa.float32(), "J", "energy of all robots"),
    ("density", pa.float32(), "1", "fraction of occupied cells"),
    ("path_ratio", pa.float32(), "1", "shortest path over straight line, mean of the robots"),
    ("free_lines", pa.int32(), "1", "robots whose straight line to the goal meets no rock"),
    (
        "crossings",
        pa.int32(),
        "1",
        "pairs of robots whose straight lines pass within 1.5 m, nearer than their ends are",
    ),
    (
        "difficulty",
        pa.string(),
        "",
        "trivial: all lines free and none cross; blocked: rock in some, none cross; crossing: some "
        "cross, rock in half of them or fewer; both: some cross, rock in more than half",
    ),
    ("chosen", pa.bool_(), "1", "whether readers use it by default"),
)

SCHEMA = pa.schema(
    [
        pa.field(name, kind, metadata={"unit": unit, "description": text})
        for name, kind, unit, text in _COLUMNS
    ]
)
"""Columns of ``index.parquet``, with unit and meaning in each field's metadata."""

CROSSING_M = 1.5
"""Distance below which straight lines cross [m]: two vehicles and a metre between them."""

ROUNDING_M = 1e-3
"""Rounding of positions [m]: float32 in steps of a millimetre."""


def build_rows(
    root: Path, part: int, entry: Mapping[str, object], fractions: SplitConfig, first: int
) -> pa.Table:
    """Return the rows of a part, all of them chosen.

    Args:
        root: run folder of the part.
        part: its index.
        entry: its scene, expert and split.
        fractions: of environments by split.
        first: number of its first episode.

    Raises:
        ConfigError: the run is damaged.
    """
    run = Run(root)
    episodes, scenario = run.episodes, run.scenario
    robots = len(scenario.members())
    world = episodes["world"].to_numpy()[::robots]

    def by_world(name: str) -> np.ndarray:
        values: np.ndarray = episodes[name].to_numpy(zero_copy_only=False)
        return values.reshape(-1, robots)

    reached = (by_world("outcome") == "reached").sum(axis=1)
    ended = np.where(
        by_world("outcome") == "reached", by_world("time_to_goal_s"), by_world("failure_time_s")
    ).max(axis=1)
    environments = [_describe_environments(batch) for batch in _read_environments(run, len(world))]
    hashes = [digest for digests, _ in environments for digest in digests]
    environment_columns = {
        name: np.concatenate([columns[name] for _, columns in environments])
        for name in ("density", "path_ratio", "free_lines", "crossings")
    }
    free, crossings = environment_columns["free_lines"], environment_columns["crossings"]
    hz = scenario.time.record_hz
    policy = scenario.policy
    information = scenario.planner.information
    if policy.name != "none" and policy.information is not None:
        information = policy.information
    max_samples = stored_array(run.trajectories, "p_m").shape[1]
    split = entry["split"]
    count = len(world)
    columns: dict[str, Sequence[object] | np.ndarray] = {
        "episode": np.arange(first, first + count),
        "part": np.full(count, part, np.int32),
        "world": world,
        "seed": np.full(count, scenario.seed),
        "scene": [entry["scene"]] * count,
        "preset": [scenario.world.preset] * count,
        "expert": [entry["expert"]] * count,
        "knows_obstacles": [information.obstacles] * count,
        "knows_current": [information.current] * count,
        "robots": np.full(count, robots, np.int32),
        "split": [split or assign_split(digest, fractions) for digest in hashes],
        "environment": hashes,
        "samples": np.clip(np.ceil(ended * hz - 1e-6), 1, max_samples).astype(np.int32),
        "duration_s": ended.astype(np.float32),
        "planned": by_world("planned").sum(axis=1).astype(np.int32),
        "reached": reached.astype(np.int32),
        "success": reached == robots,
        "energy_j": by_world("energy_j").sum(axis=1).astype(np.float32),
        "density": environment_columns["density"].astype(np.float32),
        "path_ratio": environment_columns["path_ratio"].astype(np.float32),
        "free_lines": free.astype(np.int32),
        "crossings": crossings.astype(np.int32),
        "difficulty": classify_difficulty(free, crossings, robots),
        "chosen": np.ones(count, bool),
    }
    return pa.table(columns, schema=SCHEMA)


def _read_environments(run: Run, worlds: int) -> Iterator[dict[str, np.ndarray]]:
    """Yield the environment arrays that the index needs, some worlds at a time."""
    group = stored_group(run.trajectories, trajectory_layout.ENVIRONMENT_GROUP)
    names = ["grid/occupied", "floor_z_m", "start_m", "goal_m", "line_free", "density"]
    names += ["path_ratio", *(n for n in ("obstacles/p0", "obstacles/size_m") if n in group)]
    arrays = {name: stored_array(group, name) for name in names}
    step = arrays["density"].chunks[0]
    for first in range(0, worlds, step):
        with wrap_read_errors(run.path):
            batch = slice(first, min(first + step, worlds))
            yield {name: np.asarray(array[batch]) for name, array in arrays.items()}


def _describe_environments(
    environments: Mapping[str, np.ndarray],
) -> tuple[list[str], dict[str, np.ndarray]]:
    """Return hashes of some worlds, and the index columns of their difficulty."""
    rest = [
        environments[name] for name in sorted(environments) if name not in ("density", "path_ratio")
    ]
    hashes = [
        hash_environment(rock, b"".join(array[i].tobytes() for array in rest))
        for i, rock in enumerate(environments["grid/occupied"])
    ]
    return hashes, {
        "density": environments["density"],
        "path_ratio": environments["path_ratio"].mean(axis=1),
        "free_lines": environments["line_free"].sum(axis=1),
        "crossings": count_crossings(environments["start_m"], environments["goal_m"]),
    }


def hash_environment(occupied: np.ndarray, rest: bytes) -> str:
    """Return the hexadecimal hash that identifies an environment.

    The hash is of the rock alone where there is any: a learner that has seen it with one team has
    seen it with all.

    Args:
        occupied: bool [x, y, z].
        rest: all other sampled properties, for worlds without rock.
    """
    shape = np.array(occupied.shape, "<i8").tobytes()
    content = np.packbits(occupied).tobytes() if occupied.any() else rest
    return hashlib.sha256(shape + content).hexdigest()[:16]


def assign_split(digest: str, fractions: SplitConfig) -> str:
    """Return split of an environment by its hash alone, so that it is the same in every dataset."""
    fraction = int(hashlib.sha256(digest.encode()).hexdigest()[:13], 16) / 16**13
    for name in SPLITS[:-1]:
        fraction -= getattr(fractions, name)
        if fraction < 0.0:
            return name
    return SPLITS[-1]


def classify_difficulty(free_lines: np.ndarray, crossings: np.ndarray, robots: int) -> np.ndarray:
    """Return the level of each episode, str [n]: one of `sampling.DIFFICULTIES`.

    Crossing lines alone do not separate episodes where every team starts in opposite corners and
    meets in the middle; the number of lines that rock obstructs does.

    Args:
        free_lines: int [n], robots whose straight line to the goal meets no rock.
        crossings: int [n], pairs whose straight lines cross.
        robots: of each team.
    """
    blocked = robots - free_lines
    level: np.ndarray = np.select(
        [(crossings == 0) & (blocked == 0), crossings == 0, 2 * blocked <= robots],
        ["trivial", "blocked", "crossing"],
        "both",
    )
    return level


def count_crossings(start_m: np.ndarray, goal_m: np.ndarray) -> np.ndarray:
    """Return the number of pairs of robots [n] whose straight lines cross.

    Lines cross that pass within `CROSSING_M` of each other, and nearer than the robots are at their
    starts and at their goals: those of robots side by side do not.

    Args:
        start_m: [n, r, 3].
        goal_m: [n, r, 3].
    """
    a, b = np.triu_indices(start_m.shape[1], 1)
    start_m, goal_m = start_m.astype(float), goal_m.astype(float)
    gap = segment_gap_m(start_m[:, a], goal_m[:, a], start_m[:, b], goal_m[:, b])
    ends = [
        np.linalg.norm(positions_m[:, a] - positions_m[:, b], axis=-1)
        for positions_m in (start_m, goal_m)
    ]
    nearer = gap < np.minimum(*ends) - ROUNDING_M
    pairs: np.ndarray = ((gap < CROSSING_M) & nearer).sum(axis=-1)
    return pairs


def segment_gap_m(p: np.ndarray, q: np.ndarray, r: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return distances [...] between segments p to q and r to s, [..., 3] each, m.

    C. Ericson, Real-Time Collision Detection (2005), section 5.1.9.
    """
    d1, d2, w = q - p, s - r, p - r
    a, e = (d1 * d1).sum(-1), (d2 * d2).sum(-1)
    b, c, f = (d1 * d2).sum(-1), (d1 * w).sum(-1), (d2 * w).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        across = a * e - b * b
        t = np.where(across > 1e-9, (b * f - c * e) / across, 0.0).clip(0.0, 1.0)
        u = np.where(e > 0.0, (b * t + f) / e, 0.0)
        t = np.where(u <= 0.0, -c / a, np.where(u >= 1.0, (b - c) / a, t))
    t, u = np.nan_to_num(t).clip(0.0, 1.0), u.clip(0.0, 1.0)
    between = p + t[..., None] * d1 - r - u[..., None] * d2
    gap: np.ndarray = np.linalg.norm(between, axis=-1)
    return gap


def build_index(root: Path, manifest: Manifest, progress: Progress | None = None) -> pa.Table:
    """Build the index of all parts of a dataset.

    Args:
        root: folder of the dataset.
        manifest: its manifest.
        progress: receives the number of episodes; nothing does if left out.

    Raises:
        ConfigError: a run is damaged.
    """
    fractions = SplitConfig(**manifest.split_shares)
    tables: list[pa.Table] = []
    first = 0
    for number, part in enumerate(manifest.parts):
        entry = {"scene": part.scene, "expert": part.expert, "split": part.split}
        tables.append(build_rows(root / part.path, number, entry, fractions, first))
        first += len(tables[-1])
        if progress is not None:
            progress.advance(len(tables[-1]))
    whole = pa.concat_tables(tables)
    column = SCHEMA.get_field_index("chosen")
    return whole.set_column(
        column, SCHEMA.field(column), pa.array(select_episodes(whole, manifest.sample, SPLITS))
    )


def find_shared_environment(table: pa.Table) -> tuple[str, str, str] | None:
    """Return two splits that share an environment, and its hash; None where no splits do.

    An environment in two splits would reward memorising it.
    """
    splits_by_rock: dict[str, str] = {}
    rocks, splits = table["environment"].to_pylist(), table["split"].to_pylist()
    for rock, split in zip(rocks, splits, strict=True):
        first_split = splits_by_rock.setdefault(rock, split)
        if first_split != split:
            return min(first_split, split), max(first_split, split), rock
    return None


def write_index(root: Path, table: pa.Table) -> None:
    """Write the index with checksums, complete or not at all.

    Raises:
        OSError: writing failed.
    """
    atomic_files.write_parquet(root / INDEX, table, compression="zstd", page_checksums=True)


def read_index(root: Path) -> pa.Table:
    """Read the index of a dataset.

    Raises:
        ConfigError: the file is damaged, or has other columns.
    """
    path = root / INDEX
    with wrap_read_errors(path):
        table = pq.read_table(path, page_checksum_verification=True)
    if table.schema.names != SCHEMA.names or table.schema.types != SCHEMA.types:
        raise ConfigError(
            f"{path}: holds the columns {', '.join(table.schema.names)}, not those of an index; "
            "copy it again, or make it again where it is of an earlier version"
        )
    return table
