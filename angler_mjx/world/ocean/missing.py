"""Missing values of NetCDF variables by CF 1.11, section 2.5.1, as netCDF4-python masks them.

A stored (packed) value is missing if it equals ``_FillValue`` or one of ``missing_value``, or the
default fill value of its type where there is no ``_FillValue``, if it is NaN, or if it lies outside
``valid_min``, ``valid_max`` or ``valid_range``.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from angler_mjx.errors import format_value

_DEFAULT_FILL = {
    "i1": -127,
    "u1": 255,
    "i2": -32767,
    "u2": 65535,
    "i4": -2147483647,
    "u4": 4294967295,
    "i8": -9223372036854775806,
    "u8": 18446744073709551614,
    "f4": 9.969209968386869e36,
    "f8": 9.969209968386869e36,
}
"""``NC_FILL_SHORT`` and so on of netcdf.h, by NumPy's type."""


def find_missing(stored: np.ndarray, attributes: Mapping[str, object]) -> np.ndarray:
    """Return whether each value of a variable is missing, bool of their shape.

    Args:
        stored: values as stored in the file, neither scaled nor masked.
        attributes: attributes of the variable in the file.

    Raises:
        ValueError: an attribute is not valid; names it.
    """
    if stored.dtype.kind not in "iuf":
        raise ValueError(f"its values are no numbers ({stored.dtype})")
    values = _apply_signedness(stored, stored.dtype, attributes)
    missing = np.zeros(values.shape, bool)
    if values.dtype.kind == "f":
        missing |= np.isnan(values)
    for fill in _fill_values(stored.dtype, values.dtype, attributes):
        missing |= values == fill
    bounds = list(_valid_bounds(stored.dtype, values.dtype, attributes))
    outside = _is_outside(values, bounds)
    _require_packed(values, missing, outside, bounds, attributes)
    absent: np.ndarray = missing | outside
    return absent


@dataclass(frozen=True)
class _Bound:
    """One end of the valid range."""

    key: str
    number: np.number
    is_upper: bool


def _apply_signedness(
    numbers: np.ndarray, stored: np.dtype, attributes: Mapping[str, object]
) -> np.ndarray:
    """Return numbers of the stored integer type as signed or unsigned, by ``_Unsigned``."""
    kind = {"true": "u", "false": "i"}.get(str(attributes.get("_Unsigned", "")).lower())
    if kind is None or stored.kind not in "iu":
        return numbers
    with np.errstate(over="ignore", invalid="ignore"):
        cast = numbers.astype(stored)
    is_held = np.array_equal(cast, numbers)
    return cast.view(f"{stored.byteorder}{kind}{stored.itemsize}") if is_held else numbers


def _read_numbers(
    key: str, count: int | None, stored: np.dtype, attributes: Mapping[str, object]
) -> np.ndarray:
    """Return the numbers [n] of an attribute; ``count`` numbers, if that is not None."""
    numbers = np.ravel(np.asarray(attributes[key]))
    if numbers.dtype.kind not in "iuf" or count not in (None, len(numbers)):
        wanted = "a number" if count == 1 else "numbers" if count is None else f"{count} numbers"
        value = _format_attribute(attributes[key])
        raise ValueError(f"{key} = {value}: must be {wanted}; correct it in the file (ncatted)")
    return _apply_signedness(numbers, stored, attributes)


def _format_attribute(attribute: object) -> str:
    """Return an attribute in the form of messages."""
    return format_value(np.asarray(attribute).tolist())


def _fill_values(
    stored: np.dtype, dtype: np.dtype, attributes: Mapping[str, object]
) -> Iterator[np.number]:
    """Yield the numbers that stand for missing values, in the variable's type."""
    for key, count in (("_FillValue", 1), ("missing_value", None)):
        if key not in attributes:
            continue
        for number in _read_numbers(key, count, stored, attributes):
            with np.errstate(over="ignore", invalid="ignore"):
                cast = number.astype(dtype)
            # A number that an integer type cannot hold equals none of the values.
            if dtype.kind == "f" or cast == number:
                yield cast
    # With the other sign the default fill value lies in the middle of the type's range.
    default = _DEFAULT_FILL.get(dtype.str[1:]) if dtype == stored else None
    if "_FillValue" not in attributes and default is not None:
        yield dtype.type(default)


def _valid_bounds(
    stored: np.dtype, dtype: np.dtype, attributes: Mapping[str, object]
) -> Iterator[_Bound]:
    """Yield the ends of the valid range; those of floating-point variables in their type."""
    for key, uppers in (
        ("valid_range", (False, True)),
        ("valid_min", (False,)),
        ("valid_max", (True,)),
    ):
        if key not in attributes:
            continue
        numbers = _read_numbers(key, len(uppers), stored, attributes)
        for number, is_upper in zip(numbers, uppers, strict=True):
            with np.errstate(over="ignore"):
                cast = number.astype(dtype) if dtype.kind == "f" else number
            yield _Bound(key, cast, is_upper)


def _is_outside(values: np.ndarray, bounds: list[_Bound]) -> np.ndarray:
    """Return whether each value lies outside the valid range, bool of their shape."""
    outside = np.zeros(values.shape, bool)
    for bound in bounds:
        outside |= values > bound.number if bound.is_upper else values < bound.number
    return outside


def _require_packed(
    values: np.ndarray,
    missing: np.ndarray,
    outside: np.ndarray,
    bounds: list[_Bound],
    attributes: Mapping[str, object],
) -> None:
    """Require that floating-point bounds of packed integers agree in either unit.

    By CF they are in packed units; by the NetCDF Users Guide (appendix A, valid_range) those of the
    type of ``scale_factor`` are in unpacked units.
    """
    floats = [
        bound for bound in bounds if values.dtype.kind != "f" and bound.number.dtype.kind == "f"
    ]
    if not floats:
        return
    scale, offset = (
        float(_read_numbers(key, 1, values.dtype, {key: neutral, **attributes})[0])
        for key, neutral in (("scale_factor", 1.0), ("add_offset", 0.0))
    )
    unpacked = _is_outside(scale * values.astype(np.float64) + offset, bounds)
    if np.any((outside != unpacked) & ~missing):
        bound = floats[0]
        raise ValueError(
            f"{bound.key} = {_format_attribute(attributes[bound.key])} is {bound.number.dtype} and "
            "its values "
            f"are {values.dtype}: give it as {values.dtype}, in stored (packed) units (ncatted)"
        )
