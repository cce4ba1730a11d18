"""`angler gallery`: films of shipped scenarios, and a page about them."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro

from angler_mjx.cli.shared.device import Device, choose_device, keep_all_programs
from angler_mjx.errors import ConfigError


def gallery(
    out: Path = Path("runs/gallery"),
    only: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = (),
    worlds: int | None = None,
    size: tuple[int, int] | None = None,
    device: Device | None = None,
) -> None:
    """Fly shipped scenarios, film one world of each, and write a page with the films.

    Needs the extra `video`. A repeated call goes on after an interruption, and makes only films
    that are missing or of which something changed.

    Args:
        out: Folder of the page and all that it shows.
        only: Name of a film, once for each that is made; all if left out.
        worlds: Number of worlds of each run; those of the table of films if left out.
        size: Width and height of the films, in pixels; 1280 720 if left out.
        device: Device to compute on; JAX's choice if left out.
    """
    choose_device(device)
    keep_all_programs()
    from angler_mjx.cli.shared.inputs import require_positive
    from angler_mjx.cli.shared.progress import ProgressBar
    from angler_mjx.studies.gallery import films
    from angler_mjx.studies.gallery.making import PAGE_FILE, make_gallery

    names = [film.name for film in films.FILMS]
    if unknown := [name for name in only if name not in names]:
        raise ConfigError(f"--only {unknown[0]}: films are {', '.join(names)}")
    chosen = [film for film in films.FILMS if not only or film.name in only]
    if (count := require_positive("worlds", worlds)) is not None:
        chosen = [replace(film, worlds=count) for film in chosen]
    if size is not None:
        chosen = [replace(film, view=replace(film.view, size_px=size)) for film in chosen]
    with ProgressBar() as bar:
        is_finished = make_gallery(chosen, out, bar)
    if not is_finished:
        print(f"interrupted; repeat the command to go on in {out}", file=sys.stderr)
        sys.exit(130)
    print(out / PAGE_FILE)
