"""Checksums of a dataset's files, in a file that ``sha256sum -c`` takes too."""

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets.manifest import MANIFEST, SUMS, require_inside
from angler_mjx.runs.storage import atomic_files, output_lock

_EXCLUDED = {SUMS, MANIFEST, output_lock.LOCK}
"""Files of the dataset's own folder without a sum: the manifest holds that of the sums."""


def list_files(root: Path) -> list[str]:
    """All files that have a sum, by their paths below a dataset's folder, sorted."""
    paths = (path for path in root.rglob("*") if path.is_file())
    names = (path.relative_to(root).as_posix() for path in paths)
    return sorted(name for name in names if name not in _EXCLUDED)


def hash_file(path: Path) -> str:
    """SHA-256 of a file, hexadecimal.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def hash_files(root: Path, names: list[str]) -> Iterator[tuple[str, str]]:
    """Names and sums of files, in order; threads of all processors work on them."""
    with ThreadPoolExecutor(min(os.cpu_count() or 1, 16)) as pool:
        yield from zip(names, pool.map(lambda name: hash_file(root / name), names), strict=True)


def write_checksums(root: Path) -> str:
    """Write the sums of all files of a folder; returns that of the file of sums.

    Raises:
        OSError: the disk gave out.
    """
    lines = [f"{digest}  {name}\n" for name, digest in hash_files(root, list_files(root))]
    atomic_files.write_text(root / SUMS, "".join(lines))
    return hash_file(root / SUMS)


def update_checksums(root: Path, digests: Mapping[str, str], names: Iterable[str]) -> str:
    """Write the sums anew for some files that were written, as they were for all others.

    Args:
        root: the dataset.
        digests: sums as they were; see `read_checksums`.
        names: of the files.

    Returns:
        The sum of the file of sums.

    Raises:
        OSError: the disk gave out.
    """
    updated = {**digests, **{name: hash_file(root / name) for name in names}}
    lines = [f"{digest}  {name}\n" for name, digest in sorted(updated.items())]
    atomic_files.write_text(root / SUMS, "".join(lines))
    return hash_file(root / SUMS)


def read_checksums(root: Path, digest: str) -> dict[str, str]:
    """Sums by the names of files.

    Args:
        root: the dataset.
        digest: of the file of sums, as the manifest says.

    Raises:
        ConfigError: the file is missing, is another one, or names a file outside.
    """
    path = root / SUMS
    try:
        if hash_file(path) != digest:
            raise ConfigError(
                f"{path}: is not the file that {root / MANIFEST} says (its SHA-256 differs); "
                "copy it again"
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
