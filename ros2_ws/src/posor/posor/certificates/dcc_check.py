# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Check a Digital Calibration Certificate, offline: against its schema files, and its units against D-SI."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET
from xml.parsers import expat

from posor.certificates.dcc_document import DCC, SI
from posor.certificates.dsi_units import is_dsi, to_dsi
from posor.errors import CertificateError, clause_of, similar_name, sum_up
from posor.input_text import read_input_bytes
from posor.optional_library import optional_library

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

ROOT = f"{{{DCC}}}digitalCalibrationCertificate"
XSD = "http://www.w3.org/2001/XMLSchema"
SIGNATURES = "http://www.w3.org/2000/09/xmldsig#"
"""Namespace whose schema ``xmlschema`` brings."""
_IMPORT, *_INCLUDES = (f"{{{XSD}}}{name}" for name in ("import", "include", "redefine"))
_IMPORTS = (_IMPORT, *_INCLUDES)
_OF_PATTERN = {
    r"[^\s]+(\s+[^\s]+)*": "text, without blanks at its ends",
    r"[A-Z]{2}": "two capital letters (ISO 3166-1), such as DE",
    r"[a-z]{2}": "two small letters (ISO 639-1), such as en",
    r"[-+]?((\d*\.\d+)|(\d+\.\d*)|(\d+\.?))([Ee][-+]?\d+)?": "a number, such as -1.5e-6",
    r"\+?((\d*\.\d+)|(\d+\.\d*)|(\d+\.?))([Ee][-+]?\d+)?": "a number of 0 or more, such as 1.5e-6",
    r"\+?(([1-9]\d*\.\d*)|([1-9]\d*))": "a coverage factor of 1 or more, without exponent, such as 1.96",
    r"\+?((0(\.\d*)?)|(1(\.0*)?))": "a probability from 0 to 1, without exponent, such as 0.95",
}
"""Words for the patterns of the schema."""
_OF_TYPE = {
    "date": "a date, such as 2026-11-26",
    "dateTime": "date and time, such as 2026-11-26T16:30:00Z",
    "boolean": "true or false",
    "double": "a number",
    "ID": "an id that no other element has",
}
MOST_DEPTH = 100
MOST_BYTES = 256 << 20  # of a certificate, whose data may be embedded
_UNITS = {
    f"{{{SI}}}{name}" for name in ("unit", "listUnit", "unitPhase", "listUnitPhase", "unitXMLList", "unitPhaseXMLList")
}
_PREFIXES = {DCC: "dcc:", SI: "si:", SIGNATURES: "ds:", XSD: "xs:"}


@dataclass(frozen=True)
class LocatedTree:
    """An XML file as elements that know their lines."""

    path: Path
    root: ET.Element
    lines: Mapping[ET.Element, int]
    prefixes: Mapping[str, str]  # namespaces by prefix, for names in values such as those of xsi:type

    def error(self, element: ET.Element, what: str, expected: str) -> CertificateError:
        """Return an error of an element."""
        where = f"{self.path}, line {self.lines[element]}, {short(element.tag)}"
        return CertificateError(what, where=where, expected=expected)


def short(tag: str) -> str:
    """Return the tag of an element with the usual prefix of its namespace."""
    namespace, _, name = tag[1:].rpartition("}") if tag.startswith("{") else ("", "", tag)
    return f"{_PREFIXES.get(namespace, f'{{{namespace}}}' if namespace else '')}{name}"


