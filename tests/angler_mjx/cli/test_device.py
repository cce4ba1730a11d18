"""Choosing what JAX computes on, and what it keeps."""

import jax
import pytest

from angler_mjx.cli.shared import device

OWN = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"


@pytest.fixture
def least_s():
    """JAX's own limit, put back afterwards."""
    name = "jax_persistent_cache_min_compile_time_secs"
    before = getattr(jax.config, name)
    jax.config.update(name, 1.0)
    yield lambda: getattr(jax.config, name)
    jax.config.update(name, before)


def test_all_programs_are_kept_unless_the_environment_says_otherwise(least_s, monkeypatch):
    monkeypatch.setenv(OWN, "1.0")
    device.keep_all_programs()
    assert least_s() == 1.0
    monkeypatch.delenv(OWN)
    device.keep_all_programs()
    assert least_s() == 0.0
