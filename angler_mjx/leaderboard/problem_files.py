"""Files of the frozen problems, and the manifest that names and hashes each of them.

A folder of problems holds one Zarr group per set, ``SET.zarr``, with each array of each problem as
one file of plain numbers, and ``manifest.json``.
"""

import hashlib
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import zarr

from angler_mjx.errors import AnglerError, ConfigError, RunError
from angler_mjx.leaderboard import problem_sets
from angler_mjx.leaderboard.problem_sets import FrozenBenchmark, ProblemSet
from angler_mjx.planning.planner import PathShape
from angler_mjx.planning.problem import Problem
from angler_mjx.progress import Progress
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage.atomic_files import write_json
from angler_mjx.runs.storage.plans.problems import SCHEMA, write_problems
from angler_mjx.runs.storage.read_errors import read_table, wrap_read_errors
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.information import CurrentInformation

MANIFEST = "manifest.json"
PUBLIC_MANIFEST = "angler_1.json"
"""ProblemManifest of the public problems, among the benchmark's files."""
MAX_ATTEMPTS = 50
"""Seeds tried for a set whose worlds all hold the team."""
CURRENT_POINTS, CURRENT_STEP_S = 5, 5.0
"""Points along each edge of the region, and seconds between samples, of a current that is known."""


@dataclass(frozen=True, kw_only=True)
class SetRecord:
    """Entry of a manifest: a set of problems and how to make and recognise it."""

    name: str
    attempt: int
    """Number of seeds that were refused before this one; see `problem_sets.derive_seed`."""
    digest: str
    """`Scenario.digest`: of everything that the problems of a seed depend on."""
    sha256: tuple[str, ...]
    """Of each problem; see `hash_problem`."""
    bound_s: tuple[float, ...]
    """Of each problem: time of the longest straight line from a start to its goal at cruise speed,
    in milliseconds' steps."""


@dataclass(frozen=True, kw_only=True)
class ProblemManifest:
    """What a folder of problems holds."""

    benchmark: str
    """Name and version."""
    secret: str
    """`problem_sets.digest_secret` of the organiser's secret; that of nothing if public."""
    sets: tuple[SetRecord, ...]

    def find(self, name: str) -> SetRecord:
        """Return the record of a set.

        Raises:
            ConfigError: there is none of it.
        """
        for record in self.sets:
            if record.name == name:
                return record
        raise ConfigError(f"{MANIFEST}: has no problem set {name}")

    @property
    def problems(self) -> int:
        """Number of problems."""
        return sum(len(record.sha256) for record in self.sets)

    def sha256(self) -> str:
        """Return the SHA-256 of the hashes of all problems, hexadecimal."""
        lines = [f"{record.name} {' '.join(record.sha256)}\n" for record in self.sets]
        return hashlib.sha256("".join(lines).encode()).hexdigest()


def hash_problem(problem: Problem) -> str:
    """Return the SHA-256 of a problem's rock, starts and goals, hexadecimal.

    It is taken of ``grid/occupied`` as bytes of 0 and 1, then ``team/start_m`` and ``team/goal_m``
    as little-endian float32, each in C order. These are copies of cells' corners and middles: they
    are equal on every machine, where sampled currents differ by rounding.
    """
    digest = hashlib.sha256(np.asarray(problem.grid.occupied, np.uint8).tobytes())
    for rows in (problem.team.start_m, problem.team.goal_m):
        digest.update(np.asarray(rows, "<f4").tobytes())
    return digest.hexdigest()


def read_manifest(path: Path) -> ProblemManifest:
    """Read a manifest.

    Raises:
        ConfigError: it is missing, damaged, or of another version of the benchmark.
    """
    table = read_table(path)
    title = problem_sets.load_benchmark().title
    if table.get("benchmark") != title:
        raise ConfigError(f"{path}: is of {table.get('benchmark')!r}, this program has {title}")
    try:
        sets = [
            SetRecord(
                name=entry["name"],
                attempt=int(entry["attempt"]),
                digest=entry["digest"],
                sha256=tuple(entry["sha256"]),
                bound_s=tuple(entry["bound_s"]),
            )
            for entry in table["sets"]
        ]
        return ProblemManifest(benchmark=title, secret=table["secret"], sets=tuple(sets))
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{path}: is no manifest of problems ({error!r})") from error


