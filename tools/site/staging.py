"""Stage the sources of the site: copies of the pages with links that hold in the site."""

import os
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tools.site import api, examples, gallery, notebook_pages
from tools.site.menu import MenuError, Section, read_menu

ROOT = Path(__file__).parents[2]
THEME = Path(__file__).parent / "theme"
FENCE = re.compile(r"(?ms)^(`{3,}|~{3,})[^\n]*\n.*?^\1`*[ ]*$|`[^`\n]+`")
LINK = re.compile(r"(\]\()([^)#\s]+)(#[^)\s]*)?(\))")
NAMED_PAGE = re.compile(r"`(docs/[a-z0-9_/]+\.md)(#[\w-]+)?`")
FILES = "files"
"""Folder of the site for files outside docs that pages link to."""
PROJECT = "project"
"""Folder of the site for pages outside docs."""


@dataclass(frozen=True)
class Stage:
    """Where files of the repository stand among the sources of the site."""

    root: Path
    """Repository."""
    target: Path
    """Folder of the staged sources."""
    pages: Mapping[Path, str]
    """Staged path of each page, relative to the target."""

    def locate(self, path: Path) -> str | None:
        """Return the staged path of a file of the repository, relative to the target.

        A file outside docs is copied when it is located first. None without such a file.
        """
        if path in self.pages:
            return self.pages[path]
        docs = self.root / "docs"
        if path in {docs / "generated", docs / "examples"}:
            return {"generated": "all_pages.md", "examples": "examples.md"}[path.name]
        if path.is_dir() and (self.target / path.relative_to(docs) / "index.md").is_file():
            return f"{path.relative_to(docs).as_posix()}/index.md"
        if path.is_relative_to(docs) and (self.target / path.relative_to(docs)).is_file():
            return path.relative_to(docs).as_posix()
        if not path.is_file():
            return None
        if path.is_relative_to(docs):
            return path.relative_to(docs).as_posix()
        name = f"{FILES}/{path.relative_to(self.root).as_posix()}"
        (self.target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, self.target / name)
        return name


def stage_site(target: Path, films: Path | None, root: Path = ROOT) -> None:
    """Write the sources of the site.

    Args:
        target: folder of the sources; made anew.
        films: folder of ``angler gallery`` whose films the site shows; none if None.
        root: repository.

    Raises:
        MenuError: a link leads nowhere, or no menu reaches a page.
    """
    docs = root / "docs"
    sections = read_menu(docs)
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(docs, target, ignore=shutil.ignore_patterns("*.md", gallery.FOLDER))
    (target / gallery.EXTRA).mkdir()
    shutil.copytree(THEME / "_static", target / "_static")
    shutil.copytree(THEME / "_templates", target / "_templates")
    shutil.copyfile(THEME / "conf.py", target / "conf.py")
    stage = Stage(root, target, _map_pages(root, sections))
    _write_folder_index(target, "decisions", "Decisions", stage)
    for page, name in stage.pages.items():
        if page == root / "README.md":
            continue
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        if page.suffix == ".ipynb":
            for picture, data in notebook_pages.list_pictures(page).items():
                (target / name).with_name(picture).write_bytes(data)
        (target / name).write_text(rewrite_links(page, name, stage), encoding="utf-8")
    for section in sections:
        _write_section(section, stage)
    api.write_pages(target / "api")
    examples.write_pages(docs / "examples", target)
    gallery.write_page(target, docs, films)
    stage.locate(root / "CITATION.cff")
    landing = (THEME / "landing.md").read_text(encoding="utf-8")
    (target / "index.md").write_text(gallery.fill_hero(landing, target), encoding="utf-8")


def rewrite_links(page: Path, name: str, stage: Stage) -> str:
    """Return the text of a page with links to where its targets are staged.

    Args:
        page: file of the page.
        name: where it is staged, relative to the target.
        stage: where its targets are staged.

    Raises:
        MenuError: a link leads to no file.
    """

    def rewrite(found: re.Match[str]) -> str:
        before, link, anchor, after = found[1], found[2], found[3] or "", found[4]
        if re.match(r"[a-z]+:", link):
            return found[0]
        located = stage.locate((page.parent / link).resolve())
        if located is None:
            raise MenuError(f"{page.relative_to(stage.root)}: {link}: no such file")
        path = os.path.relpath(located, Path(name).parent)
        return f"{before}{Path(path).as_posix()}{anchor}{after}"

    def link_pages(found: re.Match[str]) -> str:
        target = stage.pages.get(stage.root / found[1])
        if target is None:
            return found[0]
        path = os.path.relpath(target, Path(name).parent)
        return f"[{read_title(stage.root / found[1])}]({Path(path).as_posix()}{found[2] or ''})"

    text = read_page(page)
    if page == stage.root / "CHANGELOG.md":
        text = format_changes(text)
    text = _outside_code(text, lambda rest: LINK.sub(rewrite, rest))
    # Messages and docstrings name pages by their paths, so generated tables do as well.
    return NAMED_PAGE.sub(link_pages, text) if name.startswith(("generated/", PROJECT)) else text


