"""Files that are whole or absent, also after a power failure."""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from angler_mjx.errors import ConfigError, RunError

if TYPE_CHECKING:
    import pyarrow as pa


@contextmanager
def wrap_write_errors(label: object, advice: str = "") -> Iterator[None]:
    """Write files inside; a failure of the disk becomes one message.

    Args:
        label: what is written, for the message.
        advice: what is kept, and what a person can do about it.

    Raises:
        RunError: an `OSError` was raised inside.
    """
    try:
        yield
    except OSError as error:
        reason, remedy = error.strerror or error, f"; {advice}" if advice else ""
        raise RunError(f"{label}: cannot be written ({reason}){remedy}") from error


def require_free(path: Path, *, flag: str, force: bool = False) -> None:
    """Refuse a file that cannot take its name; see `replace_file`."""
    try:
        is_folder, exists = path.is_dir(), path.exists()
    except OSError as error:  # too long, or in a folder that must not be looked into
        raise ConfigError(f"{flag} {path}: cannot be written ({error.strerror})") from error
    if is_folder:
        raise ConfigError(f"{flag} {path}: is a folder; give the name of a file")
    if exists and not force:
        hint = "--force" if flag.startswith("--") else "force=True"
        raise ConfigError(f"{flag} {path}: exists; give another name, or replace it with {hint}")


@contextmanager
def write_atomically(path: Path, *, durable: bool = True) -> Iterator[Path]:
    """Write a file inside, under another name beside it; it takes the file's name at the end.

    Whatever ends the writing early, an
    interrupt included, leaves nothing behind and an older file as it was.

    Args:
        path: the file; its folder is there.
        durable: have what was written on the disk before it takes the name.

    Raises:
        OSError: the disk gave out.
    """
    # In front of the name: what is written often depends on how it ends.
    temporary = path.with_name(f".unfinished.{path.name}")
    try:
        yield temporary
        if durable:
            sync_path(temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def replace_file(path: Path, *, flag: str, force: bool = False) -> Iterator[Path]:
    """Write a file that a user named as `write_atomically` does.

    Args:
        path: the file; its folder is made if need be.
        flag: how a person named it, for messages.
        force: replace an older file.

    Raises:
        ConfigError: the file exists, or its folder cannot be written.
        RunError: the disk gave out.
    """
    try:
        require_free(path, flag=flag, force=force)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.with_name(f".unfinished.{path.name}").touch()
    except OSError as error:
        raise ConfigError(f"{flag} {path}: cannot be written ({error.strerror})") from error
    with wrap_write_errors(f"{flag} {path}"), write_atomically(path) as writing:
        yield writing


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all.

    Raises:
        OSError: the disk gave out.
    """
    with write_atomically(path) as writing:
        writing.write_text(text, encoding="utf-8")


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file whole or not at all.

    Raises:
        OSError: the disk gave out.
    """
    with write_atomically(path) as writing:
        writing.write_bytes(data)


def write_json(path: Path, table: Mapping[str, object], *, indent: int = 2) -> None:
    """Write a table as indented JSON, whole or not at all.

    Raises:
        OSError: the disk gave out.
        ValueError: the table holds NaN or inf.
    """
    write_text(path, json.dumps(table, indent=indent, allow_nan=False) + "\n")


def write_parquet(
    path: Path, table: "pa.Table", *, compression: str = "snappy", page_checksums: bool = False
) -> None:
    """Write a table as Parquet, whole or not at all.

    Args:
        path: of the file.
        table: its rows.
        compression: codec of all columns.
        page_checksums: whether readers can detect damaged pages.

    Raises:
        OSError: the disk gave out.
    """
    import pyarrow.parquet as pq  # takes 0.1 s, which commands without tables need not spend

    with write_atomically(path) as writing:
        pq.write_table(table, writing, compression=compression, write_page_checksum=page_checksums)


def sync_path(path: Path) -> None:
    """Flush a file, or the names in a folder, to the disk.

    Raises:
        OSError: the disk gave out.
    """
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
