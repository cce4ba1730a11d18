"""Installation of an ArduSub into the user's cache folder: copied, checked, probed, recorded."""

import json
import os
import platform
import re
import shutil
import tempfile
from pathlib import Path

from angler_mjx.errors import AnglerError, ConfigError, RunError, UnsupportedError
from angler_mjx.files import parse_model, read_toml
from angler_mjx.runs.storage import atomic_files
from angler_mjx.runs.storage.checksums import hash_file
from angler_sitl.firmware import download, probe
from angler_sitl.firmware.binary import (
    PROGRAM_NAME,
    RECORD_NAME,
    UNKNOWN_VERSION,
    Binary,
    BinaryRecord,
    cache_folder,
    check_program,
)

DEFAULT_VERSION = "stable-4.5.3"
_OFFICIAL_URL = "https://firmware.ardupilot.org/Sub/{version}/{board}/ardusub"
_BOARDS = {"x86_64": "SITL_x86_64_linux_gnu", "armv7l": "SITL_arm_linux_gnueabihf"}


def official_url(version: str) -> str:
    """Return the URL of the official build of a version, for this machine.

    Raises:
        ConfigError: the version name is invalid.
        UnsupportedError: there are no official builds for this machine.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9.\-]*", version):
        raise ConfigError(f"--version {version}: give one as in {DEFAULT_VERSION}, or latest")
    if platform.machine() not in _BOARDS:
        raise UnsupportedError(
            f"there is no official ArduSub SITL for {platform.machine()}; build one and use "
            "angler sitl install --from FILE"
        )
    return _OFFICIAL_URL.format(version=version, board=_BOARDS[platform.machine()])


def install_from_network(
    version: str,
    url: str | None,
    progress: download.TransferProgress,
    *,
    checksum: str | None = None,
) -> Binary:
    """Download a program and install it.

    Args:
        version: Official build; only a name where ``url`` is given.
        url: Address of another build.
        progress: Receives the progress.
        checksum: The required sha256.

    Raises:
        AnglerError: as `download.fetch_file`; or it is not an ArduSub for this machine, its
            checksum differs from its last installation, or it reports another version.
    """
    source_url = official_url(version) if url is None else url
    part = cache_folder() / f"{PROGRAM_NAME}.part"
    download.fetch_file(source_url, part, progress)
    official = version if url is None else None
    try:
        return _install(part, wanted=official or source_url, source=source_url, checksum=checksum)
    finally:
        part.unlink(missing_ok=True)


def install_from_file(path: Path, *, checksum: str | None = None) -> Binary:
    """Copy a program and install it; a record beside it must match.

    Raises:
        AnglerError: it is not an ArduSub for this machine, or has another checksum.
    """
    check_program(path, run_bit=False)
    record_path = path.with_name(RECORD_NAME)
    if checksum is None and path.name == PROGRAM_NAME and record_path.is_file():
        checksum = parse_model(BinaryRecord, read_toml(record_path), source=str(record_path)).sha256
    part = cache_folder() / f"{PROGRAM_NAME}.copy.{os.getpid()}"
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, part)
        return _install(part, wanted=path.name, source=str(path.resolve()), checksum=checksum)
    except OSError as error:
        raise RunError(f"{part}: cannot be written ({error})") from error
    finally:
        part.unlink(missing_ok=True)


def _install(part: Path, *, wanted: str, source: str, checksum: str | None) -> Binary:
    """Check a file in the cache folder and put it in place, followed by its record."""
    check_program(part, run_bit=False)
    digest = hash_file(part)
    _check_checksum(part.with_name(RECORD_NAME), wanted, source, digest, checksum)
    part.chmod(0o755)
    findings = _probe_version(Binary(path=part, version=UNKNOWN_VERSION, sha256=digest), source)
    version_number = wanted.removeprefix("stable-")
    if re.fullmatch(r"\d+\.\d+\.\d+", version_number) and findings.version != version_number:
        raise ConfigError(f"{source}: {wanted} was asked for, but it says it is {findings.version}")
    record = BinaryRecord(
        version=findings.version,
        git=findings.git,
        wanted=wanted,
        source=source,
        size_bytes=part.stat().st_size,
        sha256=digest,
    )
    program, record_path = part.with_name(PROGRAM_NAME), part.with_name(RECORD_NAME)
    # JSON's strings and whole numbers are TOML's.
    lines = [f"{key} = {json.dumps(value)}\n" for key, value in record.model_dump().items()]
    with atomic_files.write_atomically(record_path) as temporary:
        temporary.write_text("".join(lines), encoding="utf-8")
        part.replace(program)
    return Binary(path=program, version=findings.version, sha256=digest)


def _check_checksum(
    record_path: Path, wanted: str, source: str, digest: str, checksum: str | None
) -> None:
    if checksum is not None and digest != checksum.lower():
        raise ConfigError(f"{source}: its sha256 is {digest}, but it should be {checksum}")
    if not record_path.is_file() or not wanted.startswith("stable-"):
        return
    previous = parse_model(BinaryRecord, read_toml(record_path), source=str(record_path))
    # A release does not change; the latest build does.
    if previous.wanted == wanted and previous.sha256 != digest:
        raise ConfigError(
            f"{source}: its sha256 is {digest}, but {wanted} had {previous.sha256} when it was "
            f"installed before; if you trust the new one, remove {record_path} first"
        )


def _probe_version(binary: Binary, source: str) -> probe.ProbeResult:
    with tempfile.TemporaryDirectory(prefix="angler_sitl_") as folder:
        try:
            with probe.start_stationary(binary, Path(folder), {}) as autopilot:
                return probe.query_autopilot(autopilot, parameters=False)
        except AnglerError as error:
            raise ConfigError(f"{source}: it does not act as an ArduSub: {error}") from error