def read_xml(path: Path, expected: str, *, may_have_dtd: bool = False) -> LocatedTree:
    """Read an XML file; ``expected``: its kind. Raises CertificateError: it cannot be read, is no XML, or has a DTD."""
    lines: dict[ET.Element, int] = {}
    builder, parser = ET.TreeBuilder(), expat.ParserCreate(namespace_separator="}")

    def start(tag: str, attributes: dict[str, str]) -> None:
        depth.append(tag)
        if len(depth) > MOST_DEPTH:
            what = f"has elements nested deeper than {MOST_DEPTH}"
            raise CertificateError(what, where=f"{path}, line {parser.CurrentLineNumber}", expected=expected)
        named = {_clark(name): value for name, value in attributes.items()}
        lines[builder.start(_clark(tag), named)] = parser.CurrentLineNumber

    def refuse(*_: object) -> None:
        what = "has a document type definition"
        raise CertificateError(
            what, where=f"{path}, line {parser.CurrentLineNumber}", expected=f"{expected} without one"
        )

    def end(tag: str) -> None:
        depth.pop()
        builder.end(_clark(tag))

    depth, prefixes = list[str](), dict[str, str]()
    parser.StartNamespaceDeclHandler = lambda prefix, uri: prefixes.setdefault(prefix or "", uri or "")
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    if not may_have_dtd:
        parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(read_input_bytes(path, MOST_BYTES), True)  # noqa: FBT003  positional only
    except OSError as error:
        raise CertificateError(f"cannot be read: {error.strerror}", where=str(path), expected=expected) from error
    except LookupError as error:  # an unknown encoding
        raise CertificateError(f"is not XML: {clause_of(error)}", where=str(path), expected=expected) from error
    except expat.ExpatError as error:
        problem = f"is not XML: {expat.ErrorString(error.code)}, column {error.offset + 1}"
        raise CertificateError(problem, where=f"{path}, line {error.lineno}", expected=expected) from error
    return LocatedTree(path, builder.close(), lines, prefixes)


def _clark(name: str) -> str:
    return f"{{{name}" if "}" in name else name


def check_dcc(path: Path, schema_folder: Path) -> None:
    """Check a certificate, without network.

    Raises:
        CertificateError: The file is invalid, summed up if several elements are wrong; or the folder lacks a schema.
        ParameterError: The library ``xmlschema`` is not installed.

    """
    tree = read_xml(path, "a Digital Calibration Certificate (XML)")
    if tree.root.tag != ROOT:
        expected = f"digitalCalibrationCertificate in the namespace {DCC}"
        raise tree.error(tree.root, f"is the root, {tree.root.tag}", expected)
    xmlschema = optional_library("xmlschema", "dcc", path)
    schema = _load_schema(schema_folder, tree, xmlschema)
    try:
        problems = list(schema.iter_errors(tree.root, namespaces=dict(tree.prefixes)))
    except xmlschema.XMLSchemaException as error:  # the file names a type that there is not
        raise CertificateError(clause_of(error), where=str(path), expected="types of the schema") from error
    errors: dict[str, CertificateError] = {}
    for found in (*(_explain(tree, error) for error in problems), *_unit_errors(tree)):
        errors.setdefault(found.where, found)
    if errors:
        raise sum_up(list(errors.values()))


def _unit_errors(tree: LocatedTree) -> Iterator[CertificateError]:
    for element in tree.root.iter():
        if element.tag in _UNITS:
            for unit in (element.text or "").split() or [""]:
                if not is_dsi(unit):
                    expected = to_dsi(unit) or r"a unit in D-SI, such as \metre or \metre\second\tothe{-2}"
                    yield tree.error(element, f"unit '{unit}'", expected)


def _load_schema(folder: Path, tree: LocatedTree, xmlschema: Any) -> Any:
    """Return the schema of a certificate's version, with every import from the folder."""
    found = [read_xml(path, "an XML schema", may_have_dtd=True) for path in sorted(folder.glob("*.xsd"))]
    of_dcc = {str(each.root.get("version")): each for each in found if each.root.get("targetNamespace") == DCC}
    if not of_dcc:
        expected = f"the schema file of {DCC} in this folder, such as dcc-3.2.1.xsd of PTB"
        raise CertificateError("holds no schema of a certificate", where=f"--schema {folder}", expected=expected)
    version = tree.root.get("schemaVersion")
    if version not in of_dcc:
        what = "attribute schemaVersion is missing" if version is None else f"schemaVersion '{version}'"
        raise tree.error(tree.root, what, f"{' or '.join(of_dcc)}, whose schema is in {folder}")
    local: dict[str, str] = {}
    waiting, known = [of_dcc[version]], {of_dcc[version].path}
    while waiting:
        schema = waiting.pop()
        for each in schema.root:
            if each.tag not in _IMPORTS or each.get("namespace") == SIGNATURES:
                continue
            chosen = _choose_import(schema, each, found, folder)
            local[each.get("schemaLocation", "")] = chosen.path.resolve().as_uri()
            if chosen.path not in known:
                known.add(chosen.path)
                waiting.append(chosen)
    try:
        return xmlschema.XMLSchema(str(of_dcc[version].path.resolve()), allow="local", uri_mapper=local)
    except xmlschema.XMLSchemaException as error:
        what = f"is not a valid schema: {clause_of(error)}"
        raise CertificateError(
            what, where=str(of_dcc[version].path), expected="the files as PTB publishes them"
        ) from error


