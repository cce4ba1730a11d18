"""Every command line that README and docs print is taken by the parser of its program."""

import argparse
import functools
import importlib.util
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
import tyro

from angler_mjx.cli import main as cli

from . import printed, running

COMMANDS = (
    *printed.commands(),
    *printed.notebook_commands(),
    *running.DAILY,
    *running.NIGHTLY,
)


def _of(program):
    commands = [command for command in COMMANDS if command.program == program]
    return pytest.mark.parametrize("command", commands, ids=lambda command: command.line)


@pytest.fixture
def parsed(monkeypatch):
    """Names of the functions that command lines were parsed for; their bodies are not run."""
    calls = []

    def without_body(function):
        @functools.wraps(function)
        def called(*args, **kwargs):
            calls.append(function.__name__)

        return called

    def without_bodies(functions):
        return {name: without_body(function) for name, function in functions.items()}

    groups = {name: without_bodies(commands) for name, commands in cli.GROUPS.items()}
    monkeypatch.setattr(cli, "GROUPS", groups)
    monkeypatch.setattr(cli, "COMMANDS", without_bodies(cli.COMMANDS))
    one, several, plain = tyro.cli, tyro.extras.subcommand_cli_from_dict, argparse.ArgumentParser

    def parse_args(self, *args, **kwargs):
        taken = parse(self, *args, **kwargs)
        calls.append(self.prog)
        raise SystemExit(0 if taken else 1)

    parse = plain.parse_args

    def one_alone(function, **more):
        one(without_body(function), **more)
        raise SystemExit(0)  # what a module does with its options needs them

    monkeypatch.setattr(tyro, "cli", one_alone)
    monkeypatch.setattr(
        tyro.extras,
        "subcommand_cli_from_dict",
        lambda functions, **more: several(without_bodies(functions), **more),
    )
    return calls, lambda: monkeypatch.setattr(plain, "parse_args", parse_args)


def _words(command):
    """Words with a number for RUN, NAME and SEED, which stand for what a reader has."""
    return ["1" if re.fullmatch("[A-Z]+", word) else word for word in command.words]


@_of("angler")
def test_angler_parses(command, parsed, capsys):
    calls, _ = parsed
    try:
        cli.main(_words(command))
    except SystemExit as left:
        pytest.fail(f"{command.page}: {command.line}: {left.code}\n{capsys.readouterr().err}")
    assert len(calls) == 1


@_of("python")
def test_a_module_parses(command, parsed, capsys, monkeypatch):
    if command.words[1] == "venv":
        pytest.skip(running.reason_to_skip(command))
    name = command.words[1]
    if importlib.util.find_spec(name).submodule_search_locations:
        name = f"{name}.__main__"
    where = importlib.util.find_spec(name)
    assert re.search(r"tyro\.|argparse", Path(where.origin).read_text()), "has no parser"
    calls, stop_after_parsing = parsed
    stop_after_parsing()
    monkeypatch.setattr(sys, "argv", ["module", *_words(command)[2:]])
    monkeypatch.delitem(sys.modules, name, raising=False)
    code = None
    try:
        runpy.run_module(command.words[1], run_name="__main__", alter_sys=False)
    except SystemExit as left:
        code = left.code
    message = f"{command.page}: {command.line}: {code}\n{capsys.readouterr().err}"
    assert code in (0, None), message
    assert len(calls) == 1


@_of("make")
def test_make_has_target_and_variables(command):
    text = (printed.ROOT / "Makefile").read_text(encoding="utf-8")
    variables = {word.partition("=")[0] for word in command.words if "=" in word}
    assert variables <= set(re.findall(r"\$\((\w+)\)", text))
    line = ["make", "-n", "-o", ".venv/.installed", *command.words]
    done = subprocess.run(line, cwd=printed.ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_program_is_known():
    """A line of another program is skipped by name, with a reason."""
    others = {c.line for c in COMMANDS if c.program not in ("angler", "python", "make")}
    assert others
    assert {line for line in others if not running.reason_to_skip(printed.command(line))} == set()


def test_lines_of_every_form_are_read():
    lines = {command.line for command in COMMANDS}
    assert len(COMMANDS) > 150
    assert "angler scenarios" in lines  # of a block
    assert "angler dataset verify datasets/reef --again 20" in lines  # of an indented block
    assert "angler fly dense_dynamic --planner RRTConnect --replan-hz 1" in lines  # of two lines
    pages = {"README.md", "docs/how_to/sitl.md", "fleet_size.ipynb", "on_ardusub.ipynb"}
    assert {command.page for command in COMMANDS} >= pages


def test_a_line_is_split_as_a_shell_does():
    line = "A=1 angler rollout x --json | head; make test > log # why"
    assert [program for program, _ in printed.split(line)] == ["angler", "head", "make"]
    line = "angler dataset make 'x y' >> log && python3 -m m 'a; b'"
    expected = [("angler", ("dataset", "make", "x y")), ("python", ("-m", "m", "a; b"))]
    assert list(printed.split(line)) == expected


def test_a_wrong_flag_is_refused(parsed, capsys):
    with pytest.raises(SystemExit):
        cli.main(["rollout", "reef_fleet", "--wrlds", "3"])
    assert parsed[0] == []
