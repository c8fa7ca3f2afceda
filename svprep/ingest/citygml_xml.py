"""The XML parser under CityGML: expat, which is in C and comes with Python.

A city file is untrusted input. No entity is ever expanded, no default for an attribute
taken, nothing else opened: entities that stand for entities ("billion laughs") make
gigabytes out of a few lines, external ones read files of the machine or the network.
"""

from __future__ import annotations

import pyexpat
from pathlib import Path
from typing import Final, NoReturn

from svprep.errors import InputError
from svprep.ingest.parsed import shown

_BUFFER_BYTES: Final = 1 << 16


def new_parser(path: Path) -> pyexpat.XMLParserType:
    """Return a parser that reports names as ``"NAMESPACE LOCAL"`` and refuses declarations.

    Its calls to `Parse` raise `InputError` for these.
    """
    parser = pyexpat.ParserCreate(namespace_separator=" ")
    parser.buffer_text = True
    parser.buffer_size = _BUFFER_BYTES

    def refuse(what: str) -> NoReturn:
        raise InputError(
            f"{path}: line {parser.CurrentLineNumber}: it declares {what}, which can hide a bomb "
            "or another file, and which no city model needs; remove the DOCTYPE."
        )

    def at_doctype(name: str, system: str | None, public: str | None, _: int) -> None:
        if system or public:
            refuse(f'an external document type ("{shown(system or public)}")')

    def at_entity(name: str, is_parameter: int, *_: object) -> None:
        refuse(f'the {"parameter " if is_parameter else ""}entity "{shown(name)}"')

    def at_attribute(element: str, attribute: str, *_: object) -> None:
        refuse(f'the attribute "{shown(attribute)}" of <{shown(element)}>')

    def at_reference(*_: object) -> int:
        refuse("an external entity")

    parser.StartDoctypeDeclHandler = at_doctype
    parser.EntityDeclHandler = at_entity
    parser.AttlistDeclHandler = at_attribute
    parser.ExternalEntityRefHandler = at_reference
    return parser


def xml_error(path: Path, error: Exception) -> InputError:
    """Return the message for what expat, or a codec that it asked for, raised.

    Raises
    ------
    Exception
        `error` itself, if they did not raise it.
    """
    if isinstance(error, pyexpat.ExpatError):
        return InputError(
            f"{path}: not readable XML: {shown(error)}; the file is damaged, cut off, or not XML."
        )
    if type(error) is LookupError or isinstance(error, UnicodeError) or "encoding" in str(error):
        return InputError(f"{path}: its encoding is not read ({shown(error)}); save it as UTF-8.")
    raise error
