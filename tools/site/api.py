"""Pages of the public names, one for each table of api.toml."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from inspect import isclass, isfunction
from pathlib import Path

from sphinx.ext.autodoc.mock import mock

FILE = Path(__file__).parent / "api.toml"

MOCKED = [name for name in ("torch",) if find_spec(name) is None]
"""Libraries of no extra, which documented modules import, where they are not installed."""


@dataclass(frozen=True, kw_only=True)
class ApiPage:
    """A page of public names."""

    name: str
    title: str
    text: str
    names: tuple[str, ...]
    """Names by which they are imported, with their modules."""


def read_pages() -> tuple[ApiPage, ...]:
    """Return the pages in the order of their file."""
    tables = tomllib.loads(FILE.read_text(encoding="utf-8"))["page"]
    return tuple(
        ApiPage(
            name=table["name"],
            title=table["title"],
            text=table["text"],
            names=tuple(table["names"]),
        )
        for table in tables
    )


def write_pages(target: Path) -> None:
    """Write the pages and the first one, which lists all names, as sources of Sphinx."""
    target.mkdir(parents=True, exist_ok=True)
    pages = read_pages()
    for page in pages:
        text = _heading(page.title, "=") + f"{page.text}\n\n" + _table(page.names)
        text += "".join(_entry(name) for name in page.names)
        (target / f"{page.name}.rst").write_text(text, encoding="utf-8")
    first = _heading("API", "=") + (
        "Public names of Python. Shapes stand in brackets: ``[R, 3]`` is three numbers of each "
        "robot. Symbols, frames and units: :doc:`/reference/notation`.\n\n"
    )
    for page in pages:
        first += _heading(page.title, "-") + f":doc:`{page.name}`: {page.text}\n\n"
        first += _table(page.names)
    first += ".. toctree::\n   :hidden:\n\n" + "".join(f"   {page.name}\n" for page in pages)
    (target / "index.rst").write_text(first, encoding="utf-8")


def _heading(title: str, mark: str) -> str:
    return f"{title}\n{mark * len(title)}\n\n"


def resolve_name(name: str) -> object:
    """Return what a name with its module stands for."""
    module, _, attribute = name.rpartition(".")
    with mock(MOCKED):
        return getattr(import_module(module), attribute)


def _first_line(name: str) -> str:
    value = resolve_name(name)
    if not (isclass(value) or isfunction(value)):
        return ""
    return " ".join((value.__doc__ or "").strip().split("\n\n")[0].split())


def _table(names: Sequence[str]) -> str:
    rows = "".join(
        f"   * - :py:obj:`{name.rpartition('.')[2]} <{name}>`\n     - {_first_line(name)}\n"
        for name in names
    )
    return f".. list-table::\n   :widths: 30 70\n   :class: names\n\n{rows}\n"


def _entry(name: str) -> str:
    value, short = resolve_name(name), name.rpartition(".")[2]
    kind = "autoclass" if isclass(value) else "autofunction" if isfunction(value) else "autodata"
    text = _heading(short, "-") + f".. {kind}:: {name}\n"
    if kind == "autoclass":
        text += "   :members:\n   :member-order: bysource\n"
    return text + "\n"
