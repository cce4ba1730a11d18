"""Putting an ArduSub into the user's cache folder: fetched or copied, checked, asked, noted."""

import json
import os
import platform
import re
import shutil
import tempfile
from pathlib import Path

from angler_mjx.errors import AnglerError, ConfigError, RunError, UnsupportedError
from angler_mjx.files import parse, read_toml
from angler_mjx.runs.storage import atomic
from angler_sitl.firmware import fetch, probe
from angler_sitl.firmware.binary import (
    PROGRAM,
    RECORD,
    UNKNOWN,
    Binary,
    BinaryRecord,
    cache_folder,
    check_program,
    sha256,
)

DEFAULT_VERSION = "stable-4.5.3"
_OFFICIAL = "https://firmware.ardupilot.org/Sub/{version}/{board}/ardusub"
_BOARDS = {"x86_64": "SITL_x86_64_linux_gnu", "armv7l": "SITL_arm_linux_gnueabihf"}


def address(version: str) -> str:
    """Where the official build of a version lies, for this machine.

    Raises:
        ConfigError: that is no version's name.
        UnsupportedError: there are no official builds for this machine.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9.\-]*", version):
        raise ConfigError(f"--version {version}: give one as in {DEFAULT_VERSION}, or latest")
    if platform.machine() not in _BOARDS:
        raise UnsupportedError(
            f"there is no official ArduSub SITL for {platform.machine()}; build one and use "
            "angler sitl install --from FILE"
        )
    return _OFFICIAL.format(version=version, board=_BOARDS[platform.machine()])


def from_network(
    version: str, url: str | None, tell: fetch.Tell, *, checksum: str | None = None
) -> Binary:
    """Fetch a program and install it.

    Args:
        version: Which official build; of no meaning but as a name where ``url`` is given.
        url: Address of another build.
        tell: Told of progress.
        checksum: The sha256 that it must have.

    Raises:
        AnglerError: as `fetch.fetch`; or it is not an ArduSub for this machine, has another
            checksum than it had when the same was installed last, or says another version.
    """
    where = address(version) if url is None else url
    part = cache_folder() / f"{PROGRAM}.part"
    fetch.fetch(where, part, tell)
    official = version if url is None else None
    try:
        return _install(part, wanted=official or where, source=where, checksum=checksum)
    finally:
        part.unlink(missing_ok=True)


def from_file(path: Path, *, checksum: str | None = None) -> Binary:
    """Copy a program and install it; a record that lies beside it must be true of it.

    Raises:
        AnglerError: it is not an ArduSub for this machine, or has another checksum.
    """
    check_program(path, run_bit=False)
    beside = path.with_name(RECORD)
    if checksum is None and path.name == PROGRAM and beside.is_file():
        checksum = parse(BinaryRecord, read_toml(beside), source=str(beside)).sha256
    part = cache_folder() / f"{PROGRAM}.copy.{os.getpid()}"
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, part)
        return _install(part, wanted=path.name, source=str(path.resolve()), checksum=checksum)
    except OSError as error:
        raise RunError(f"{part}: cannot be written ({error})") from error
    finally:
        part.unlink(missing_ok=True)


def _install(part: Path, *, wanted: str, source: str, checksum: str | None) -> Binary:
    """Check a file in the cache folder and put it in place, its record after it."""
    check_program(part, run_bit=False)
    found = sha256(part)
    _compare(part.with_name(RECORD), wanted, source, found, checksum)
    part.chmod(0o755)
    said = _ask(Binary(path=part, version=UNKNOWN, sha256=found), source)
    number = wanted.removeprefix("stable-")
    if re.fullmatch(r"\d+\.\d+\.\d+", number) and said.version != number:
        raise ConfigError(f"{source}: {wanted} was asked for, but it says it is {said.version}")
    record = BinaryRecord(
        version=said.version,
        git=said.git,
        wanted=wanted,
        source=source,
        size_bytes=part.stat().st_size,
        sha256=found,
    )
    program, noted = part.with_name(PROGRAM), part.with_name(RECORD)
    # JSON's strings and whole numbers are TOML's.
    lines = [f"{key} = {json.dumps(value)}\n" for key, value in record.model_dump().items()]
    with atomic.whole(noted) as fresh:
        fresh.write_text("".join(lines), encoding="utf-8")
        part.replace(program)
    return Binary(path=program, version=said.version, sha256=found)


def _compare(noted: Path, wanted: str, source: str, found: str, checksum: str | None) -> None:
    if checksum is not None and found != checksum.lower():
        raise ConfigError(f"{source}: its sha256 is {found}, but it should be {checksum}")
    if not noted.is_file() or not wanted.startswith("stable-"):
        return
    before = parse(BinaryRecord, read_toml(noted), source=str(noted))
    # What was released does not change; what is called latest does.
    if before.wanted == wanted and before.sha256 != found:
        raise ConfigError(
            f"{source}: its sha256 is {found}, but {wanted} had {before.sha256} when it was "
            f"installed before; if you trust the new one, remove {noted} first"
        )


def _ask(binary: Binary, source: str) -> probe.Findings:
    with tempfile.TemporaryDirectory(prefix="angler_sitl_") as folder:
        try:
            with probe.standing_still(binary, Path(folder), {}) as still:
                return probe.ask(still, parameters=False)
        except AnglerError as error:
            raise ConfigError(f"{source}: it does not act as an ArduSub: {error}") from error
