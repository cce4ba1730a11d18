"""A plugin of pytest: test files run in the order of the command line, whatever conftest says."""

from pathlib import Path

import pytest


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Sort by the place of each item's file among the arguments."""
    order = {Path(name).resolve(): i for i, name in enumerate(config.args)}
    items.sort(key=lambda item: order.get(item.path.resolve(), len(order)))
