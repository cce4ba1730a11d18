"""HTTP download that resumes a broken transfer."""

import fcntl
import http.client
import json
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO
from urllib.parse import urlsplit

from angler_mjx.errors import ConfigError, RunError

type TransferProgress = Callable[[int, int | None], None]
"""Receiver of the number of bytes so far, and of the total where the server states it."""

_TIMEOUT_S = 30.0
_CHUNK = 1 << 16
_TRIES = 3
_BROKEN = (urllib.error.URLError, http.client.HTTPException, ConnectionError, TimeoutError)


def fetch_file(url: str, part: Path, progress: TransferProgress) -> None:
    """Download ``url`` into ``part``, resuming a partial file of the same version.

    The server decides whether the version is the same: its ETag or date of change, kept in a file
    beside ``part``, goes back to it as If-Range. Without either, the download restarts.

    Args:
        url: http or https.
        part: File to fill. It stays after a failure, for the next attempt.
        progress: Receives the progress.

    Raises:
        ConfigError: no such scheme, no such file, or another process downloads it now.
        RunError: no connection, or it broke several times.
    """
    if urlsplit(url).scheme not in ("http", "https"):
        raise ConfigError(f"--url {url}: give an http or https address, or --from FILE")
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        with part.open("ab") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for retries_left in reversed(range(_TRIES)):
                if _try_transfer(url, file, _note_path(part), progress, last=retries_left == 0):
                    _note_path(part).unlink(missing_ok=True)
                    return
    except BlockingIOError as error:
        raise ConfigError(f"{part}: another angler sitl install fetches it now") from error
    except OSError as error:
        raise RunError(f"{part}: cannot be written ({error})") from error


def _try_transfer(
    url: str, file: BinaryIO, note: Path, progress: TransferProgress, *, last: bool
) -> bool:
    """Make one request; return whether the file is complete. A break raises only with ``last``."""
    try:
        return _transfer(url, file, note, progress)
    except urllib.error.HTTPError as error:
        if error.code == http.client.REQUESTED_RANGE_NOT_SATISFIABLE:
            file.truncate(0)
            return False
        raise ConfigError(
            f"{url}: the server answers {error.code} {error.reason}; correct --version or --url"
        ) from error
    except _BROKEN as error:
        if not last:
            return False
        reason = getattr(error, "reason", None) or error
        raise RunError(
            f"{url}: the transfer failed ({reason}). Run the same command again to go on, or, "
            "without "
            f"network, fetch this address on another machine, copy the file here and use "
            f"angler sitl install --from FILE"
        ) from error


def _transfer(url: str, file: BinaryIO, note: Path, progress: TransferProgress) -> bool:
    received, old_validator = file.seek(0, 2), _read_validator(note, url)
    headers = {"User-Agent": "angler-mjx"}
    if received and old_validator:
        headers |= {"Range": f"bytes={received}-", "If-Range": old_validator}
    with urllib.request.urlopen(
        urllib.request.Request(url, headers=headers), timeout=_TIMEOUT_S
    ) as response:
        is_partial = response.status == http.client.PARTIAL_CONTENT
        if not (
            is_partial
            and (response.headers["Content-Range"] or "").startswith(f"bytes {received}-")
        ):
            if is_partial:
                raise http.client.HTTPException("the server sent another part than was asked for")
            file.truncate(0)
            received = 0
        validator = response.headers["ETag"] or response.headers["Last-Modified"]
        note.write_text(json.dumps({"url": url, "mark": validator}), encoding="utf-8")
        length = response.headers["Content-Length"]
        total = None if length is None else received + int(length)
        progress(received, total)
        # Not read(): that holds back received data when a connection breaks.
        while chunk := response.read1(_CHUNK):
            file.write(chunk)
            received += len(chunk)
            progress(received, total)
    if total is not None and received < total:
        raise http.client.HTTPException(f"{received} of {total} bytes came")
    return True


def _note_path(part: Path) -> Path:
    return part.with_name(part.name + ".json")


def _read_validator(note: Path, url: str) -> str | None:
    try:
        record = json.loads(note.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    # A weak ETag ("W/...") does not promise the same bytes, and servers refuse it here.
    validator = record.get("mark") if record.get("url") == url else None
    return validator if isinstance(validator, str) and not validator.startswith("W/") else None
