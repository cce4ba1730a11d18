"""Page of films and figures. Figures are those of the pages, films those of ``angler gallery``."""

import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from angler_mjx.studies.gallery.films import FILMS

FIGURE = re.compile(r"!\[([^\]]*)\]\(([^)\s]+)\)")
FOLDER = "films"
"""Folder of the films, in the documentation and in the site."""
EXTRA = "extra"
"""Folder of the staged sources whose content is copied into the site as it is."""
RECORD = "films.json"
"""Lines of commands of each film, by name, beside the films."""


@dataclass(frozen=True)
class Figure:
    """A figure of a page."""

    caption: str
    image: str
    """Path in the site."""
    page: str
    title: str
    """Title of the page."""


def list_figures(docs: Path) -> Sequence[Figure]:
    """Return the figures of all pages, those of how-to pages first."""
    figures = []
    order = ("how_to", "tutorials", "reference", "explanation", "generated")
    for folder in order:
        for page in sorted((docs / folder).glob("*.md")):
            text = page.read_text(encoding="utf-8")
            title = re.search(r"(?m)^# (.+)$", text)
            for caption, link in FIGURE.findall(text):
                image = (page.parent / link).resolve().relative_to(docs.resolve())
                where = page.relative_to(docs).as_posix()
                figures.append(
                    Figure(caption, image.as_posix(), where, title[1] if title else page.stem)
                )
    return figures


def write_page(target: Path, docs: Path, films: Path | None) -> None:
    """Write the page; copy the films of another folder over those of the documentation.

    Args:
        target: folder of the staged sources, a copy of the documentation.
        docs: folder of the documentation.
        films: folder that ``angler gallery`` made; None: the documentation's films alone.
    """
    shown = target / EXTRA / FOLDER
    if (docs / FOLDER).is_dir():
        shutil.copytree(docs / FOLDER, shown)
    if films is not None:
        keep_films(films, shown)
    lines = ["# Gallery", ""]
    record = shown / RECORD
    if record.is_file():
        lines += _format_films(json.loads(record.read_text(encoding="utf-8")))
    lines += ["## Figures", "", "Each figure stands on a page that says how it was made.", ""]
    lines += ["::::{grid} 1 2 3 3", ":gutter: 3", ":class-container: figures", ""]
    for figure in list_figures(docs):
        caption = figure.caption[:1].upper() + figure.caption[1:]
        lines += [
            f":::{{grid-item-card}} {figure.title}",
            f":img-top: {figure.image}",
            f":img-alt: {figure.caption}",
            f":link: /{figure.page.removesuffix('.md')}",
            ":link-type: doc",
            "",
            caption,
            ":::",
            "",
        ]
    lines += ["::::", ""]
    (target / "gallery.md").write_text("\n".join(lines), encoding="utf-8")


def _format_films(record: dict[str, Sequence[str]]) -> Sequence[str]:
    lines = [
        "## Films",
        "",
        "`angler gallery` makes all of them ([how](how_to/videos.md#gallery)). Lines are the paths "
        "so far, arrows the water's velocity at the robots, balls goals.",
        "",
    ]
    for film in FILMS:
        if film.name not in record:
            continue
        commands = "\n".join(record[film.name])
        lines += [
            f"### {film.title}",
            "",
            film.text,
            "",
            "```{raw} html",
            format_video(film.name, film.title, 'controls preload="none"'),
            "```",
            "",
            ":::{dropdown} Commands",
            "```sh",
            commands,
            "```",
            ":::",
            "",
        ]
    return lines


def format_video(name: str, title: str, attributes: str) -> str:
    """Return the HTML of a film, for a page at the top of the site."""
    return (
        f'<video {attributes} playsinline poster="{FOLDER}/{name}.png" '
        f'src="{FOLDER}/{name}.mp4" aria-label="{escape(title)}"></video>'
    )


def keep_films(made: Path, kept: Path) -> None:
    """Copy the films of a gallery, their pictures and commands into a folder.

    Args:
        made: folder that ``angler gallery`` made.
        kept: folder of the films in the documentation or the site.
    """
    kept.mkdir(parents=True, exist_ok=True)
    record = json.loads((made / "gallery.json").read_text(encoding="utf-8"))
    commands = {}
    for film in FILMS:
        if film.name not in record:
            continue
        for suffix in (".mp4", ".png"):
            shutil.copyfile(made / f"{film.name}{suffix}", kept / f"{film.name}{suffix}")
        origin = record[film.name]["origin"]
        commands[film.name] = list(film.list_commands(origin["world"], origin["poster_s"]))
    (kept / RECORD).write_text(json.dumps(commands, indent=1) + "\n", encoding="utf-8")


def fill_hero(landing: str, target: Path) -> str:
    """Return the text of the first page with its film, or its picture where there is no film."""
    film = FILMS[0]
    if (target / EXTRA / FOLDER / f"{film.name}.mp4").is_file():
        shown = format_video(film.name, film.title, "autoplay muted loop controls")
    else:
        shown = '<img src="_images/reef_fleet.png" alt="One world of the demo, seen from above">'
    return landing.replace("%FILM%", shown)