def public_manifest() -> ProblemManifest:
    """Return the manifest of the public problems."""
    return read_manifest(problem_sets.data_folder() / PUBLIC_MANIFEST)


def write_problem_files(
    benchmark: FrozenBenchmark,
    sets: Sequence[ProblemSet],
    out: Path,
    progress: Progress,
    *,
    secret: bytes = problem_sets.PUBLIC,
    frozen: ProblemManifest | None = None,
) -> ProblemManifest:
    """Write the files of sets and their manifest; files that are there are kept.

    Args:
        benchmark: the benchmark.
        sets: to write.
        out: folder, new or of an earlier call.
        progress: receives the progress, in problems.
        secret: of the organiser; empty for the public problems.
        frozen: manifest whose seeds are taken, and whose hashes have to come out.

    Raises:
        ConfigError: the folder holds problems of another secret.
        RunError: a problem differs from its frozen hash, or no seed has room for a team.
    """
    out.mkdir(parents=True, exist_ok=True)
    path = out / MANIFEST
    records: dict[str, SetRecord] = {}
    if path.exists():
        stored = read_manifest(path)
        if stored.secret != problem_sets.digest_secret(secret):
            raise ConfigError(f"{path}: is of problems with another secret; choose another folder")
        records = {record.name: record for record in stored.sets}
    progress.start(sum(entry.problems for entry in sets), unit="problems")
    for entry in sets:
        frozen_record = None if frozen is None else frozen.find(entry.name)
        if entry.name in records and frozen_record is not None:
            _require_frozen(records[entry.name], frozen_record)
        if entry.name not in records or not (out / f"{entry.name}.zarr").exists():
            progress.describe(entry.name)
            records[entry.name] = _write_set(benchmark, entry, out, secret, frozen_record)
            manifest = _build_manifest(benchmark, records, secret)
            write_json(path, _manifest_table(manifest))
        progress.advance(entry.problems)
    return _build_manifest(benchmark, records, secret)


def _build_manifest(
    benchmark: FrozenBenchmark, records: dict[str, SetRecord], secret: bytes
) -> ProblemManifest:
    order = [entry.name for entry in problem_sets.list_problem_sets(benchmark)]
    return ProblemManifest(
        benchmark=benchmark.title,
        secret=problem_sets.digest_secret(secret),
        sets=tuple(records[name] for name in order if name in records),
    )


def _manifest_table(manifest: ProblemManifest) -> dict[str, Any]:
    return {**asdict(manifest), "problems": manifest.problems, "sha256": manifest.sha256()}


def _require_frozen(record: SetRecord, frozen: SetRecord) -> None:
    if record != frozen:
        raise RunError(
            f"{record.name}: its problems differ from the frozen ones (digest "
            f"{record.digest[:12]}, not {frozen.digest[:12]}; first problem {record.sha256[0][:12]}"
            f", not {frozen.sha256[0][:12]}): worlds are sampled otherwise by this version; use "
            "the version that the benchmark names"
        )


def build_set_scenario(
    benchmark: FrozenBenchmark, entry: ProblemSet, attempt: int, secret: bytes
) -> Scenario:
    """Return the scenario of a set with the seed of an attempt."""
    seed = problem_sets.derive_seed(benchmark, entry.name, secret, attempt)
    return problem_sets.build_scenario(benchmark, entry, seed)


def printed_seed(scenario: Scenario, secret: bytes) -> int:
    """Return the attribute ``seed`` of the files of a set: that of the worlds, 0 if hidden."""
    return 0 if secret else scenario.seed


