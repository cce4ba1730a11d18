"""Files that are there whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from angler_mjx.errors import ConfigError, RunError


def require_free(path: Path, *, flag: str, force: bool = False) -> None:
    """Refuse a file that cannot take its name; see `replacing`."""
    if path.is_dir():
        raise ConfigError(f"{flag} {path}: is a folder; give the name of a file")
    if path.exists() and not force:
        how = "--force" if flag.startswith("--") else "force=True"
        raise ConfigError(f"{flag} {path}: exists; give another name, or replace it with {how}")


@contextmanager
def replacing(path: Path, *, flag: str, force: bool = False) -> Iterator[Path]:
    """A place beside a file in which to write it; it takes the file's name at the end.

    Whatever ends the writing early, an interrupt included, leaves nothing behind and an older file
    as it was.

    Args:
        path: the file.
        flag: how a person named it, for messages.
        force: replace an older file.

    Raises:
        ConfigError: the file exists, or its folder cannot be written.
        RunError: the disk gave out.
    """
    require_free(path, flag=flag, force=force)
    writing = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        writing.touch()
    except OSError as error:
        raise ConfigError(f"{flag} {path}: cannot be written ({error.strerror})") from error
    try:
        yield writing
        writing.replace(path)
    except OSError as error:
        raise RunError(f"{flag} {path}: cannot be written ({error.strerror or error})") from error
    finally:
        writing.unlink(missing_ok=True)
