"""Paths in foreign files: ``package://``, ``model://``, ``$(find ...)`` and relative ones.

No file outside the folder of the vehicle's package, and outside the folders that the user names, is
opened.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from angler_mjx.errors import format_value
from angler_mjx.robot.importing.xml_tree import Element

_MAX_LEVELS = 5
"""Max depth below a named folder at which packages are looked for."""
_PACKAGE_NAME = re.compile(r"<name>\s*([^<\s]+)\s*</name>")


@dataclass(frozen=True, kw_only=True)
class Packages:
    """Folders from which files may be read."""

    root: Path
    """Package of the vehicle's file: the nearest folder around it with a package.xml, or its own
    folder."""
    folders: tuple[Path, ...]
    """Folders named by the user."""
    _found: dict[str, Path | None] = field(default_factory=dict, compare=False)

    def find_package(self, name: str, element: Element) -> Path:
        """Return the folder of a package.

        Raises:
            ConfigError: no folder has this name or a package.xml of it.
        """
        if name not in self._found:
            self._found[name] = next(
                (path for base in (self.root, *self.folders) if (path := _search(base, name, 0))),
                None,
            )
        folder = self._found[name]
        if folder is None:
            element.fail(
                f"package {format_value(name)} is not below "
                f"{', '.join(str(base) for base in (self.root, *self.folders))}; name the folder "
                "that holds it by --packages"
            )
        return folder

    def locate(self, name: str, element: Element) -> Path:
        """Return the path of a file that an element names; the file may be missing.

        Args:
            name: path, relative to the element's file, or with package://, model:// or file://.
            element: for its file and messages.

        Raises:
            ConfigError: unknown package, or a path outside the permitted folders.
        """
        scheme, sign, rest = name.partition("://")
        if sign and scheme in ("package", "model"):
            package, _, inside = rest.partition("/")
            path = self.find_package(package, element) / inside
        elif sign and scheme == "file":
            path = Path(rest)
        elif sign:
            element.fail(f"{format_value(name)}: {scheme}:// is not read; write a path")
        else:
            path = element.location.file.parent / name
        resolved = path.resolve()
        if not any(resolved.is_relative_to(base) for base in (self.root, *self.folders)):
            element.fail(
                f"{format_value(name)} lies outside {self.root}; files from there are not opened "
                "unless --packages names their folder"
            )
        return resolved


def open_packages(path: Path, folders: Sequence[Path]) -> Packages:
    """Return the permitted folders of a vehicle's file."""
    around = [base for base in path.resolve().parents if (base / "package.xml").is_file()]
    root = around[0] if around else path.resolve().parent
    return Packages(root=root, folders=tuple(base.resolve() for base in folders))


def _search(folder: Path, name: str, level: int) -> Path | None:
    """Return the folder of a package at or below ``folder``, nearest level first."""
    if folder.name == name or _package_name(folder) == name:
        return folder
    levels = [folder]
    for _ in range(_MAX_LEVELS - level):
        levels = [path for base in levels for path in _list_folders(base)]
        for path in levels:
            if _package_name(path) == name or (
                path.name == name and not (path / "package.xml").exists()
            ):
                return path
    return None


def _list_folders(folder: Path) -> list[Path]:
    """Return the folders in a folder, without hidden ones and links; none where not permitted."""
    try:
        entries = sorted(folder.iterdir())
        return [
            path
            for path in entries
            if path.is_dir() and not path.is_symlink() and not path.name.startswith(".")
        ]
    except OSError:
        return []


def _package_name(folder: Path) -> str | None:
    manifest = folder / "package.xml"
    if not manifest.is_file():
        return None
    try:
        match = _PACKAGE_NAME.search(manifest.read_text(encoding="utf-8", errors="replace"))
    except OSError:
        return None
    return None if match is None else match[1]
