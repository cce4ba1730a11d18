"""The fixture `deviation`: a bound that is asserted, and the number that was found, kept.

`pytest --deviations FILE` writes what all tests found, also those of other processes, into one
file that `angler validate --from FILE` reads. Without it nothing is written.
"""

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

_FOUND = pytest.StashKey[list[dict]]()


class Deviation:
    """How far two things are apart in one test; see the methods."""

    def __init__(self, test: str, found: list[dict]):
        self._test, self._found = test, found

    def __call__(self, key, value, bound, *, about=""):
        """Assert that the greatest of ``value`` is at most ``bound``, and record it.

        Args:
            key: of a term in docs/validation/terms.toml.
            value: one number or an array of them.
            bound: what must not be exceeded.
            about: said where it is.
        """
        values = np.asarray(value, float)
        assert values.size, f"{key}: nothing was compared"
        # max() of an array with a NaN is NaN, which is at most nothing.
        worst, bound = float(values.max()), float(bound)
        entry = {"key": key, "value": worst, "bound": bound, "test": self._test}
        self._found.append(entry | ({} if np.isfinite(worst) else {"value": str(worst)}))
        assert worst <= bound, f"{key}: {worst:.3g} exceeds {bound:.3g} {about}"

    def close(self, key, ours, theirs, *, rtol=0.0, atol=0.0, marks=False, about=""):
        """Assert ``|ours - theirs| <= atol + rtol |theirs|`` everywhere, and record how near.

        With ``atol`` what is recorded is ``|ours - theirs| / (1 + rtol / atol |theirs|)``, to be
        held against ``atol``; without it ``|ours - theirs| / |theirs|``, against ``rtol``.
        Infinities are near to themselves; with ``marks`` NaN is, too: it means "none" in results.
        """
        ours, theirs = np.asarray(ours, float), np.asarray(theirs, float)
        one = ours.ndim == 0 or theirs.ndim == 0
        assert one or ours.shape == theirs.shape, f"{key}: {ours.shape} and {theirs.shape}"
        same = (ours == theirs) | (marks & np.isnan(ours) & np.isnan(theirs))
        with np.errstate(divide="ignore", invalid="ignore"):
            room = 1 + rtol / atol * np.abs(theirs) if atol else np.abs(theirs)
            gap = np.where(same, 0.0, np.abs(ours - theirs) / room)
        self(key, gap, atol or rtol, about=about)


@pytest.fixture
def deviation(request):
    return Deviation(request.node.nodeid, request.config.stash[_FOUND])


def pytest_addoption(parser):
    parser.addoption("--deviations", metavar="FILE", help="write what was measured into a file")


def pytest_configure(config):
    config.stash[_FOUND] = []


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    """A process of pytest-xdist has come to its end: what it found is in its luggage."""
    node.config.stash[_FOUND] += getattr(node, "workeroutput", {}).get("deviations", [])


def pytest_sessionfinish(session, exitstatus):
    config = session.config
    if hasattr(config, "workeroutput"):
        config.workeroutput["deviations"] = config.stash[_FOUND]
    elif config.option.deviations:
        write(Path(config.option.deviations), config.stash[_FOUND], int(exitstatus))


def write(path, found, exitstatus):
    """One entry a key, with the greatest value and every test that asked."""
    from angler_mjx.testing.validation.host import describe_host

    merged = {}
    for entry in found:
        key, test = entry["key"], entry["test"]
        held = merged.setdefault(
            key, {k: entry[k] for k in ("key", "value", "bound")} | {"tests": []}
        )
        # A value that is no number stays, whatever else was found.
        if isinstance(held["value"], float) and (
            isinstance(entry["value"], str)
            or entry["value"] / (entry["bound"] or 1) > held["value"] / (held["bound"] or 1)
        ):
            held |= {"value": entry["value"], "bound": entry["bound"]}
        if test not in held["tests"]:
            held["tests"].append(test)
    record = {
        "about": {
            **describe_host(),
            "at_utc": datetime.now(UTC).isoformat(timespec="seconds"),
            "exit_status": exitstatus,
        },
        "deviations": [merged[key] for key in sorted(merged)],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