def format_changes(text: str) -> str:
    """Return a changelog without brackets in headings, and without versions that have no text."""
    text = re.sub(r"(?m)^## \[[^\]]+\]\n+(?=## |\Z)", "", text)
    return re.sub(r"(?m)^## \[([^\]]+)\]", r"## \1", text)


def _outside_code(text: str, change: Callable[[str], str]) -> str:
    """Return the text, changed outside code. A link may have code as its label."""
    kept: list[str] = []

    def keep(found: re.Match[str]) -> str:
        kept.append(found[0])
        return f"\x00{len(kept) - 1}\x00"

    changed = change(FENCE.sub(keep, text))
    return re.sub(r"\x00(\d+)\x00", lambda found: kept[int(found[1])], changed)


def _map_pages(root: Path, sections: Sequence[Section]) -> Mapping[Path, str]:
    docs = root / "docs"
    pages = {root / "README.md": "index.md", docs / "README.md": "all_pages.md"}
    for section in sections:
        for group in section.groups:
            for page in group.pages:
                if page.is_relative_to(docs):
                    pages[page] = page.relative_to(docs).with_suffix(".md").as_posix()
                    continue
                outside = page.relative_to(root)
                folder = outside.parent.name if outside.parent.name else outside.stem.lower()
                pages[page] = f"{PROJECT}/{folder}.md"
    return pages


def read_page(page: Path) -> str:
    """Return the Markdown of a page, which may be a notebook."""
    if page.suffix == ".ipynb":
        return notebook_pages.format_page(page)
    return page.read_text(encoding="utf-8")


def read_title(page: Path) -> str:
    """Return the first heading of a page, without its mark."""
    found = re.search(r"(?m)^# (.+)$", read_page(page))
    if found is None:
        raise MenuError(f"{page}: no heading")
    return found[1]


def read_summary(page: Path) -> str:
    """Return the first sentence below the title of a page, without marks.

    Empty where a page does not begin with a paragraph.
    """
    text = re.split(r"(?m)^# .+$", read_page(page), maxsplit=1)[1]
    block = re.split(r"\n\s*\n", text.strip("\n"))[0]
    if re.match(r"[#|<!>\-*]|```|    ", block):
        return ""
    plain = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", " ".join(block.split()))
    sentence = re.split(r"(?<=[.:])\s+(?=[A-Z`\[])", plain.replace("**", ""))[0]
    return re.sub(r":$", ".", sentence)


def _write_folder_index(target: Path, folder: str, title: str, stage: Stage) -> None:
    pages = [page for page, name in stage.pages.items() if name.startswith(f"{folder}/")]
    rows = "\n".join(f"- [{read_title(page)}]({page.name})" for page in pages)
    names = "\n".join(page.stem for page in pages)
    about = "Each page records one decision: what was decided, why, and what was tried."
    text = f"# {title}\n\n{about}\n\n{rows}\n\n```{{toctree}}\n:hidden:\n\n{names}\n```\n"
    (target / folder).mkdir(exist_ok=True)
    (target / folder / "index.md").write_text(text, encoding="utf-8")


def _write_section(section: Section, stage: Stage) -> None:
    """Write the first page of a section: a card for each page, and its part of the menu."""
    lines = [f"# {section.title}", ""]
    for group in section.groups:
        names = [f"/{stage.pages[page].removesuffix('.md')}" for page in group.pages]
        if all(name.startswith("/decisions/") for name in names):
            continue
        shown = [
            (page, name)
            for page, name in zip(group.pages, names, strict=True)
            if not name.startswith("/decisions/")
        ]
        menu = [name for _, name in shown]
        if len(shown) < len(names):
            menu.append("/decisions/index")
        if len(section.groups) > 1:
            lines += [f"## {group.title}", ""]
        lines += ["::::{grid} 1 1 2 2", ":gutter: 3", ":class-container: pages", ""]
        for page, name in shown:
            lines += [
                f":::{{grid-item-card}} {read_title(page)}",
                f":link: {name}",
                ":link-type: doc",
                "",
                read_summary(page),
                ":::",
                "",
            ]
        lines += ["::::", "", "```{toctree}", ":hidden:", f":caption: {group.title}", "", *menu]
        lines += ["```", ""]
    if section.slug == PROJECT:
        lines += ["```{toctree}", ":hidden:", "", "/all_pages", "```", ""]
    folder = stage.target / section.slug
    folder.mkdir(exist_ok=True)
    (folder / "index.md").write_text("\n".join(lines), encoding="utf-8")
