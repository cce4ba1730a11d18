"""Processes of a release: their environment, their faults, their seconds."""

import os
import resource
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

PASSED_ON = ("PIP_", "UV_", "SSL_CERT_", "REQUESTS_CA_BUNDLE", "HTTP_PROXY", "HTTPS_PROXY")
"""Beginnings of variables that programs need to reach a package index from here."""


class ReleaseError(Exception):
    """Release that cannot be made, with the reason."""


@dataclass(frozen=True, kw_only=True)
class FinishedProcess:
    """Command line that ended well, what it printed, and what it took."""

    words: tuple[str, ...]
    output: str
    seconds: float
    """By the clock."""
    cpu_seconds: float
    """Of all processors, which other programs of the machine prolong less."""


def clean_environment(home: Path, more: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return variables that hold nothing of this checkout or of its user.

    Args:
        home: folder that stands for the user's.
        more: variables to add.
    """
    home.mkdir(parents=True, exist_ok=True)
    passed = {key: value for key, value in os.environ.items() if key.upper().startswith(PASSED_ON)}
    base = {"PATH": "/usr/local/bin:/usr/bin:/bin", "HOME": str(home), "LANG": "C.UTF-8"}
    return {**passed, **base, **(more or {})}


def run_process(
    words: Sequence[str | Path], folder: Path, environment: Mapping[str, str]
) -> FinishedProcess:
    """Run a command line in a folder.

    Args:
        words: program and arguments.
        folder: working directory.
        environment: all of its variables.

    Raises:
        ReleaseError: the program is missing or failed; the message ends with what it printed.
    """
    line = tuple(map(str, words))
    start, used = time.monotonic(), _used_by_children()
    try:
        done = subprocess.run(
            line, cwd=folder, env=dict(environment), capture_output=True, text=True, check=False
        )
    except OSError as error:
        raise ReleaseError(f"{line[0]}: {error.strerror}") from error
    if done.returncode:
        printed = "\n".join((done.stdout + done.stderr).strip().splitlines()[-30:])
        raise ReleaseError(f"{' '.join(line)}: exit status {done.returncode}\n{printed}")
    return FinishedProcess(
        words=line,
        output=done.stdout,
        seconds=time.monotonic() - start,
        cpu_seconds=_used_by_children() - used,
    )


def _used_by_children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def make_environment(folder: Path, environment: Mapping[str, str], python: Path) -> Path:
    """Make a virtual environment; return its folder of programs.

    Args:
        folder: folder to make.
        environment: variables of the process.
        python: interpreter that it is of.

    Raises:
        ReleaseError: it cannot be made.
    """
    run_process([python, "-m", "venv", folder], folder.parent, environment)
    return folder / "bin"
