"""``python -m tests.folders.make``: write the folders of folders.toml into an archive.

It is run once with a version; its archive is read by all later ones.
"""

import shlex
import sys
import tarfile
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from angler_sitl.firmware import binary as binaries
from tests.commands import running

from . import ROOT, TABLE, write_inputs

STAND_IN = ROOT / "tests" / "angler_sitl" / "stand_in.py"
CHECKED = {"dataset"}
"""Folders whose files are all listed in a manifest; pictures of others are left out."""
AUTOPILOT = """#!/bin/sh
exec "{python}" "{program}" "$@"
"""


def make(archive, only=()):
    """Run the commands in a temporary folder and pack what they wrote.

    Args:
        archive: Path of a .tar.xz to write.
        only: names of the folders; all if empty.
    """
    with tempfile.TemporaryDirectory() as base, tempfile.TemporaryDirectory() as other:
        folder = Path(base)
        write_inputs(folder)
        inputs = {path.name for path in folder.iterdir()}
        for kind, run in (("made", _whole), ("interrupted", running.interrupt)):
            for name, line in TABLE[kind].items():
                if not only or name in only:
                    print(name, flush=True)
                    words = shlex.split(line)
                    sys.argv = ["angler", *words]  # what folders say of their origin
                    with _autopilot(Path(other)):
                        run(folder, words)
        for path in [*folder.rglob("*.png"), *folder.rglob("*.html")]:
            if path.relative_to(folder).parts[0] not in CHECKED:
                path.unlink()
        with tarfile.open(archive, "w:xz") as packed:
            for path in sorted(folder.iterdir()):
                if path.name not in inputs:
                    packed.add(path, path.name)


@contextmanager
def _autopilot(folder):
    """Let every command find the stand-in as its ArduSub."""
    program = folder / "ardusub"
    program.write_text(AUTOPILOT.format(python=sys.executable, program=STAND_IN))
    program.chmod(0o755)
    found = binaries.Binary(path=program, version="stand-in", sha256="")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(binaries, "find_binary", lambda _: found)
        yield


def _whole(folder, words):
    running.in_process(folder, words, {0})


if __name__ == "__main__":
    _, chosen, *names = sys.argv
    make(Path(chosen), names)
