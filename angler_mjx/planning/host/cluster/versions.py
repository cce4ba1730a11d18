"""What of this package, and of what it plans with, is installed where this runs."""

import hashlib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

HOME = Path(__file__).parents[3]
"""The package's folder."""

LIBRARIES = ("numpy", "jax", "jaxlib", "ompl", "numba", "coal", "pin")
"""Distributions whose other versions may give other plans."""


def installed() -> dict[str, str]:
    """Versions by name; of this package a digest of its files too, as a checkout may be edited."""
    text = hashlib.sha256()
    for file in sorted(HOME.rglob("*.py")):
        text.update(str(file.relative_to(HOME)).encode() + b"\0" + file.read_bytes())
    own = f"{_version('angler-mjx')} ({text.hexdigest()[:12]})"
    return {"angler_mjx": own, **{name: _version(name) for name in LIBRARIES}}


def differences(there: dict[str, str], here: dict[str, str]) -> str:
    """What differs, for a message; empty where nothing does."""
    return "; ".join(
        f"{name} {there.get(name, 'missing')} there, {have} here"
        for name, have in here.items()
        if there.get(name) != have
    )


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"
