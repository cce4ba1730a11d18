"""Every verb and flag that README and docs name is one that a test runs."""

import re

import pytest

from angler_mjx.cli import main as cli

from . import printed, running

VERBS, FLAGS = printed.named()
ELSEWHERE = running.TABLE["elsewhere"]


def _held():
    """Verbs and their flags that lines run; where a reason skips them, that are parsed."""
    flags = set()
    commands = (*running.DAILY, *printed.commands(), *running.NIGHTLY)
    for command in commands:
        words = command.words if running.reason_to_skip(command) else running.small(command)
        words = [part for word in words for part in word.partition("=")[::2]]
        flags |= {(command.verb, word) for word in words if word.startswith("--")}
    return {command.verb for command in commands}, flags


HELD_VERBS, HELD_FLAGS = _held()


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_a_verb_is_run(verb):
    assert verb in HELD_VERBS, f"{VERBS[verb]} names {verb}: add a line to sizes.toml"


@pytest.mark.parametrize(("verb", "flag"), sorted(FLAGS), ids=lambda word: word or "any")
def test_a_flag_is_run(verb, flag):
    if any(held == flag and verb in ("", of) for of, held in HELD_FLAGS):
        return
    reason = ELSEWHERE.get(flag)
    assert reason, f"{FLAGS[verb, flag]} names {verb} {flag}: add a line to sizes.toml"
    for path in re.findall(r"tests/[\w./]+", reason):
        assert flag in (printed.ROOT / path).read_text(encoding="utf-8"), f"{path} lacks {flag}"


def test_every_verb_is_run():
    """All verbs of angler, whether or not a page names them."""
    verbs = {verb for verb in cli.COMMANDS if verb not in cli.GROUPS}
    verbs |= {f"{group} {verb}" for group, of in cli.GROUPS.items() for verb in of}
    assert {f"angler {verb}" for verb in verbs} - HELD_VERBS == set()
