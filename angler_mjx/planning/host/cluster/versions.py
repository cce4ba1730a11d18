"""What of this package, and of what it plans with, is installed where this runs."""

import hashlib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGE_FOLDER = Path(__file__).parents[3]
"""The package's folder."""

LIBRARIES = ("numpy", "jax", "jaxlib", "ompl", "numba", "coal", "pin")
"""Distributions whose other versions may give other plans."""


def installed_versions() -> dict[str, str]:
    """Versions by name; of this package a digest of its files too, as a checkout may be edited."""
    digest = hashlib.sha256()
    for file in sorted(PACKAGE_FOLDER.rglob("*.py")):
        digest.update(str(file.relative_to(PACKAGE_FOLDER)).encode() + b"\0" + file.read_bytes())
    package_version = f"{_installed_version('angler-mjx')} ({digest.hexdigest()[:12]})"
    return {"angler_mjx": package_version, **{name: _installed_version(name) for name in LIBRARIES}}


def format_differences(remote: dict[str, str], local: dict[str, str]) -> str:
    """What differs, for a message; empty where nothing does."""
    return "; ".join(
        f"{name} {remote.get(name, 'missing')} there, {local_version} here"
        for name, local_version in local.items()
        if remote.get(name) != local_version
    )


def _installed_version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"
