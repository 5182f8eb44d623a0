"""XML as elements that know their lines; a text that could cost a reader its memory is refused."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from xml.parsers import expat

from tfbus.base.errors import UrdfError
from tfbus.base.wording import printable

MOST_BYTES = 20_000_000
MOST_ELEMENTS = 100_000
MOST_DEPTH = 100

# The encodings of files of robots. Python knows others, some of which are no encodings of text.
_ENCODINGS = re.compile(
    r"utf-?8|utf-?16|us-ascii|ascii|latin-?1|iso-?8859-\d+|windows-125\d|cp125\d"
)
# Ours are texts by then, and others allow white space before it.
_DECLARATION = re.compile(r"\s*<\?xml\s[^>]*\?>")
_DECLARED = re.compile(rb"""<\?xml[^>]*?\bencoding\s*=\s*["']([^"'>]*)["']""")


@dataclass(slots=True)
class Element:
    """An element: its tag, its attributes, the elements in it, and the line where it begins."""

    tag: str
    attributes: dict[str, str]
    source: str
    line: int
    children: list[Element] = field(default_factory=list)

    def get(self, attribute: str, default: str = "") -> str:
        """The text of an attribute."""
        return self.attributes.get(attribute, default)

    def find(self, tag: str) -> Element | None:
        """The first element in this with a tag; None without one."""
        return next((child for child in self.children if child.tag == tag), None)

    def find_all(self, tag: str) -> list[Element]:
        """The elements in this with a tag."""
        return [child for child in self.children if child.tag == tag]

    def mistake(self, reason: str) -> UrdfError:
        """The error to raise for a mistake in this element."""
        return mistake_at(self.source, self.line, reason)


def mistake_at(source: str, line: int, reason: str) -> UrdfError:
    """The error to raise for a mistake in a line of a source."""
    return UrdfError(f"{source}:{line}: {reason}")


def decoded(data: bytes, source: str) -> str:
    """The text of an XML file, in the encoding that it declares: UTF-8 by default.

    Raises UrdfError if it is none, or longer than 20 MB.
    """
    if len(data) > MOST_BYTES:
        raise UrdfError(f"{source} has {len(data) / 1e6:.0f} MB; at most 20 MB are read")
    declared = _DECLARED.match(data.removeprefix(b"\xef\xbb\xbf"))
    encoding = declared[1].decode("ascii", "replace").lower() if declared else "utf-8"
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16"
    if not _ENCODINGS.fullmatch(encoding):
        raise mistake_at(
            source, 1, f"encoding {printable(encoding, 40)!r} is not supported; save it as UTF-8"
        )
    try:
        return data.decode("utf-8-sig" if encoding in ("utf-8", "utf8") else encoding)
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise mistake_at(
            source, line, f"not {encoding} ({error.reason}); save it as UTF-8"
        ) from None
    except LookupError:
        raise mistake_at(
            source, 1, f"encoding {encoding!r} is not known; save it as UTF-8"
        ) from None


def read_xml(text: str, source: str) -> Element:
    """The root element of an XML text.

    Raises UrdfError, with the line, if it is not well-formed, its DOCTYPE declares anything,
    or it has more than 20 MB, 100,000 elements or 100 levels.
    """
    return _Reader(source).read(text)


class _Reader:
    """Builds elements from expat's events."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._open: list[Element] = []
        self._root: Element | None = None
        self._count = 0
        self._parser = expat.ParserCreate("utf-8")
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.StartDoctypeDeclHandler = self._check_doctype

    def read(self, text: str) -> Element:
        if declaration := _DECLARATION.match(text):
            text = "\n" * declaration[0].count("\n") + text[declaration.end() :]
        try:
            data = text.encode()
        except UnicodeEncodeError:
            raise UrdfError(f"{self._source} is not text: it contains half a character") from None
        if len(data) > MOST_BYTES:
            raise UrdfError(f"{self._source} has {len(data) / 1e6:.0f} MB; at most 20 MB are read")
        try:
            self._parser.Parse(data, True)
        except expat.ExpatError as error:
            reason = expat.ErrorString(error.code)
            raise mistake_at(self._source, error.lineno, f"not XML: {reason}") from None
        finally:
            # The parser and its handlers refer to each other.
            self._parser.StartElementHandler = None
            self._parser.EndElementHandler = None
            self._parser.StartDoctypeDeclHandler = None
        assert self._root is not None, "expat reports a document without elements"
        return self._root

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, self._source, self._parser.CurrentLineNumber)
        self._count += 1
        if self._count > MOST_ELEMENTS:
            raise element.mistake(f"more than {MOST_ELEMENTS} elements: not a robot")
        if len(self._open) == MOST_DEPTH:
            raise element.mistake(f"more than {MOST_DEPTH} elements in each other: not a robot")
        if self._open:
            self._open[-1].children.append(element)
        else:
            self._root = element
        self._open.append(element)

    def _end(self, tag: str) -> None:
        self._open.pop()

    def _check_doctype(self, name: str, system: object, public: object, declares: int) -> None:
        # An entity stands for a text of any length; expat copies default attributes into every
        # element.
        if declares:
            raise mistake_at(
                self._source,
                self._parser.CurrentLineNumber,
                "its DOCTYPE has declarations between [ and ]; entities and default attributes are "
                "not allowed in a URDF: write out what they stand for",
            )
