"""Files that come with the package, each in the folder ``shipped`` of the package that reads it."""

import importlib.resources
import os.path
from pathlib import Path

from angler_mjx.errors import ConfigError, format_value


def list_shipped(package: str) -> dict[str, Path]:
    """Return names and paths of the files that a package ships, sorted by name.

    Args:
        package: dotted name of a package with a folder ``shipped``.
    """
    folder = importlib.resources.files(package) / "shipped"
    return {path.stem: path for path in sorted(Path(str(folder)).glob("*.toml"))}


def find_shipped(
    name_or_path: str | Path, package: str, kind: str, *, folders: bool = False
) -> Path:
    """Return the file of a name or path; a shipped name takes precedence.

    Args:
        name_or_path: name of a shipped file; or path of a ``.toml`` file, or of an existing file.
        package: dotted name of the package that ships files of this kind.
        kind: kind of file, for the message.
        folders: accept the path of an existing folder too.

    Raises:
        ConfigError: it is neither a shipped name nor such a path; names the shipped files.
    """
    files, path = list_shipped(package), Path(name_or_path)
    if str(name_or_path) in files:
        return files[str(name_or_path)]
    # A name too long for the file system is no path; pathlib's methods would raise.
    if path.suffix == ".toml" or os.path.isfile(path) or (folders and os.path.isdir(path)):
        return path
    folder = " or of a results folder" if folders else ""
    raise ConfigError(
        f"unknown {kind} {format_value(str(name_or_path))}; there is {', '.join(files)}, "
        f"or give the path of a .toml file{folder}"
    )
