"""Command lines that README and docs print, and the verbs and flags that they name."""

import functools
import json
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from angler_mjx.cli import main as cli

ROOT = Path(__file__).parents[2]
PAGES = (
    ROOT / "README.md",
    ROOT / "experiments" / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
)
BLOCK = re.compile(r"^ *```sh\n(.*?)^ *```", re.M | re.S)
FENCED = re.compile(r"^ *```.*?^ *```", re.M | re.S)
INDENTED = re.compile(r"^ {4}((?:[A-Z_]+=\S+ )*(?:angler|python3? -m|make) .*)$", re.M)
INLINE = re.compile(r"`([^`]+)`")
FIRST = re.compile(r"(?:[A-Z_]+=\S+ )*(?:angler|python3? -m|make)\s")
FLAG = re.compile(r"--[a-z][a-z0-9-]*")


@dataclass(frozen=True, order=True)
class Command:
    """A program and its words, without assignments of the environment, and its first page."""

    program: str
    words: tuple[str, ...]
    page: str

    @property
    def line(self):
        return shlex.join((self.program, *self.words))

    @property
    def verb(self):
        """Return `angler rollout`, `angler env make`, `python -m MODULE` or `make TARGET`."""
        return _verb(self.program, self.words)


def _verb(program, words):
    if program == "angler":
        two = bool(words) and words[0] in cli.GROUPS
        if two and len(words) == 1 and words[0] in cli.DEFAULT_SUBCOMMANDS:
            return f"angler {words[0]} {cli.DEFAULT_SUBCOMMANDS[words[0]]}"
        return " ".join(("angler", *words[: 2 if two else 1]))
    if program == "python" and words[:1] == ("-m",):
        return f"python -m {words[1]}"
    return f"make {words[0]}" if program == "make" else program


@functools.cache
def commands():
    """All commands that can be typed, each once, in the order of pages."""
    found = {}
    for page, line in _lines():
        for program, words in split(line):
            found.setdefault((program, words), Command(program, words, page))
    return tuple(found.values())


@functools.cache
def notebook_commands():
    """Commands of the cells of notebooks; they read what other cells wrote."""
    found = []
    for page in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")):
        for cell in json.loads(page.read_text(encoding="utf-8"))["cells"]:
            first, *lines = "".join(cell["source"]).splitlines() or [""]
            if cell["cell_type"] == "code" and first == "%%bash":
                found += [Command(*parts, page.name) for line in lines for parts in split(line)]
            for line in re.findall(r"^ *!(.*)$", "".join(cell["source"]), re.M):
                found += [Command(*parts, page.name) for parts in split(line)]
    return tuple(found)


def command(line):
    """Return the command of a line that holds one."""
    ((program, words),) = split(line)
    return Command(program, words, "sizes.toml")


def split(line):
    """Programs and words of a shell line: of pipes, of lists, without comments."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars=";|&")
    lexer.whitespace_split = True
    words = []
    for word in [*lexer, ";"]:
        if not set(word) <= set(";|&"):
            words.append(word)
            continue
        while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
            words = words[1:]
        into = [i for i, word in enumerate(words) if re.fullmatch(r"[12]?>>?", word)]
        words = words[: into[0]] if into else words
        if words:
            program = "python" if words[0] == "python3" else words[0]
            yield program, tuple(words[1:])
        words = []


def _lines():
    """Page and text of all that is printed to be typed."""
    for page in PAGES:
        name = page.relative_to(ROOT).as_posix()
        yield from ((name, line) for line, _ in lines_of(page))


def lines_of(page):
    """Lines that a page prints to be typed, and whether each stands in a block."""
    text = page.read_text(encoding="utf-8")
    for block in BLOCK.findall(text):
        for line in block.replace("\\\n", " ").splitlines():
            yield line.strip(), True
    rest = FENCED.sub("", text)
    yield from ((line, True) for line in INDENTED.findall(rest.replace("\\\n", " ")))
    for span in INLINE.findall(rest):
        line = " ".join(span.split())
        if FIRST.match(line) and _is_whole(line):
            yield line, False


def _is_whole(line):
    """Return whether it is a command and not the name of one, as in `angler export --mcap`."""
    words = shlex.split(line)
    first = next(i for i, word in enumerate(words) if "=" not in word)
    words = words[first:]
    if words[0] == "make":
        return len(words) > 1
    name = 3 if words[1] in cli.GROUPS or words[0] != "angler" else 2
    if words[0] != "angler" and not re.fullmatch(r"[a-z_.0-9]+\.[a-z_.0-9]+", words[2]):
        return False
    return len(words) > name and not (len(words) == name + 1 and words[-1].startswith("-"))


@functools.cache
def named():
    """Verbs of angler, and flags by the verb beside them ("" where none is), with their page.

    A flag within inline code that begins with a verb is that verb's.
    """
    verbs, flags = {}, {}
    for page in PAGES:
        name = page.relative_to(ROOT).as_posix()
        for span in INLINE.findall(FENCED.sub("", page.read_text(encoding="utf-8"))):
            line = " ".join(span.split())
            of = (
                [(_verb(*one), " ".join(one[1])) for one in split(line)]
                if FIRST.match(line)
                else []
            )
            if line.startswith("--"):
                of = [("", line)]
            for verb, text in of:
                if verb.startswith("angler") and verb.split()[1] in cli.COMMANDS:
                    verbs.setdefault(verb, name)
                for flag in FLAG.findall(text):
                    flags.setdefault((verb if verb.startswith("angler") else "", flag), name)
    for command in commands():
        if command.program == "angler":
            verbs.setdefault(command.verb, command.page)
    return verbs, flags
