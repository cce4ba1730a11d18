"""Checksums, SHA-256, by which files are recognised: inputs, plans, files of datasets, programs."""

import hashlib
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from angler_mjx.progress import Progress
from angler_mjx.runs.storage import output_lock
from angler_mjx.runs.storage.parallel import cpu_count, map_in_order

MAX_THREADS = 16
"""Number of threads that hash files at most."""


@dataclass(frozen=True, kw_only=True)
class FileDifferences:
    """Differences between a folder's files and their checksums; sorted paths below the folder."""

    missing: tuple[str, ...]
    changed: tuple[str, ...]
    foreign: tuple[str, ...]
    """Files without a checksum."""
    compared: int
    """Number of files that were hashed."""


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def hash_files(root: Path, names: list[str]) -> Iterator[tuple[str, str]]:
    """Yield names and checksums of files, in order, computed by threads of all processors."""
    with ThreadPoolExecutor(min(cpu_count(), MAX_THREADS)) as pool:
        digests = map_in_order(lambda name: hash_file(root / name), names, pool)
        yield from zip(names, digests, strict=True)


def hash_folder(root: Path) -> str:
    """Return the SHA-256 of the names and bytes of all files of a folder, hexadecimal."""
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*")):
        if path.is_file() and path.name != output_lock.LOCK:
            digest.update(str(path.relative_to(root)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def list_files(root: Path) -> list[str]:
    """List the files below a folder by their paths, sorted; the folder's lock does not count."""
    paths = (path for path in root.rglob("*") if path.is_file())
    names = (path.relative_to(root).as_posix() for path in paths)
    return sorted(name for name in names if name != output_lock.LOCK)


def compare_files(
    root: Path, digests: Mapping[str, str], names: list[str], progress: Progress | None = None
) -> FileDifferences:
    """Compare the files of a folder with their checksums.

    Args:
        root: the folder.
        digests: checksum of each file.
        names: files that are there.
        progress: receives the number of hashed files; nothing does if left out.

    Raises:
        OSError: a file cannot be read.
    """
    present = set(names)
    compared = sorted(present & digests.keys())
    changed = []
    for name, digest in hash_files(root, compared):
        if digest != digests[name]:
            changed.append(name)
        if progress is not None:
            progress.advance(1)
    return FileDifferences(
        missing=tuple(sorted(digests.keys() - present)),
        changed=tuple(changed),
        foreign=tuple(sorted(present - digests.keys())),
        compared=len(compared),
    )


def is_inside(name: str) -> bool:
    """Return whether a path, with slashes, stays below the folder that it is relative to."""
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts and bool(path.parts)
