"""Selection of the ArduSub program, and checks of its file against this machine."""

import os
import platform
import struct
from dataclasses import dataclass
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse_model, read_toml
from angler_mjx.runs.storage.checksums import hash_file

ENVIRONMENT_VARIABLE = "ANGLER_ARDUSUB"
PROGRAM_NAME, RECORD_NAME = "ardusub", "ardusub.toml"
UNKNOWN_VERSION = "unknown"
"""Version of a program without a record, until it reports its version."""

_MACHINES = {"x86_64": 62, "aarch64": 183, "armv7l": 40, "i686": 3}
"""ELF number of a machine (e_machine) by its kernel name."""
_INTERPRETER = 3
"""PT_INTERP: the program header that names the dynamic loader."""


@dataclass(frozen=True, kw_only=True)
class Binary:
    """ArduSub program.

    Attributes:
        path: Location of the program.
        version: As reported at installation, as in "4.5.3"; `UNKNOWN_VERSION` for others.
        sha256: Checksum of the file, hexadecimal.
    """

    path: Path
    version: str
    sha256: str


class BinaryRecord(FileModel):
    """Record beside an installed program."""

    version: str
    """Version as reported by the program itself."""
    git: str
    wanted: str
    """Version as requested, as in stable-4.5.3."""
    source: str
    size_bytes: int
    sha256: str


def cache_folder() -> Path:
    """Return the folder of installed programs: under XDG_CACHE_HOME, or ~/.cache."""
    cache_home = os.environ.get("XDG_CACHE_HOME", "")
    # The XDG specification requires a relative path to be ignored.
    base = Path(cache_home) if Path(cache_home).is_absolute() else Path.home() / ".cache"
    return base / "angler-mjx" / PROGRAM_NAME


def find_binary(explicit: Path | None = None) -> Binary:
    """Return the program to run: ``explicit``, else ANGLER_ARDUSUB's, else the installed one.

    Raises:
        ConfigError: there is none, it cannot be run here, or its checksum is not the installed one.
    """
    if explicit is not None:
        return _load_named(explicit, "--ardusub")
    if named := os.environ.get(ENVIRONMENT_VARIABLE):
        return _load_named(Path(named).expanduser(), ENVIRONMENT_VARIABLE)
    path = cache_folder() / PROGRAM_NAME
    if not path.is_file():
        raise ConfigError(
            f"no ArduSub: none is installed in {path.parent}. Install one with angler sitl install "
            f"(without network: angler sitl install --from FILE), or name a program by --ardusub "
            f"or {ENVIRONMENT_VARIABLE}"
        )
    return load_installed(path)


def load_installed(path: Path) -> Binary:
    """Return a program with the record beside it.

    Raises:
        ConfigError: the file cannot be run here, or its checksum is not the recorded one.
    """
    check_program(path)
    record_path = path.with_name(RECORD_NAME)
    record = parse_model(BinaryRecord, read_toml(record_path), source=str(record_path))
    checksum = hash_file(path)
    if checksum != record.sha256:
        raise ConfigError(
            f"{path}: its sha256 is {checksum}, but {record.sha256} was recorded when it was "
            f"installed; it was changed since. Install it anew with angler sitl install"
        )
    return Binary(path=path, version=record.version, sha256=checksum)


def check_program(path: Path, *, run_bit: bool = True) -> None:
    """Refuse a file that this machine cannot run.

    Args:
        path: The file.
        run_bit: Whether permission to run it is also required.

    Raises:
        ConfigError: it is missing, unreadable, no ELF program, one of another machine, needs a
            dynamic loader that is not here, or must not be run.
    """
    try:
        with path.open("rb") as file:
            head = file.read(65_536)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    trouble = _find_fault(head)
    if trouble:
        raise ConfigError(f"{path}: {trouble}; give an ArduSub SITL built for this machine")
    if run_bit and not os.access(path, os.X_OK):
        raise ConfigError(f"{path}: no permission to run it; chmod +x {path}")


def _load_named(path: Path, source: str) -> Binary:
    """Return a program named by the user; a script that starts one (by exec) is accepted."""
    try:
        if not (_is_script(path) and os.access(path, os.X_OK)):
            check_program(path)
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from error
    return Binary(path=path, version=UNKNOWN_VERSION, sha256=hash_file(path))


def _is_script(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(2) == b"#!"
    except OSError:
        return False


def _find_fault(head: bytes) -> str | None:
    """Return the reason why this machine cannot run a file with this header, or None."""
    if head[:4] != b"\x7fELF":
        appearance = "a web page" if head.lstrip()[:1] == b"<" else "something else"
        return f"not a Linux program (no ELF file, {appearance})"
    if len(head) < 64 or head[5] != 1:
        return "not a complete little-endian ELF file"
    wide = head[4] == 2
    kind, machine = struct.unpack_from("<HH", head, 16)
    if kind not in (2, 3):
        return "an ELF file, but not a program"
    host_machine = platform.machine()
    if machine != _MACHINES.get(host_machine, machine):
        names = {number: name for name, number in _MACHINES.items()}
        return (
            f"a program for {names.get(machine, f'ELF machine {machine}')}, this is {host_machine}"
        )
    loader = _read_loader(head, wide)
    if loader is not None and not Path(loader).exists():
        return f"it needs the dynamic loader {loader}, which is not on this machine"
    return None


def _read_loader(head: bytes, wide: bool) -> str | None:
    """Return the path of a program's dynamic loader; None for a static one."""
    (table,) = struct.unpack_from("<Q" if wide else "<I", head, 32 if wide else 28)
    size, count = struct.unpack_from("<HH", head, 54 if wide else 42)
    for at in range(table, table + size * count, size):
        if at + size > len(head):
            break
        (kind,) = struct.unpack_from("<I", head, at)
        if kind != _INTERPRETER:
            continue
        if wide:
            offset, length = struct.unpack_from("<Q16xQ", head, at + 8)
        else:
            offset, length = struct.unpack_from("<I8xI", head, at + 4)
        return head[offset : offset + length].rstrip(b"\0").decode(errors="replace")
    return None
