"""Checksums of a dataset's files, in a format that ``sha256sum -c`` reads."""

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets.manifest import MANIFEST, SUMS, require_inside
from angler_mjx.runs.storage import atomic_files, output_lock

_EXCLUDED = {SUMS, MANIFEST, output_lock.LOCK}
"""Files of the dataset's own folder without a checksum: the manifest holds that of the checksum
file."""


def list_files(root: Path) -> list[str]:
    """List the files that have a checksum, by their paths below a dataset's folder, sorted."""
    paths = (path for path in root.rglob("*") if path.is_file())
    names = (path.relative_to(root).as_posix() for path in paths)
    return sorted(name for name in names if name not in _EXCLUDED)


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def hash_files(root: Path, names: list[str]) -> Iterator[tuple[str, str]]:
    """Yield names and checksums of files, in order, computed by threads of all processors."""
    with ThreadPoolExecutor(min(os.cpu_count() or 1, 16)) as pool:
        yield from zip(names, pool.map(lambda name: hash_file(root / name), names), strict=True)


def write_checksums(root: Path) -> str:
    """Write the checksums of all files of a folder; return that of the checksum file.

    Raises:
        OSError: writing failed.
    """
    lines = [f"{digest}  {name}\n" for name, digest in hash_files(root, list_files(root))]
    atomic_files.write_text(root / SUMS, "".join(lines))
    return hash_file(root / SUMS)


def update_checksums(root: Path, digests: Mapping[str, str], names: Iterable[str]) -> str:
    """Rewrite the checksums of changed files and keep the others.

    Args:
        root: folder of the dataset.
        digests: previous checksums; see `read_checksums`.
        names: names of the changed files.

    Returns:
        Checksum of the checksum file.

    Raises:
        OSError: reading or writing failed.
    """
    updated = {**digests, **{name: hash_file(root / name) for name in names}}
    lines = [f"{digest}  {name}\n" for name, digest in sorted(updated.items())]
    atomic_files.write_text(root / SUMS, "".join(lines))
    return hash_file(root / SUMS)


def read_checksums(root: Path, digest: str) -> dict[str, str]:
    """Read the checksums by the names of files.

    Args:
        root: folder of the dataset.
        digest: checksum of the checksum file, from the manifest.

    Raises:
        ConfigError: the file is missing, has another checksum, or names a file outside.
    """
    path = root / SUMS
    try:
        if hash_file(path) != digest:
            raise ConfigError(
                f"{path}: its SHA-256 differs from that in {root / MANIFEST}; copy it again"
            )
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); copy it again") from error
    digests = {}
    for number, line in enumerate(lines, 1):
        digest, _, name = line.partition("  ")
        try:
            require_inside(name)
        except ValueError as error:
            raise ConfigError(f"{path}, line {number}: {error}") from error
        digests[name] = digest
    return digests
