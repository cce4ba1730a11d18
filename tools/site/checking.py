"""Check a built site by its HTML alone: links, anchors, pictures, menus, nothing from outside."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

UNLISTED = {"search.html", "genindex.html", "py-modindex.html", "404.html"}
"""Pages that Sphinx adds; no menu has to reach them."""
RAW_LINK = re.compile(r"\[[^\[\]\n]+\]\([^()\s]+\.(?:md|ipynb)(?:#[^()\s]*)?\)")
LOADED = {
    "audio": ("src",),
    "embed": ("src",),
    "iframe": ("src",),
    "img": ("src", "srcset"),
    "script": ("src",),
    "source": ("src", "srcset"),
    "video": ("src", "poster"),
}
"""Attributes whose targets a browser loads with the page."""


@dataclass
class Page:
    """Links, loads and anchors of a page."""

    links: list[str] = field(default_factory=list)
    menu: list[str] = field(default_factory=list)
    """Those of the links that stand in a menu."""
    loads: list[str] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)
    text: list[str] = field(default_factory=list)
    nameless: list[str] = field(default_factory=list)
    """Pictures without a text for those who do not see them."""


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.page = Page()
        self._menus = 0

    def handle_starttag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        page = self.page
        page.anchors |= {values[name] for name in ("id", "name") if values.get(name)}
        self._menus += tag == "nav"
        if tag == "a" and "href" in values:
            page.links.append(values["href"])
            if self._menus:
                page.menu.append(values["href"])
        elif tag == "link" and values.get("rel") not in {"canonical", "prev", "next", "search"}:
            page.loads.append(values.get("href", ""))
        page.loads += [values[name] for name in LOADED.get(tag, ()) if values.get(name)]
        if tag == "img" and not values.get("alt", "").strip():
            page.nameless.append(values.get("src", ""))

    def handle_data(self, data: str) -> None:
        self.page.text.append(data)

    def handle_endtag(self, tag: str) -> None:
        self._menus -= tag == "nav"


def check_site(folder: Path) -> Sequence[str]:
    """Return the faults of a built site; none if all is well.

    Args:
        folder: site of one version.
    """
    pages = {}
    for file in sorted(folder.rglob("*.html")):
        if "_static" in file.relative_to(folder).parts:  # templates of the theme, no pages
            continue
        reader = _Reader()
        reader.feed(file.read_text(encoding="utf-8"))
        pages[file.resolve()] = reader.page
    faults = [fault for file, page in pages.items() for fault in _check_page(file, page, pages)]
    names = {file.relative_to(folder.resolve()).as_posix(): file for file in pages}
    reached = _reach(names["index.html"], pages) if "index.html" in names else set()
    faults += [
        f"no menu reaches {name}"
        for name, file in names.items()
        if file not in reached and name not in UNLISTED
    ]
    for sheet in sorted(folder.rglob("*.css")):
        for target in re.findall(r"(?:url\(|@import )['\"]?(https?:|//)", sheet.read_text("utf-8")):
            faults.append(f"{sheet.relative_to(folder)}: loads from outside ({target})")
    return [fault.replace(f"{folder.resolve()}/", "") for fault in faults]


def _check_page(file: Path, page: Page, pages: Mapping[Path, Page]) -> Iterator[str]:
    for link in page.links:
        if fault := _check_link(file, link, pages):
            yield f"{file}: {link}: {fault}"
    for link in page.loads:
        if re.match(r"https?:|//", link):
            yield f"{file}: {link}: loaded from outside"
        elif not link.startswith("data:") and not _resolve(file, link).exists():
            yield f"{file}: {link}: no such file"
    for link in RAW_LINK.findall("".join(page.text)):
        yield f"{file}: {link}: Markdown that is shown as it stands, as in a block of code"
    for source in page.nameless:
        yield f"{file}: {source}: a picture without a text"


def _check_link(file: Path, link: str, pages: Mapping[Path, Page]) -> str:
    """Return the fault of a link; empty without one. Links to outside are not followed."""
    parts = urlsplit(link)
    if parts.scheme:
        return "" if parts.scheme in {"http", "https", "mailto"} else "unknown scheme"
    target = _resolve(file, link)
    if not target.is_file():
        return "no such file"
    if parts.fragment and target in pages:
        anchors = pages[target].anchors
        if parts.fragment not in anchors and unquote(parts.fragment) not in anchors:
            return "no such anchor"
    return ""


def _resolve(file: Path, link: str) -> Path:
    path = unquote(urlsplit(link).path)
    return (file.parent / path).resolve() if path else file


def _reach(first: Path, pages: Mapping[Path, Page]) -> set[Path]:
    seen, new = set[Path](), {first}
    while new:
        seen |= new
        new = {
            target
            for file in new
            for link in pages[file].menu
            if not urlsplit(link).scheme and (target := _resolve(file, link)) in pages
        } - seen
    return seen