def _write_set(
    benchmark: FrozenBenchmark,
    entry: ProblemSet,
    out: Path,
    secret: bytes,
    frozen: SetRecord | None,
) -> SetRecord:
    """Write the problems of a set, once they are known to be the frozen ones.

    Raises:
        RunError: they differ, or no seed has room for the team.
    """
    attempt = None if frozen is None else frozen.attempt
    simulator = None
    for number in range(MAX_ATTEMPTS) if attempt is None else (attempt,):
        scenario = build_set_scenario(benchmark, entry, number, secret)
        if simulator is not None:
            simulator.close()
        simulator = Simulator(scenario, paths=PathShape(points=2), devices=1)
        worlds, _ = simulator.sample_problems(0)
        if np.asarray(worlds.environment.valid)[: entry.problems].all():
            break
    else:
        raise RunError(f"{entry.name}: no seed of {MAX_ATTEMPTS} has worlds that hold the team")
    problems = simulator.problems(0, entry.problems)
    hashes = [hash_problem(problem) for problem in problems]
    record = SetRecord(
        name=entry.name,
        attempt=number,
        digest=scenario.digest(),
        sha256=tuple(hashes),
        bound_s=tuple(_bound_makespan_s(problem) for problem in problems),
    )
    if frozen is not None:
        _require_frozen(record, frozen)
    path = out / f"{entry.name}.zarr"
    if _holds_set(path, entry):  # of a call that was ended before it could write the manifest
        shutil.rmtree(path)
    extend = partial(_extend_group, benchmark, entry, secret, hashes)
    write_problems(path, simulator, raw=True, extend=extend)
    simulator.close()
    return record


def _holds_set(path: Path, entry: ProblemSet) -> bool:
    """Return whether a path is the file of a set, which can be made again."""
    try:
        with wrap_read_errors(path):
            attributes = dict(zarr.open_group(path, mode="r").attrs)
    except AnglerError:
        return False
    return (attributes.get("schema"), attributes.get("set")) == (SCHEMA, entry.name)


def _bound_makespan_s(problem: Problem) -> float:
    team = problem.team
    distance_m = np.linalg.norm(np.asarray(team.goal_m - team.start_m, float), axis=-1)
    return round(float(np.max(distance_m / np.asarray(team.cruise_speed_mps, float))), 3)


def _extend_group(
    benchmark: FrozenBenchmark,
    entry: ProblemSet,
    secret: bytes,
    hashes: Sequence[str],
    group: zarr.Group,
    problems: list[Problem],
) -> None:
    """Add names, limits and the sampled current; take out what tells a hidden seed."""
    group.attrs.update(
        {
            "benchmark": benchmark.title,
            "set": entry.name,
            "problems": entry.problem_names(),
            "sha256": list(hashes),
        }
    )
    if secret:
        group.attrs["seed"] = 0
        with zarr.config.set({"array.write_empty_chunks": True}):
            seeds = group.get_array("seed")
            seeds[:] = np.zeros(seeds.shape, np.uint32)
    if problems[0].information.current == "truth" and problems[0].current.components:
        _add_current(group, problems)


def _add_current(group: zarr.Group, problems: list[Problem]) -> None:
    """Add the velocity of the current on a lattice, for readers without our current models."""
    grid, horizon_s = problems[0].grid, problems[0].horizon_s
    edges = [float(grid.cell_m) * size for size in grid.occupied.shape]
    axes = [
        float(low) + np.linspace(0.0, edge, CURRENT_POINTS)
        for low, edge in zip(np.asarray(grid.origin_m), edges, strict=True)
    ]
    times = np.arange(0.0, horizon_s + 0.5 * CURRENT_STEP_S, CURRENT_STEP_S)
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).astype(np.float32)

    @jax.jit
    def sample(current: CurrentInformation) -> jax.Array:
        at_points = jax.vmap(current.velocity, (0, None))
        at_times = jax.vmap(at_points, (None, 0))
        return at_times(jnp.asarray(points.reshape(-1, 3)), jnp.asarray(times, jnp.float32))

    rows = np.stack([np.asarray(sample(problem.current)) for problem in problems])
    shape = (len(problems), len(times), *points.shape)
    described = {
        "current_lattice/velocity_mps": (
            rows.reshape(shape),
            ["world", "time", "x", "y", "z", "xyz"],
            "m/s",
            "velocity of the water over ground, W; interpolate linearly",
        ),
        "current_lattice/time_s": (times.astype(np.float32), ["time"], "s", "times of samples"),
    } | {
        f"current_lattice/{name}_m": (
            axis.astype(np.float32),
            [name],
            "m",
            f"positions of samples along {name}, W",
        )
        for name, axis in zip("xyz", axes, strict=True)
    }
    for name, (values, names, unit, text) in described.items():
        with zarr.config.set({"array.write_empty_chunks": True}):
            group.create_array(
                name,
                data=values.astype(np.float32),
                chunks=(1, *values.shape[1:]) if names[0] == "world" else values.shape,
                compressors=None,
                attributes={"unit": unit, "description": text},
                dimension_names=names,
            )
