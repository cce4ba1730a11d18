"""Arrays with a row of each actuator of a vehicle, filled up where others stand."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def put_columns(columns: Mapping[str, np.ndarray]) -> dict[str, jax.Array]:
    """Return columns on the device: flags as they are, numbers of JAX's default float type."""
    dtype = jnp.result_type(float)
    return {
        name: jnp.asarray(column if column.dtype == bool else np.asarray(column, dtype))
        for name, column in columns.items()
    }


def pad_rows[Rows: DataclassInstance](
    table: Rows, before: int, after: int, fill: Mapping[str, float]
) -> Rows:
    """Return a dataclass of arrays [n, ...] with more rows.

    Args:
        table: the dataclass.
        before: number of rows in front of it.
        after: number of rows behind it.
        fill: values of these rows by name of the field; 0 if left out.
    """
    padded: dict[str, Any] = {}
    for entry in fields(table):
        leaf = np.asarray(getattr(table, entry.name))
        width = [(before, after)] + [(0, 0)] * (leaf.ndim - 1)
        value = np.asarray(fill.get(entry.name, 0), leaf.dtype)
        padded[entry.name] = np.pad(leaf, width, constant_values=value)
    return replace(table, **padded)


def pad_fleet[Rows: DataclassInstance](
    parts: Sequence[Rows | None], rows: Sequence[int], n: int, fill: Mapping[str, float]
) -> list[Rows | None]:
    """Return the tables of the vehicles of a fleet, each with ``n`` rows; None without any.

    Args:
        parts: of each vehicle.
        rows: actuators of each vehicle.
        n: rows of all.
        fill: values of rows of other actuators by name of the field; 0 if left out.
    """
    first = next((part for part in parts if part is not None), None)
    if first is None:
        return list(parts)
    blank: Rows = jax.tree.map(lambda leaf: np.asarray(leaf)[:0], first)
    return [
        pad_rows(blank, n, 0, fill) if part is None else pad_rows(part, 0, n - count, fill)
        for part, count in zip(parts, rows, strict=True)
    ]
