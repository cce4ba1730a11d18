"""Menu of the site, read from docs/README.md: headings, groups and links in its order."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

LINK = re.compile(r"\[(?:[^\]]*)\]\(([^)#\s]+)\)")
GROUP = re.compile(r"^- \*\*(.+?)\*\*: ", re.MULTILINE)


class MenuError(Exception):
    """The menu and the pages of the documentation do not agree."""


@dataclass(frozen=True)
class Group:
    """Pages of one group, under a caption."""

    title: str
    pages: tuple[Path, ...]
    """Files of the pages, absolute, in order."""


@dataclass(frozen=True)
class Section:
    """Section of the menu: one heading of docs/README.md."""

    title: str
    groups: tuple[Group, ...]

    @property
    def slug(self) -> str:
        """Return the name of the folder that holds the first page of the section."""
        return re.sub(r"\W+", "_", self.title.lower())


def read_menu(docs: Path) -> tuple[Section, ...]:
    """Return the sections of the menu.

    A link to a folder stands for all pages in it, by name.

    Args:
        docs: folder of the documentation.

    Raises:
        MenuError: a link leads nowhere, a page stands twice, or a page of the folder in none.
    """
    readme = docs / "README.md"
    parts = re.split(r"(?m)^## (.+)$", readme.read_text(encoding="utf-8"))[1:]
    sections = tuple(
        Section(title, tuple(_groups(text, docs)))
        for title, text in zip(parts[::2], parts[1::2], strict=True)
    )
    _check_menu(sections, docs, readme)
    return sections


def _groups(text: str, docs: Path) -> Sequence[Group]:
    pieces = GROUP.split(text)[1:]
    return [
        Group(title, tuple(page for link in LINK.findall(links) for page in _pages(docs, link)))
        for title, links in zip(pieces[::2], pieces[1::2], strict=True)
    ]


def _pages(docs: Path, link: str) -> Sequence[Path]:
    target = (docs / link).resolve()
    if target.is_dir():
        return sorted(target.glob("*.md"))
    if not target.is_file():
        raise MenuError(f"docs/README.md: {link}: no such page")
    return [target]


def _check_menu(sections: Sequence[Section], docs: Path, readme: Path) -> None:
    listed = [page for section in sections for group in section.groups for page in group.pages]
    twice = sorted({str(page.name) for page in listed if listed.count(page) > 1})
    if twice:
        raise MenuError(f"docs/README.md: listed twice: {', '.join(twice)}")
    unlisted = sorted(
        page.relative_to(docs).as_posix()
        for page in (*docs.resolve().rglob("*.md"), *docs.resolve().rglob("*.ipynb"))
        if page != readme.resolve() and page not in listed
    )
    if unlisted:
        raise MenuError(
            f"docs/README.md: no menu reaches {', '.join(unlisted)}; add a link in a group"
        )
