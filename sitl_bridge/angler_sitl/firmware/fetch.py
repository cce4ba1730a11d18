"""Fetching a file over HTTP so that a broken transfer goes on where it stopped."""

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

type Tell = Callable[[int, int | None], None]
"""Given the bytes that are here, and all of them where the server says how many."""

_TIMEOUT_S = 30.0
_CHUNK = 1 << 16
_TRIES = 3
_BROKEN = (urllib.error.URLError, http.client.HTTPException, ConnectionError, TimeoutError)


def fetch(url: str, part: Path, tell: Tell) -> None:
    """Bring what lies at ``url`` into ``part``, going on from what is there of the same version.

    Whether it is the same version is the server's to say: its ETag or date of change, kept in a
    file beside ``part``, goes back to it as If-Range. Without either, it begins again.

    Args:
        url: http or https.
        part: File to fill. It stays when this fails, for the next time.
        tell: Told of progress.

    Raises:
        ConfigError: no such scheme, the server has no such file, or somebody else fetches it now.
        RunError: no connection, or it broke several times.
    """
    if urlsplit(url).scheme not in ("http", "https"):
        raise ConfigError(f"--url {url}: give an http or https address, or --from FILE")
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        with part.open("ab") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for left in reversed(range(_TRIES)):
                if _once(url, file, _note_of(part), tell, last=left == 0):
                    _note_of(part).unlink(missing_ok=True)
                    return
    except BlockingIOError as error:
        raise ConfigError(f"{part}: another angler sitl install fetches it now") from error
    except OSError as error:
        raise RunError(f"{part}: cannot be written ({error})") from error


def _once(url: str, file: BinaryIO, note: Path, tell: Tell, *, last: bool) -> bool:
    """One request; whether all is here. A connection that breaks is an error the last time only."""
    try:
        return _transfer(url, file, note, tell)
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
        why = getattr(error, "reason", None) or error
        raise RunError(
            f"{url}: the transfer failed ({why}). Run the same command again to go on, or, without "
            f"network, fetch this address on another machine, copy the file here and use "
            f"angler sitl install --from FILE"
        ) from error


def _transfer(url: str, file: BinaryIO, note: Path, tell: Tell) -> bool:
    here, mark = file.seek(0, 2), _read_mark(note, url)
    headers = {"User-Agent": "angler-mjx"}
    if here and mark:
        headers |= {"Range": f"bytes={here}-", "If-Range": mark}
    with urllib.request.urlopen(
        urllib.request.Request(url, headers=headers), timeout=_TIMEOUT_S
    ) as answer:
        goes_on = answer.status == http.client.PARTIAL_CONTENT
        if not (goes_on and (answer.headers["Content-Range"] or "").startswith(f"bytes {here}-")):
            if goes_on:
                raise http.client.HTTPException("the server sent another part than was asked for")
            file.truncate(0)
            here = 0
        new = answer.headers["ETag"] or answer.headers["Last-Modified"]
        note.write_text(json.dumps({"url": url, "mark": new}), encoding="utf-8")
        length = answer.headers["Content-Length"]
        total = None if length is None else here + int(length)
        tell(here, total)
        # Not read(): that holds back what came when a connection breaks.
        while chunk := answer.read1(_CHUNK):
            file.write(chunk)
            here += len(chunk)
            tell(here, total)
    if total is not None and here < total:
        raise http.client.HTTPException(f"{here} of {total} bytes came")
    return True


def _note_of(part: Path) -> Path:
    return part.with_name(part.name + ".json")


def _read_mark(note: Path, url: str) -> str | None:
    try:
        noted = json.loads(note.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    # A weak ETag ("W/...") does not promise the same bytes, and servers refuse it here.
    mark = noted.get("mark") if noted.get("url") == url else None
    return mark if isinstance(mark, str) and not mark.startswith("W/") else None
