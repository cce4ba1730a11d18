"""``python -m tools.value_digests``: digests of computed values; comparison of two such files.

Digests are of values: names, shapes, types and bytes of arrays and columns, without provenance,
times of a clock or versions. Two commits are compared on one machine, with one version of JAX, each
from a checkout of its own.
"""

import hashlib
import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tyro
import zarr

from tests.folders import write_inputs

ROOT = Path(__file__).parents[2]
ITEMS = tomllib.loads(Path(__file__).with_name("items.toml").read_text(encoding="utf-8"))
ENGINES = ("fused", "mjx")
LIMIT_S = 1800.0
COMMAND = "from angler_mjx.cli.main import main; import sys; main(sys.argv[1:])"

type Digests = dict[str, dict[str, str]]
"""Digest by item and by ``FILE:NAME`` of an array or column."""


@dataclass(frozen=True, kw_only=True)
class MakeOptions:
    """Run the commands of items.toml and write the digests of their results."""

    out: Path
    """JSON file of digests; items in the file are not run again."""
    only: tuple[str, ...] = ()
    """Prefixes of the names of items to run; all if left out."""


@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """Compare two files of digests; exit with 1 where a value differs."""

    before: Path
    """File of the earlier commit."""
    after: Path
    """File of the later commit."""
    renamed: Path | None = None
    """JSON file of an object: name of an array or column before, to its name after."""


def list_items() -> dict[str, str]:
    """Return the command line of each item, by name."""
    lines = {
        f"{name}/{engine}": f"rollout {line} --engine {engine} --record-hz 5 --no-figures --out out"
        for name, line in ITEMS["rollouts"].items()
        for engine in ENGINES
    }
    return lines | ITEMS["commands"]


def make_digests(options: MakeOptions) -> int:
    """Digest the chosen items; return 0, or 1 where a command failed."""
    done: Digests = json.loads(options.out.read_text()) if options.out.exists() else {}
    failed = []
    for name, line in list_items().items():
        if name in done or (options.only and not name.startswith(options.only)):
            continue
        start = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            error = _run_command(Path(folder), line)
            if error is None:
                done[name] = dict(sorted(iterate_digests(Path(folder) / "out")))
                options.out.write_text(json.dumps(done, indent=1, sort_keys=True) + "\n")
        print(f"{time.monotonic() - start:6.1f} s  {name}  {error or len(done[name])}", flush=True)
        if error is not None:
            failed.append(name)
    return 1 if failed else 0


def _run_command(folder: Path, line: str) -> str | None:
    """Run a command of `angler` in a folder; return its last words after a failure."""
    write_inputs(folder)
    paths = os.pathsep.join(str(ROOT / p) for p in ("", "kernels", "sitl_bridge", "experiments"))
    try:
        completed = subprocess.run(
            [sys.executable, "-c", COMMAND, *shlex.split(line)],
            cwd=folder,
            env=os.environ | {"PYTHONPATH": paths + os.pathsep + os.environ.get("PYTHONPATH", "")},
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"not done after {LIMIT_S:.0f} s"
    if completed.returncode and not (folder / "out").exists():
        return f"exit code {completed.returncode}: {completed.stderr[-400:]}"
    return None


def iterate_digests(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield ``FILE:NAME`` and the digest of each array and column below a folder, or of a file."""
    left_out = ITEMS["left_out"]
    for name, values in _iterate_values(folder):
        if not any(part in name for part in left_out["parts"]):
            yield name, hash_values(values)


def _iterate_values(folder: Path) -> Iterator[tuple[str, np.ndarray]]:
    tops = [folder] if _is_group(folder) or folder.is_file() else []
    for path in tops or sorted(folder.rglob("*")):
        name = path.relative_to(folder.parent).as_posix()
        if _is_group(path) and not _is_group(path.parent):
            group = zarr.open_group(path, mode="r")
            for key, array in group.members(max_depth=None):
                if isinstance(array, zarr.Array):
                    yield f"{name}:{key}", np.asarray(array[...])
        elif path.suffix == ".parquet":
            table = pq.read_table(path)
            for key in table.column_names:
                yield f"{name}:{key}", _column_values(table[key])


def _is_group(path: Path) -> bool:
    return (path / "zarr.json").exists() or (path / ".zgroup").exists()


def _column_values(column: pa.ChunkedArray) -> np.ndarray:
    """Return a column as an array: numbers unchanged, all else as JSON, nulls kept."""
    if column.null_count == 0 and (
        pa.types.is_integer(column.type) or pa.types.is_floating(column.type)
    ):
        return column.to_numpy()
    return np.asarray([json.dumps(value, default=str) for value in column.to_pylist()])


def hash_values(values: np.ndarray) -> str:
    """Return the digest of an array's type, shape and bytes."""
    if values.dtype.hasobject or values.dtype.kind in "TU":
        values = np.asarray(values.tolist(), dtype=str)
    head = f"{values.dtype.str} {values.shape} ".encode()
    return hashlib.sha256(head + np.ascontiguousarray(values).tobytes()).hexdigest()[:16]


def compare_digests(options: CompareOptions) -> int:
    """Print the differences; return 1 if there are any."""
    before: Digests = json.loads(options.before.read_text())
    after: Digests = json.loads(options.after.read_text())
    names: dict[str, str] = json.loads(options.renamed.read_text()) if options.renamed else {}
    n_wrong = 0
    for item in sorted(before.keys() | after.keys()):
        old = {_rename_key(name, names): value for name, value in before.get(item, {}).items()}
        new = after.get(item, {})
        missing, added = sorted(old.keys() - new.keys()), sorted(new.keys() - old.keys())
        differing = sorted(name for name in old.keys() & new.keys() if old[name] != new[name])
        n_wrong += bool(missing or differing)
        for label, listed in (("missing", missing), ("differs", differing), ("new", added)):
            if listed:
                print(f"{item}: {label}: {', '.join(listed[:6])}{' ...' * (len(listed) > 6)}")
    count = sum(len(values) for values in before.values())
    print(f"{count} values of {len(before)} items; {n_wrong} items differ")
    return 1 if n_wrong else 0


def _rename_key(name: str, names: dict[str, str]) -> str:
    file, _, key = name.rpartition(":")
    return f"{file}:{'/'.join(names.get(part, part) for part in key.split('/'))}"


if __name__ == "__main__":
    chosen = tyro.extras.subcommand_cli_from_dict({"make": MakeOptions, "compare": CompareOptions})
    sys.exit(make_digests(chosen) if isinstance(chosen, MakeOptions) else compare_digests(chosen))
