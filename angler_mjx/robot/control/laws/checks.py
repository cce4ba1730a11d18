"""Refusing gains that make no sense, on the host, before anything moves."""

import dataclasses
import math
from collections.abc import Collection
from typing import TYPE_CHECKING

from angler_mjx.errors import ConfigError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def check_gains(law: str, gains: "DataclassInstance", positive: Collection[str] = ()) -> None:
    """Every gain must be a finite number, none negative, and some not zero.

    Args:
        law: what the user calls it.
        gains: dataclass of numbers.
        positive: names of those that must not be zero either (divisors, thicknesses).

    Raises:
        ConfigError: naming each gain that does not hold, with its value.
    """
    faults = []
    for entry in dataclasses.fields(gains):
        number = float(getattr(gains, entry.name))
        if not math.isfinite(number) or number < 0:
            faults.append(f"{entry.name} = {number:g} must be a finite number, 0 or more")
        elif number == 0 and entry.name in positive:
            faults.append(f"{entry.name} = 0 must be greater than 0")
    if faults:
        raise ConfigError(f"gains of {law}: " + "; ".join(faults))
