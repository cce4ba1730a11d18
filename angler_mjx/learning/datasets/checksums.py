"""Checksums of a dataset's files, in a format that ``sha256sum -c`` reads."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets.manifest import MANIFEST, SUMS, require_inside
from angler_mjx.runs.multi_run import REQUEST_FILE
from angler_mjx.runs.storage import atomic_files
from angler_mjx.runs.storage.checksums import hash_file, hash_files
from angler_mjx.runs.storage.checksums import list_files as list_all_files

_EXCLUDED = {SUMS, MANIFEST, REQUEST_FILE}
"""Files of the dataset's own folder without a checksum: the manifest holds that of the checksum
file, and the request is deleted last."""


def list_files(root: Path) -> list[str]:
    """List the files that have a checksum, by their paths below a dataset's folder, sorted."""
    return [name for name in list_all_files(root) if name not in _EXCLUDED]


def write_checksums(root: Path) -> str:
    """Write the checksums of all files of a folder; return that of the checksum file.

    Raises:
        OSError: writing failed.
    """
    return _write_digests(root, dict(hash_files(root, list_files(root))))


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
    return _write_digests(root, {**digests, **dict(hash_files(root, list(names)))})


def _write_digests(root: Path, digests: Mapping[str, str]) -> str:
    lines = [f"{digest}  {name}\n" for name, digest in sorted(digests.items())]
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
