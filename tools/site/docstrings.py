"""Extension of Sphinx: signatures and docstrings of the API as this project writes them."""

import re
from collections.abc import MutableSequence
from dataclasses import fields, is_dataclass
from inspect import isclass
from typing import Any

from sphinx.util.inspect import signature as read_signature
from sphinx.util.inspect import stringify_signature

MAX_SIGNATURE_FIELDS = 6
"""A dataclass with more fields is shown without a signature: its attributes follow."""

PAGE = re.compile(r"`{1,2}docs/([a-z0-9_/]+)\.md`{1,2}")

_attribute_texts: dict[str, list[str]] = {}


def format_signature(
    app: object,
    what: str,
    name: str,
    value: Any,
    options: object,
    signature: str | None,
    returns: str | None,
) -> tuple[str | None, str | None]:
    """Drop signatures of interfaces, of models of files, and of dataclasses with many fields.

    A class whose base is mocked has the signature of its ``__init__``.
    """
    del app, what, name, options
    if not isclass(value):
        return signature, returns
    if hasattr(value, "__sphinx_mock__"):
        found = read_signature(value.__init__, bound_method=True)
        return stringify_signature(
            found, show_return_annotation=False, unqualified_typehints=True
        ), None
    is_interface = getattr(value, "_is_protocol", False) or bool(
        getattr(value, "__abstractmethods__", ())
    )
    is_long = is_dataclass(value) and len(fields(value)) > MAX_SIGNATURE_FIELDS
    if is_interface or is_long or hasattr(value, "model_fields"):
        return "", None
    return signature, returns


def skip_foreign_member(
    app: object, what: str, name: str, value: object, skip: bool, options: object
) -> bool | None:
    """Skip members that come from pydantic, and tables of renamed names."""
    del app, what, value, options
    return True if skip or name.startswith(("model_", "renamed_")) else None


def link_pages(
    app: object,
    what: str,
    name: str,
    value: object,
    options: object,
    lines: MutableSequence[str],
) -> None:
    """Turn paths of pages of docs into links to them."""
    del app, what, name, value, options
    lines[:] = [PAGE.sub(r":doc:`/\1`", line) for line in lines]


def keep_attribute(
    app: object,
    what: str,
    name: str,
    value: object,
    options: object,
    lines: MutableSequence[str],
) -> None:
    """Keep the text of an attribute, of which Napoleon takes all before a colon for a type."""
    del app, value, options
    if what == "attribute":
        _attribute_texts[name] = list(lines)


def restore_attribute(
    app: object,
    what: str,
    name: str,
    value: object,
    options: object,
    lines: MutableSequence[str],
) -> None:
    """Restore the text of an attribute after Napoleon."""
    del app, value, options
    if what == "attribute":
        lines[:] = _attribute_texts.pop(name)


def setup(app: Any) -> dict[str, bool]:
    """Connect the functions above to Sphinx; Napoleon's priority is 500."""
    app.connect("autodoc-process-signature", format_signature)
    app.connect("autodoc-skip-member", skip_foreign_member)
    app.connect("autodoc-process-docstring", link_pages, priority=300)
    app.connect("autodoc-process-docstring", keep_attribute, priority=400)
    app.connect("autodoc-process-docstring", restore_attribute, priority=600)
    return {"parallel_read_safe": True}