def _choose_import(schema: LocatedTree, element: ET.Element, found: Sequence[LocatedTree], folder: Path) -> LocatedTree:
    """Return the file of an import or include: that of its name, or the only one of its namespace."""
    namespace = element.get("namespace", schema.root.get("targetNamespace"))
    location = element.get("schemaLocation", "")
    ours = [each for each in found if each.root.get("targetNamespace") == namespace]
    if element.tag != _IMPORT:
        ours = [each for each in found if each.path.name == location.rpartition("/")[2]]
    versioned = [each for each in ours if f"v{each.root.get('version')}/" in location]
    chosen = versioned if len(versioned) == 1 else ours
    if len(chosen) != 1:
        names = f"one of {', '.join(each.path.name for each in ours)}" if ours else "its file"
        what = f"asks for {namespace} from {location or 'nowhere'}, and nothing is fetched from the network"
        raise schema.error(element, what, f"{names} in {folder}")
    return chosen[0]


def _explain(tree: LocatedTree, error: Any) -> CertificateError:
    """Return an error of ``xmlschema`` with the element, what is wrong, and what would be right."""
    if hasattr(error, "particle"):
        return _explain_children(tree, error)
    validator, reason = error.validator, clause_of(error.reason)
    expected = ""
    if patterns := getattr(validator, "regexps", None):
        expected = _OF_PATTERN.get(patterns[0], f"text of the pattern {patterns[0]}")
    elif getattr(validator, "enumeration", None):
        expected = f"one of {', '.join(map(str, validator.enumeration))}"
    elif getattr(validator, "local_name", None):
        expected = _OF_TYPE.get(validator.local_name, f"a value of the type {validator.local_name}")
    if reference := re.match(r"IDREF '(\S+)' not found", reason):
        element = next(each for each in tree.root.iter() if reference[1] in each.get("refId", "").split())
        return tree.error(element, f"refId '{reference[1]}'", "the id of an element")
    if not (expected and isinstance(error.obj, str)):
        return tree.error(error.elem, reason, "an element as the schema states it")
    attribute = re.match(r"attribute (\S+?)=", reason)
    return tree.error(error.elem, f"{f'attribute {attribute[1]} ' if attribute else ''}'{error.obj}'", expected)


def _explain_children(tree: LocatedTree, error: Any) -> CertificateError:
    """Return an error of a missing, misplaced, repeated or unknown element."""
    parent, child = error.elem, error.invalid_child
    wanted = [each.name for each in error.expected or () if each.name]
    names = " or ".join(map(short, wanted))
    if child is None:
        return tree.error(parent, "ends too early", f"{names} in it")
    allowed = [each.name for each in error.validator.iter_elements() if each.name]
    if child.tag not in allowed:
        return _explain_unknown(tree, child, parent, allowed)
    before, after = ([each.tag for each in part] for part in (parent[: error.index], parent[error.index + 1 :]))
    if child.tag in before and (child.tag == before[-1] or not wanted):
        return tree.error(child, f"is in {short(parent.tag)} again", "this element once")
    if moved := [each for each in wanted if each in after]:
        return tree.error(child, f"is before {short(moved[0])}", "the other order")
    if not wanted:
        return tree.error(child, f"is after {short(before[-1])}", "the other order")
    return tree.error(child, f"{names} is missing before it", f"{names} there")


def _explain_unknown(
    tree: LocatedTree, child: ET.Element, parent: ET.Element, allowed: Sequence[str]
) -> CertificateError:
    """Return an error of an element that may not be in its parent."""
    namespace, _, name = child.tag.rpartition("}")
    if alike := [each for each in allowed if each.rpartition("}")[2] == name]:
        right = alike[0][1:].rpartition("}")[0]
        return tree.error(child, f"is in the namespace '{namespace[1:]}'", f"the namespace '{right}'")
    known = list(map(short, allowed))
    expected = similar_name(short(child.tag), known, f"one of {', '.join(known)}")
    return tree.error(child, f"is unknown in {short(parent.tag)}", expected)
