"""What README and docs tell a person to type can be typed; made pages equal what made them."""

import functools
import re
import shlex
from pathlib import Path

import pytest

from angler_mjx.cli import main as cli
from angler_mjx.datasets import index, manifest
from angler_mjx.scenario import reference

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```sh\n(.*?)^```", re.M | re.S)
INDENTED = re.compile(r"^ {4}((?:angler|python -m|make) .*)$", re.M)
INLINE = re.compile(r"`((?:angler|python -m|make) [^`\n]*)`")


def _lines():
    """Page and line of everything that a person could type."""
    for page in PAGES:
        text, name = page.read_text(encoding="utf-8"), page.relative_to(ROOT).as_posix()
        for block in BLOCK.findall(text):
            for line in block.replace("\\\n", " ").splitlines():
                yield name, line
        yield from ((name, line) for line in INDENTED.findall(text))
        yield from ((name, line) for line in INLINE.findall(text) if _is_whole(line))


def _is_whole(line):
    """Whether it is a command and not the name of one, as in `angler export --mcap`."""
    words = line.split()
    name = 3 if words[1] in cli.GROUPS or words[0] == "python" else 2
    return len(words) > name and not words[-1].startswith("-")


def _commands(program):
    for page, line in _lines():
        for part in re.split(r"&&|;|\|", line):
            words = shlex.split(part, comments=True)
            while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
                words = words[1:]
            if words and words[0] == program:
                # RUN, NAME and SEED stand for what a person has.
                yield page, ["1" if re.fullmatch("[A-Z]+", word) else word for word in words[1:]]


COMMANDS = sorted({(page, tuple(words)) for page, words in _commands("angler")})


@pytest.fixture
def parsed(monkeypatch):
    """The command line with nothing behind it: what it was called with."""
    calls = []

    def nothing(function):
        @functools.wraps(function)
        def called(*args, **kwargs):
            calls.append((function.__name__, args, kwargs))

        return called

    groups = {
        name: {word: nothing(function) for word, function in commands.items()}
        for name, commands in cli.GROUPS.items()
    }
    monkeypatch.setattr(cli, "GROUPS", groups)
    commands = {name: nothing(function) for name, function in cli.COMMANDS.items()}
    monkeypatch.setattr(cli, "COMMANDS", commands)
    return calls


@pytest.mark.parametrize(("page", "words"), COMMANDS, ids=lambda x: x if isinstance(x, str) else "")
def test_every_command_in_a_block_parses(page, words, parsed, capsys):
    try:
        cli.main(list(words))
    except SystemExit as left:
        pytest.fail(f"{page}: angler {' '.join(words)}: {left.code}\n{capsys.readouterr().err}")
    assert len(parsed) == 1


def test_there_are_commands_to_parse():
    assert len(COMMANDS) > 30
    assert {page for page, _ in COMMANDS} >= {"README.md", "docs/sitl.md", "docs/tuning.md"}


def test_a_wrong_flag_would_be_seen(parsed, capsys):
    with pytest.raises(SystemExit):
        cli.main(["rollout", "reef_fleet", "--wrlds", "3"])
    assert parsed == []


def test_every_make_target_in_a_block_exists():
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M))
    named = {words[0] for _, words in _commands("make") if words}
    assert named
    assert named <= targets


def test_every_module_in_a_block_exists():
    modules = {words[1] for _, words in _commands("python") if words[:1] == ["-m"]}
    folders = ("", "kernels", "sitl_bridge", "experiments")
    for module in modules:
        path = module.replace(".", "/")
        files = (f"{path}.py", f"{path}/__main__.py")
        there = [(ROOT / folder / file).is_file() for folder in folders for file in files]
        assert any(there), module


@pytest.mark.parametrize("kind", ["scenario", "vehicle"])
def test_the_reference_is_that_of_the_models(kind):
    page = (ROOT / "docs" / f"reference_{kind}.md").read_text(encoding="utf-8")
    assert page == reference.page(kind)
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert len(rows) > 40
    assert not [row for row in rows if row.endswith("|  |")]  # every key has a meaning


def test_the_reference_has_every_key_of_the_shipped_files():
    for kind, folder in (
        ("scenario", ROOT / "angler_mjx" / "scenario" / "shipped"),
        ("vehicle", ROOT / "angler_mjx" / "vehicles" / "data"),
    ):
        page = reference.page(kind)
        for path in folder.rglob("*.toml"):
            for key in re.findall(r"^([a-z_0-9]+) = ", path.read_text(), re.M):
                assert f"| `{key}` |" in page, f"{path.name}: {key}"


def test_every_field_of_a_dataset_is_documented():
    """With the unit and meaning that the index has in its own metadata."""
    text = (ROOT / "docs" / "datasets.md").read_text(encoding="utf-8")
    fields = text.partition("## Fields")[2].partition("\n## ")[0]
    documented, columns = fields.split("`index.parquet`", 1)
    rows = re.findall(r"^\| (`.*?) \|", documented, re.M)
    names = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    assert sorted(names) == sorted(manifest.Manifest.model_fields)
    for model in (manifest.PartEntry, manifest.ArrayEntry):
        for name in model.model_fields:
            assert f"`{name}`" in documented, name
    found = re.findall(r"^\| `(\w+)` \| (.*?) ?\| (.*) \|$", columns, re.M)
    wanted = []
    for field in index.SCHEMA:
        unit, meaning = (field.metadata[key].decode() for key in (b"unit", b"description"))
        wanted.append((field.name, unit.replace("1", ""), meaning))
    assert found == wanted
