"""XML files as trees of elements that remember their lines and whether they were read.

Readers mark what they take, so that the rest can be listed by name. Entities and DOCTYPE are
refused: a small file can expand to gigabytes by them.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.robot.importing.notes import Location, Notes

MAX_XML_BYTES = 1 << 24
MAX_LEVELS = 100
"""Max depth of nested elements; files of vehicles have 15."""


@dataclass(eq=False, kw_only=True)
class Element:
    """Element of an XML file."""

    tag: str
    attributes: dict[str, str]
    location: Location
    children: list["Element"] = field(default_factory=list)
    text: str = ""
    is_read: bool = False
    """Whether a reader took it."""
    read_attributes: set[str] = field(default_factory=set)

    def fail(self, message: str) -> NoReturn:
        """Raise a ConfigError that names file, line and element."""
        raise ConfigError(f"{self.location.file}:{self.location.line}: {self.label}: {message}")

    @property
    def label(self) -> str:
        """Return the tag with its name, as in ``<link name="base_link">``."""
        name = self.attributes.get("name")
        return f"<{self.tag}>" if name is None else f'<{self.tag} name="{name}">'

    def find_all(self, *tags: str) -> list["Element"]:
        """Return the children of these tags, marked as read."""
        chosen = [child for child in self.children if child.tag in tags]
        for child in chosen:
            child.is_read = True
        return chosen

    def find(self, tag: str) -> "Element | None":
        """Return the only child of a tag, marked as read, or None.

        Raises:
            ConfigError: there are several.
        """
        chosen = self.find_all(tag)
        if len(chosen) > 1:
            chosen[1].fail(f"<{tag}> occurs twice in {self.label}; remove one of them")
        return chosen[0] if chosen else None

    def read(self) -> "Element":
        """Mark this element, its attributes and all below it as read."""
        self.is_read = True
        self.read_attributes.update(self.attributes)
        for child in self.children:
            child.read()
        return self

    def attribute(self, name: str, default: str | None = None) -> str:
        """Return an attribute, marked as read.

        Raises:
            ConfigError: it is missing and has no default.
        """
        self.read_attributes.add(name)
        value = self.attributes.get(name, default)
        if value is None:
            self.fail(f'attribute "{name}" is missing; add it')
        return value.strip()

    def attribute_number(self, name: str, default: float | None = None) -> float:
        """Return a finite number of an attribute.

        Raises:
            ConfigError: it is missing without a default, or no number.
        """
        text = self.attribute(name, None if default is None else repr(default))
        return self.parse_numbers(text, 1, f'attribute "{name}"')[0]

    def attribute_numbers(
        self, name: str, count: int, default: tuple[float, ...] | None = None
    ) -> tuple[float, ...]:
        """Return finite numbers [count] of an attribute, separated by spaces."""
        if default is not None and name not in self.attributes:
            return default
        return self.parse_numbers(self.attribute(name), count, f'attribute "{name}"')

    def numbers(self, count: int | None = None) -> tuple[float, ...]:
        """Return the finite numbers of the text of the element, marked as read."""
        self.is_read = True
        return self.parse_numbers(self.text, count, "text")

    def number(self) -> float:
        """Return the finite number of the text of the element, marked as read."""
        return self.numbers(1)[0]

    def parse_numbers(self, text: str, count: int | None, what: str) -> tuple[float, ...]:
        """Return the finite numbers of a text, separated by spaces or commas.

        Raises:
            ConfigError: a word is no finite number, or there are not ``count`` of them.
        """
        words = text.replace(",", " ").split()
        try:
            values = tuple(float(word) for word in words)
        except ValueError:
            values = (math.nan,)
        if not all(map(math.isfinite, values)):
            self.fail(f"{what} = {format_value(text.strip())}: write finite numbers")
        if count is not None and len(values) != count:
            self.fail(
                f"{what} = {format_value(text.strip())}: write {count} "
                f"number{'s' if count > 1 else ''}, not {len(values)}"
            )
        return values


def read_xml(path: Path) -> Element:
    """Read an XML file.

    Raises:
        ConfigError: it cannot be read, is too large, no XML, or holds a DOCTYPE.
    """
    try:
        size = path.stat().st_size
        if size > MAX_XML_BYTES:
            raise ConfigError(
                f"{path}: {size} bytes; files of vehicles have {MAX_XML_BYTES} at most"
            )
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    return parse_xml(data, path)


def parse_xml(data: bytes, path: Path) -> Element:
    """Parse the text of an XML file; errors as in `read_xml`."""
    builder = _Builder(path)
    parser = builder.parser
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        reason = expat.errors.messages[error.code]
        raise ConfigError(
            f"{path}:{error.lineno}: not well-formed XML ({reason}, column {error.offset + 1}); "
            "close or correct the element there"
        ) from error
    except (LookupError, ValueError) as error:
        raise ConfigError(f"{path}:1: not well-formed XML ({error}); write it in UTF-8") from error
    assert builder.root is not None  # expat refuses a file without elements
    return builder.root


class _Builder:
    """Builds elements from expat's calls."""

    def __init__(self, path: Path) -> None:
        self._path, self._stack = path, list[Element]()
        self.root: Element | None = None
        self.parser = parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._add_text
        parser.StartDoctypeDeclHandler = self._refuse_doctype

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        location = Location(file=self._path, line=self.parser.CurrentLineNumber)
        element = Element(tag=tag, attributes=attributes, location=location)
        if len(self._stack) >= MAX_LEVELS:
            element.fail(f"nested in {MAX_LEVELS} others; no vehicle is described so deep")
        if self._stack:
            self._stack[-1].children.append(element)
        else:
            self.root = element
        self._stack.append(element)

    def _end(self, tag: str) -> None:
        self._stack.pop()

    def _add_text(self, text: str) -> None:
        self._stack[-1].text += text

    def _refuse_doctype(self, name: str, *rest: object) -> None:
        raise ConfigError(
            f"{self._path}:{self.parser.CurrentLineNumber}: <!DOCTYPE {name}>: entities are not "
            "expanded; remove the DOCTYPE"
        )


def note_unread(element: Element, notes: Notes, inside: str = "") -> None:
    """Add a note on every element and attribute below ``element`` that no reader took.

    Args:
        element: element that was read.
        notes: list to add to.
        inside: label of the elements around it.
    """
    where = f" in {inside}" if inside else ""
    for name, value in element.attributes.items():
        if name not in element.read_attributes and not name.startswith("xmlns"):
            notes.add(
                "dropped",
                f"attribute {name} = {format_value(value, 40)} of <{element.tag}>{where}: "
                "not understood",
                element.location,
            )
    for child in element.children:
        if child.is_read:
            note_unread(child, notes, element.tag)
        else:
            text = _describe(child)
            stated = "" if child.children else " ".join(child.text.split())
            value = f" = {format_value(stated, 40)}" if stated else ""
            notes.add(
                "dropped", f"{text}{value} in <{element.tag}>: not understood", child.location
            )


def _describe(element: Element) -> str:
    """Return the tag of an element, with the file of a plugin and the type of a sensor."""
    for tag, key in (("plugin", "filename"), ("sensor", "type")):
        if element.tag == tag and key in element.attributes:
            return f'<{tag} {key}="{element.attributes[key]}">'
    return f"<{element.tag}>"
