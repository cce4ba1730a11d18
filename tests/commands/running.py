"""Printed commands, run to their end in a folder of their own with sizes of tests."""

import contextlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from rich.progress import Progress

from angler_mjx.cli import main as cli

from . import printed

ROOT, BESIDE = printed.ROOT, Path(__file__).parent
TABLE = tomllib.loads((BESIDE / "sizes.toml").read_text(encoding="utf-8"))
DAILY, NIGHTLY = (
    tuple(printed.command(line) for line in TABLE["own"][when]) for when in ("daily", "nightly")
)
"""Commands of our own, which stand for a verb or hold flags that pages only name."""
OUTPUTS = ("--out", "--mcap", "--figure")
FILES = tuple(sorted(p.name for p in BESIDE.glob("*.toml") if p.name != "sizes.toml"))
TRACKED = ("README.md", "docs", "benchmarks", "experiments")
"""Folders of the project that lines name files of."""
LIMIT_S = 1800.0


def reason_to_skip(command):
    """Return why a line cannot be run, or None."""
    for begin, reason in TABLE["skipped"].items():
        if command.line.startswith(begin):
            return reason
    return None


def small(command):
    """Return the words of a command with the sizes and files of tests.

    Flags of ``[flags]`` take its values, or go; words of ``[words]`` are replaced, of one verb or
    of all; ``[more]`` adds
    the flags that the line does not hold, for its first three words, for a verb and a flag, or for
    a verb.
    """
    words, verb = list(command.words), command.verb
    result, i = [], 0
    while i < len(words):
        word = words[i]
        values = TABLE["flags"].get(f"{verb} {word}", TABLE["flags"].get(word))
        i += 1
        if not word.startswith("-") or values is None:
            result.append(TABLE["words"].get(f"{verb} {word}", TABLE["words"].get(word, word)))
            continue
        result += [word, *values] if values else []
        while i < len(words) and not words[i].startswith("-"):
            i += 1
    longer = " ".join((command.program, *words[:3]))
    for flag, *values in _more(longer, *(f"{verb} {word}" for word in words), verb):
        if flag not in result:
            result += [flag, *values]
    return result


def _more(*names):
    return next((TABLE["more"][name] for name in names if name in TABLE["more"]), ())


