"""Emitted kernels as functions of this machine."""

import numpy as np
import pytest

from ...cuda_on_cpu import addresses, compile_here


@pytest.fixture
def run_source():
    """Run a kernel of independent lanes on NumPy arrays; written ones are changed in place."""

    def run(source, arrays, *, constants, blocks=1, rows=1, threads=1):
        pointers = [*arrays[:constants], *arrays[constants:], *arrays[constants:]]
        compile_here(source).launch(blocks, rows, threads, addresses(pointers))

    return run


@pytest.fixture
def numbers():
    """Float32 numbers of all kinds."""
    rng = np.random.default_rng(0)
    special = [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 1e-30, 3.4e38, 0.5, 1.5, 2.5]
    return np.concatenate([special, rng.normal(size=52) * 10.0 ** rng.integers(-3, 3, 52)]).astype(
        np.float32
    )
