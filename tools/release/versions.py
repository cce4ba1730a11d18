"""Places that name the version of a release, and whether they agree."""

import json
import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tools.release.processes import ReleaseError

VERSION_FILE = "angler_mjx/_version.py"
CHANGELOG, CITATION, ZENODO = "CHANGELOG.md", "CITATION.cff", ".zenodo.json"
PROJECTS = ("pyproject.toml", "experiments/pyproject.toml")
VERSION = re.compile(r"\d+\.\d+\.\d+(?:(?:a|b|rc)\d+)?(?:\.post\d+)?")
"""Versions of PEP 440 in their normal form, of three numbers."""
NAMED = re.compile(
    r"angler_(?:mjx|experiments)-(\d[\w.]*?)(?:-py3|\.tar)|angler-(?:mjx|experiments)(?:\[\w+\])?==([\w.]+\w)"
)
"""Names of files and requirements of a version, on pages."""
OWNERS = "TO BE FILLED IN BY THE OWNER"
"""Mark of fields that only the owners of the project can fill in."""


@dataclass(frozen=True, kw_only=True)
class Section:
    """Section of the changelog."""

    version: str
    date: str | None
    text: str


def read_version(root: Path) -> str:
    """Return the version that the package names.

    Raises:
        ReleaseError: it is not there, or not written as such.
    """
    text = (root / VERSION_FILE).read_text(encoding="utf-8")
    match = re.search(r'^__version__ = "(.*)"$', text, re.MULTILINE)
    if match is None or not VERSION.fullmatch(match[1]):
        raise ReleaseError(
            f"{VERSION_FILE}: {match[1] if match else 'no version'}: write it as 1.2.3 or 1.2.3rc1"
        )
    return match[1]


def read_sections(text: str) -> list[Section]:
    """Return the sections of a changelog, in their order.

    Args:
        text: of the file.
    """
    parts = re.split(r"^## \[(.+?)\](?: - (\S+))?$", text, flags=re.MULTILINE)
    return [
        Section(version=version, date=date, text=body.strip())
        for version, date, body in zip(parts[1::3], parts[2::3], parts[3::3], strict=True)
    ]


def find_version_faults(root: Path) -> list[str]:
    """Return what does not agree with the version of the package; empty if all does.

    Args:
        root: folder of the checkout.

    Raises:
        ReleaseError: the package has no version.
    """
    version = read_version(root)
    sections = read_sections((root / CHANGELOG).read_text(encoding="utf-8"))
    released = next((section for section in sections if section.version == version), None)
    faults = [*_judge_changelog(sections, released, version)]
    date = released.date if released else None
    for project in PROJECTS:
        if re.search(r"^version\s*=", (root / project).read_text(encoding="utf-8"), re.MULTILINE):
            faults.append(f"{project}: has a version; {VERSION_FILE} is where it stands")
    for file, found in (
        (CITATION, _read_citation(root / CITATION)),
        (ZENODO, _read_zenodo(root / ZENODO)),
    ):
        faults += [
            f"{file}: {key} is {value or 'missing'}, not {wanted}"
            for key, value, wanted in zip(
                ("version", "date"), found, (version, date or "that of the changelog"), strict=True
            )
            if value != wanted
        ]
    for page in _list_pages(root):
        for match in NAMED.finditer(page.read_text(encoding="utf-8")):
            if (name := match[1] or match[2]) != version:
                faults.append(f"{page.relative_to(root)}: names {name}, not {version}")
    return faults


def _judge_changelog(
    sections: list[Section], released: Section | None, version: str
) -> Iterator[str]:
    if released is None:
        yield f"{CHANGELOG}: no section [{version}]"
        return
    numbered = [section for section in sections if section.version != "Unreleased"]
    if numbered[0] is not released:
        yield f"{CHANGELOG}: [{version}] is not the newest section"
    if not re.fullmatch(r"\d{4}-\d\d-\d\d", released.date or ""):
        yield f"{CHANGELOG}: [{version}] has no date"
    if not re.search(r"^- ", released.text, re.MULTILINE):
        yield f"{CHANGELOG}: [{version}] lists nothing"
    if any(section.version == "Unreleased" and section.text for section in sections):
        yield f"{CHANGELOG}: [Unreleased] lists changes; move them to [{version}]"


def _read_citation(path: Path) -> tuple[str | None, str | None]:
    text = path.read_text(encoding="utf-8")
    values = [
        re.search(rf'^{key}: "?([^"\n]*)"?$', text, re.MULTILINE)
        for key in ("version", "date-released")
    ]
    return values[0] and values[0][1], values[1] and values[1][1]


def _read_zenodo(path: Path) -> tuple[str | None, str | None]:
    if not path.is_file():
        return None, None
    fields = json.loads(path.read_text(encoding="utf-8"))
    return fields.get("version"), fields.get("publication_date")


def _list_pages(root: Path) -> list[Path]:
    """Return the pages of today; the changelog and stored results name versions of before."""
    return [root / "README.md", root / "Containerfile", *sorted((root / "docs").rglob("*.md"))]


def find_owner_fields(root: Path) -> list[str]:
    """Return the files with fields that only the owners of the project can fill in.

    Args:
        root: folder of the checkout.
    """
    files = (CITATION, ZENODO, "paper.md", *PROJECTS)
    return [
        file
        for file in files
        if OWNERS in (root / file).read_text(encoding="utf-8").upper().replace("OWNERS", "OWNER")
    ]


def read_commit(root: Path, version: str) -> tuple[str, int]:
    """Return the commit of a clean checkout, and its time [s since 1970].

    Args:
        root: folder of the checkout.
        version: version to be released.

    Raises:
        ReleaseError: there is no repository, files differ from the commit, or the tag of the
            version is of another commit.
    """
    changed = _git(root, "status", "--porcelain", "--untracked-files=all").splitlines()
    if changed:
        listed = "\n".join(changed[:10])
        raise ReleaseError(f"files differ from the commit; commit or remove them:\n{listed}")
    commit, seconds = _git(root, "log", "-1", "--format=%H %ct").split()
    tagged = _git(root, "tag", "--list", f"v{version}", "--format=%(*objectname)%(objectname)")
    if tagged.strip() and not tagged.startswith(commit):
        raise ReleaseError(f"v{version} is the tag of another commit; a release is made once")
    return commit, int(seconds)


def _git(root: Path, *words: str) -> str:
    done = subprocess.run(
        ["git", "-C", str(root), *words], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise ReleaseError(f"git {words[0]}: {done.stderr.strip()}")
    return done.stdout
