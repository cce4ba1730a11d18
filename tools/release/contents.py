"""Contents of wheels and source distributions: what must be there, and what must not."""

import re
import tarfile
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

MAX_FILE_BYTES = 4 * 10**6
MAX_ARCHIVE_BYTES = 25 * 10**6
UNWANTED = re.compile(r"^/|(^|/)\.\.(/|$)|(^|/)(__pycache__|\.git|\.venv)/|\.(pyc|pyo|so|pem|key)$")
"""Names that no release holds: absolute ones, byte code, programs, repositories, keys."""
MACHINE = re.compile(rb"(?:/home|/Users)/[A-Za-z][\w.-]*/|[A-Z]:\\Users\\")
"""Paths in the folder of some user."""
INDEX = re.compile(
    rb"(?:extra-)?index[-_]url\s*=?\s*\S*://|https?://[^\s/@]+:[^\s/@]+@|/simple/?[\"'\s]"
)
"""Addresses of package indexes, and addresses with a password."""


def read_members(path: Path) -> dict[str, bytes]:
    """Return the files of a wheel or of a source distribution, without the folder of the latter.

    Args:
        path: the file.
    """
    if path.suffix == ".whl":
        with zipfile.ZipFile(path) as opened:
            return {name: opened.read(name) for name in opened.namelist() if name[-1] != "/"}
    members: dict[str, bytes] = {}
    with tarfile.open(path) as archive:
        for member in archive:
            content = archive.extractfile(member)
            if content is not None:
                members[member.name.partition("/")[2]] = content.read()
    return members


def find_content_faults(
    members: Mapping[str, bytes], *, paths: Sequence[str], tracked: Iterable[str] | None = None
) -> list[str]:
    """Return what is wrong with the contents of a wheel or of a source distribution.

    Args:
        members: its files.
        paths: folders of this machine, none of which may stand in a file.
        tracked: files of the commit, all of which must be there; None for a wheel.
    """
    faults = []
    for name, content in members.items():
        if UNWANTED.search(name):
            faults.append(f"{name}: not wanted in a release")
        if len(content) > MAX_FILE_BYTES:
            faults.append(f"{name}: {len(content):,} bytes, more than {MAX_FILE_BYTES:,}")
        local = next((path for path in paths if path.encode() in content), None)
        if match := MACHINE.search(content):
            local = match[0].decode()
        if local is not None:
            faults.append(f"{name}: names {local}, a path of a machine")
        if match := INDEX.search(content):
            faults.append(f"{name}: names an index, {match[0].decode().strip()}")
    if tracked is not None:
        faults += [f"{name}: of the commit, and missing" for name in tracked if name not in members]
    return faults


def find_size_fault(path: Path) -> list[str]:
    """Return the fault of a file that is larger than a release may be.

    Args:
        path: a wheel or source distribution.
    """
    size = path.stat().st_size
    if size <= MAX_ARCHIVE_BYTES:
        return []
    return [f"{path.name}: {size:,} bytes, more than {MAX_ARCHIVE_BYTES:,}"]
