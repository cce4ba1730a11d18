"""One file of a tidal stream for all tests of this folder."""

import pytest

from angler_experiments.ocean import headland


@pytest.fixture(scope="session")
def ocean_file(tmp_path_factory):
    return headland.write_dataset(tmp_path_factory.mktemp("ocean") / "headland.nc")