class Workshop:
    """Folders of commands; what several of them read is made once.

    Args:
        base: folder that holds all.
    """

    def __init__(self, base):
        self._base, self._made, self._count = base, {}, 0

    def run(self, command):
        """Run a command in a folder of its own.

        Raises:
            AssertionError: it does not end with exit code 0; holds what it printed.
        """
        self._count += 1
        folder = self._base / f"{self._count:03d}"
        self._run_in(folder, command)
        return folder

    def _run_in(self, folder, command):
        folder.mkdir()
        words = small(command)
        self._furnish(folder, words)
        if "--resume" in words:
            first = [word for word in words if word != "--resume"]
            interrupt(folder, first + TABLE["interrupted"].get(command.verb, []))
        self._call(folder, command, words)

    def _call(self, folder, command, words):
        right = {0, *(code for begin, code in TABLE["codes"].items() if command.line == begin)}
        if command.program == "angler":
            in_process(folder, words, right)
        elif command.program == "python":
            _in_a_process(folder, [sys.executable, *words])
        else:
            # The environment is left as it is, also where pyproject.toml is newer.
            words = [word.format(folder=folder) for word in words]
            _in_a_process(ROOT, [command.program, "-o", ".venv/.installed", *words])

    def _furnish(self, folder, words):
        """Bring what a command reads into its folder."""
        for name in FILES:
            shutil.copy(BESIDE / name, folder)
        for row in TABLE["variants"]:
            source = ROOT / row["of"] if "/" in row["of"] else BESIDE / row["of"]
            text = _resized(source.read_text(encoding="utf-8"), row["name"])
            (folder / row["name"]).write_text(row.get("head", "") + text, encoding="utf-8")
        for row in TABLE["printed"]:
            text = _resized(_block(row["page"], row["holds"]), row["name"])
            (folder / row["name"]).write_text(text, encoding="utf-8")
            if row["name"] in words:
                for name in re.findall(r'"([\w./]+\.toml)"', text):
                    self._take(folder, name)
        for i, word in enumerate(words):
            if word.partition("/")[0] in TRACKED:
                self._copy(folder, word)
            elif i == 0 or words[i - 1] not in OUTPUTS:
                self._take(folder, word)

    def _copy(self, folder, word):
        """Copy a file or folder of the project, sized for tests, and what it names beside it."""
        source, target = ROOT / word, folder / word
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, dirs_exist_ok=True)
        if not source.is_file() or target.exists():
            return
        if source.suffix != ".toml":
            shutil.copy(source, target)
            if source.suffix in (".scen", ".3dscen"):  # Its map lies beside it.
                for other in source.parent.glob(f"{source.name.partition('.')[0]}.*map"):
                    shutil.copy(other, target.parent)
            return
        text = _resized(source.read_text(encoding="utf-8"), word)
        target.write_text(text, encoding="utf-8")
        for name in re.findall(r'"([\w./]+\.(?:nc|py))[:"]', text):
            other = os.path.relpath((source.parent / name).resolve(), ROOT)
            self._copy(folder, other)
            self._take(folder, other)

    def _take(self, folder, word):
        """Copy what another command made, making it first if none did."""
        row = next((row for row in TABLE["made"] if word in row["names"]), None)
        target = folder / word
        if row is None or target.exists():
            return
        if row["by"] not in self._made:
            self._made[row["by"]] = self.run(printed.command(row["by"])) / "made"
        target.parent.mkdir(parents=True, exist_ok=True)
        source = self._made[row["by"]]
        (shutil.copytree if source.is_dir() else shutil.copy)(source, target)


def _resized(text, name):
    """Replace keys of a file by those of ``[files]``, which it must hold."""
    for key, value in TABLE["files"].get(name, {}).items():
        old = rf"(?<![a-z_]){key} = (\"[^\"]*\"|\[[^\]]*\]|\{{[^}}]*\}}|[^\s,}}]+)"
        text, count = re.subn(old, f"{key} = {value}", text)
        assert count, f"{name}: has no key {key} to be resized"
    return text


def _block(page, holds):
    """Return the fenced or indented block of a page that holds a text."""
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = [*re.findall(r"^```\w*\n(.*?)^```", text, re.M | re.S)]
    blocks += [
        re.sub(r"(?m)^ {4}", "", block) for block in re.findall(r"(?:^ {4}.*\n)+", text, re.M)
    ]
    return next(block for block in blocks if holds in block)


def interrupt(folder, words):
    """Run a command and end it as Ctrl-C does once its bar shows more than one world or flight."""

    def interrupting(call):
        def then(bar, task, *parts, **fields):
            call(bar, task, *parts, **fields)
            if bar.tasks[0].completed > 1:
                raise KeyboardInterrupt

        return then

    with pytest.MonkeyPatch.context() as patch:
        for name in ("advance", "update"):
            patch.setattr(Progress, name, interrupting(getattr(Progress, name)))
        in_process(folder, words, {cli.EXIT_INTERRUPTED})


def in_process(folder, words, right):
    code = 0
    with contextlib.chdir(folder):
        try:
            cli.main(words)
        except SystemExit as left:
            code = left.code or 0
    assert code in right, f"exit code {code}: angler {shlex.join(words)}"


def _in_a_process(folder, line):
    paths = [str(ROOT / name) for name in ("", "kernels", "sitl_bridge", "experiments")]
    done = subprocess.run(
        line,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths), "JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    output = f"{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    assert done.returncode == 0, f"exit code {done.returncode}: {shlex.join(line)}\n{output}"
