"""No two commands that a reader types one after another write the same folder or file.

A command refuses a folder that is there, unless it goes on with it by ``--resume``.
"""

import re
from collections import defaultdict
from pathlib import PurePosixPath

import pytest

from . import printed

PATHS = (
    *((page.relative_to(printed.ROOT).as_posix(),) for page in printed.PAGES),
    ("README.md", "docs/tutorials/first_run.md"),
    ("docs/how_to/install.md", "docs/tutorials/first_run.md"),
)
"""Pages that are read one after another: each by itself, and the ways to the first tutorial."""

ADDING = {
    "angler bench": "rows are appended to a file",
    "angler gallery --out runs/gallery --only": "films of other scenarios are added",
    "python -m angler_experiments.ocean.drift": "a second call reads what Parcels added",
    "python -m angler_experiments.scalability.arrivals": "each study has a folder in it",
}
"""Beginnings of lines that write into a folder or file that may be there, and why."""

DEFAULTS = {
    "angler rollout": "runs/{name}",
    "angler benchmark": "runs/{name}",
    "angler study fleet_size": "runs/{name}",
    "angler study fleet_size --smoke": "runs/{name}-smoke",
    "angler sweep": "runs/{name}-sweep",
    "angler sitl run": "runs/{name}-sitl",
    "angler leaderboard check": "runs/{name}",
    "angler dataset make": "datasets/{name}",
    "angler spotcheck": "{folder}-spotcheck",
}
"""Folders of verbs where ``--out`` is left out, by the first argument of the line."""


def _words_of_angler(command):
    """Words behind `angler`, also where another program starts it; None of other commands."""
    for i, word in enumerate((command.program, *command.words)):
        if PurePosixPath(word).name == "angler" and command.words[i - 1 : i] != ("--tag",):
            return command.words[i:]
    return None


def output_of(command, *, with_default=True):
    """Return the folder or file that a command makes, or None if it makes none or goes on."""
    if command.line.startswith(tuple(ADDING)) or "--resume" in command.words:
        return None
    if any(re.fullmatch("[A-Z]+", word) for word in command.words):  # the form of a line
        return None
    words = _words_of_angler(command)
    words = command.words if words is None else words
    if "--out" in words[:-1]:
        out = words[words.index("--out") + 1]
        return f"runs/{out}" if command.program == "podman" else out
    verb = " ".join(("angler", *words[: len(command.verb.split()) - 1]))
    smoke = f"{verb} --smoke" if "--smoke" in words else verb
    first = words[len(verb.split()) - 1 :][:1]
    template = DEFAULTS.get(smoke, DEFAULTS.get(verb))
    if not with_default or template is None or not first or first[0].startswith("-"):
        return None
    return template.format(name=PurePosixPath(first[0]).stem, folder=first[0])


def repeated_outputs(pages):
    """Outputs that several lines of pages make, with the lines.

    Lines within a sentence, which mostly say how a number was measured, count where they name an
    output.
    """
    made = defaultdict(list)
    for page in pages:
        for line, is_block in printed.lines_of(printed.ROOT / page):
            for program, words in printed.split(line):
                command = printed.Command(program, words, page)
                if out := output_of(command, with_default=is_block):
                    made[out].append(command.line)
    return {out: lines for out, lines in made.items() if len(lines) > 1}


@pytest.mark.parametrize("pages", PATHS, ids=" ".join)
def test_no_two_lines_make_the_same_folder(pages):
    assert repeated_outputs(pages) == {}


@pytest.mark.parametrize(
    ("line", "out"),
    [
        ("angler rollout reef_fleet --out runs/a", "runs/a"),
        ("angler rollout reef_fleet --out runs/a --resume", None),
        ("angler/bin/angler rollout reef_fleet --out runs/a", "runs/a"),
        ("podman run --rm --volume runs:/runs angler rollout reef_fleet --out a", "runs/a"),
        ("podman build --tag angler dist", None),
        ("angler rollout studies/mine.toml --worlds 4", "runs/mine"),
        ("angler study fleet_size survey_reef --smoke", "runs/survey_reef-smoke"),
        ("angler spotcheck runs/a --episodes 8", "runs/a-spotcheck"),
        ("angler benchmark --list", None),
        ("angler problems SCENARIO --out problems.zarr", None),
        ("angler gallery --out runs/gallery --only reef", None),
    ],
)
def test_the_output_of_a_line(line, out):
    assert output_of(printed.command(line)) == out


def test_reasons_are_of_lines_that_are_printed():
    lines = [command.line for command in printed.commands()]
    for begin in ADDING:
        assert any(line.startswith(begin) for line in lines), f"gone from ADDING: {begin}"
