"""What the door reads of an XML text: its root and the interfaces an FMU offers - and no DOCTYPE, whose entities can read files and fill the memory."""

from __future__ import annotations

from xml.parsers import expat

_KINDS = ("ModelExchange", "CoSimulation", "ScheduledExecution")


class HasDoctype(Exception):  # noqa: N818 - it ends the reading
    """Raised while reading."""


class XmlReader:
    """The root of an XML text, and refusal of a DOCTYPE."""

    def __init__(self, keep: bool) -> None:
        self.root: dict[str, str] = {}
        self.root_name = ""
        self.kinds: dict[str, str] = {}
        self._keep = keep

    def read(self, text: bytes) -> None:
        parser = expat.ParserCreate()
        parser.StartDoctypeDeclHandler = self._doctype
        if self._keep:
            parser.StartElementHandler = self._element
        parser.Parse(text, True)

    def _doctype(self, *_: object) -> None:
        raise HasDoctype

    def _element(self, name: str, attributes: dict[str, str]) -> None:
        if not self.root_name:
            self.root_name, self.root = name, attributes
        elif name in _KINDS:
            self.kinds[name] = attributes.get("modelIdentifier", "")
