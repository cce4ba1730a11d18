"""``python -m tools.site``: build the site of the documentation, and check it."""

import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

from angler_mjx import __version__
from tools.site.checking import check_site
from tools.site.gallery import FOLDER, keep_films
from tools.site.menu import MenuError
from tools.site.staging import ROOT, stage_site

VERSIONS = "versions.js"


@dataclass(frozen=True, kw_only=True)
class SiteOptions:
    """Build the site of this version into a folder that may hold sites of others.

    Needs the extra `docs`, and no network. Warnings are errors; then links, anchors, pictures and
    menus of the result are checked.
    """

    out: Path = ROOT / "build" / "site"
    """Folder of all versions; each stands in a folder of its name."""
    version: str = __version__
    """Name of this version."""
    films: Path | None = None
    """Folder that `angler gallery` made, whose films are shown in place of those of docs/films."""
    keep_films: Path | None = None
    """Copy the films of this folder of `angler gallery` into docs/films, and build nothing."""


def main(options: SiteOptions) -> int:
    """Build, check and list the site; return the exit code."""
    if options.keep_films is not None:
        keep_films(options.keep_films, ROOT / "docs" / FOLDER)
        return 0
    start = time.monotonic()
    staged = ROOT / ".cache" / "site" / "source"
    built = options.out / options.version
    try:
        stage_site(staged, options.films)
    except MenuError as error:
        print(f"site: {error}", file=sys.stderr)
        return 1
    shutil.rmtree(built, ignore_errors=True)
    if not run_sphinx(staged, built, options.version):
        return 1
    list_versions(options.out)
    faults = check_site(built)
    for fault in faults:
        print(f"site: {fault}", file=sys.stderr)
    pages = len(list(built.rglob("*.html")))
    print(f"site: {pages} pages in {built}, {time.monotonic() - start:.0f} s", flush=True)
    return 1 if faults else 0


def run_sphinx(staged: Path, built: Path, version: str) -> bool:
    """Build HTML of staged sources. Warnings are printed, and are failures.

    Args:
        staged: folder of the sources.
        built: folder of the site.
        version: name of the version.
    """
    command = ["sphinx-build", "--quiet", "--fail-on-warning", "--keep-going", "--jobs", "2"]
    command += ["--builder", "html", "--doctree-dir", str(staged.parent / "doctrees")]
    environment = {**os.environ, "ANGLER_SITE_VERSION": version, "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", *command[1:], str(staged), str(built)],
        env=environment,
        cwd=ROOT,
        check=False,
    )
    shutil.rmtree(built / ".doctrees", ignore_errors=True)
    return done.returncode == 0


def list_versions(out: Path) -> None:
    """Write the list of the versions in a folder, newest first, and a page that leads to the first.

    Args:
        out: folder of all versions.
    """
    names = sorted(
        (path.parent.name for path in out.glob("*/index.html")), key=_order_version, reverse=True
    )
    listed = f"window.ANGLER_VERSIONS = {json.dumps(names)};\n"
    (out / VERSIONS).write_text(listed, encoding="utf-8")
    (out / "index.html").write_text(
        '<!DOCTYPE html>\n<html lang="en">\n<meta charset="utf-8">\n<title>angler_mjx</title>\n'
        f'<meta http-equiv="refresh" content="0; url={names[0]}/index.html">\n'
        f'<a href="{names[0]}/index.html">angler_mjx {names[0]}</a>\n</html>\n',
        encoding="utf-8",
    )


def _order_version(name: str) -> tuple[bool, list[int], str]:
    """Order numbered versions by their numbers, and others before all of them."""
    numbers = [int(part) for part in name.split(".") if part.isdigit()]
    return bool(numbers), numbers, name


if __name__ == "__main__":
    sys.exit(main(tyro.cli(SiteOptions)))
