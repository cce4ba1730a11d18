"""Wheels and source distribution, built from what the commit holds."""

import io
import subprocess
import tarfile
from collections.abc import Mapping
from pathlib import Path

from tools.release.processes import ReleaseError, run_process

PROJECTS = {"angler_mjx": ".", "angler_experiments": "experiments"}
"""Folder of the project of each distribution."""


def export_commit(root: Path, commit: str, folder: Path) -> Path:
    """Write the files of a commit into a new folder; return it.

    Args:
        root: folder of the checkout.
        commit: its commit.
        folder: folder to make.

    Raises:
        ReleaseError: git fails.
    """
    done = subprocess.run(
        ["git", "-C", str(root), "archive", "--format=tar", commit],
        capture_output=True,
        check=False,
    )
    if done.returncode:
        raise ReleaseError(f"git archive: {done.stderr.decode().strip()}")
    with tarfile.open(fileobj=io.BytesIO(done.stdout)) as archive:
        archive.extractall(folder, filter="data")
    return folder


def build_distributions(
    source: Path, out: Path, python: Path, environment: Mapping[str, str]
) -> dict[str, Path]:
    """Build both wheels and the source distribution, and the wheels a second time from the latter.

    Args:
        source: files of the commit.
        out: folder that receives them.
        python: interpreter of an environment that has hatchling.
        environment: variables of the processes, with SOURCE_DATE_EPOCH.

    Returns:
        The files by kind: `sdist`, and each wheel by the name of its distribution.

    Raises:
        ReleaseError: building failed, or a wheel built from the source distribution differs.
    """
    built = {"sdist": _build("sdist", source, out, python, environment)}
    unpacked = out.parent / "unpacked"
    with tarfile.open(built["sdist"]) as archive:
        archive.extractall(unpacked, filter="data")
    (copy,) = unpacked.iterdir()
    for name, folder in PROJECTS.items():
        built[name] = _build("wheel", source / folder, out, python, environment)
        again = _build("wheel", copy / folder, out.parent / "again", python, environment)
        if again.read_bytes() != built[name].read_bytes():
            raise ReleaseError(f"{built[name].name}: other bytes from the source distribution")
    return built


def _build(
    kind: str, project: Path, out: Path, python: Path, environment: Mapping[str, str]
) -> Path:
    before = set(out.glob("*"))
    run_process(
        [python, "-m", "hatchling", "build", "--target", kind, "--directory", out],
        project,
        environment,
    )
    (path,) = set(out.glob("*")) - before
    return path
