"""The XML of an untrusted robot description: URDF or SRDF, from a file or from text."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from graceful_plan.exceptions import READ_ERRORS, SceneError, read_error_reason
from graceful_plan.regular_file import path_of, read_content

_MOST_BYTES = 10_000_000
_PREFIX = re.compile(r"(?:</?|\s)([A-Za-z_][\w.-]*):[\w.-]+(?=[\s=/>])")
_MOST_PREFIXES = 20


def parsed_robot(source: str | Path) -> tuple[ET.Element, Path | None]:
    """Parse the XML of a robot from a file or from text; return its root, and the folder of the file.

    Raises:
        SceneError: If it is broken or hostile.
    """
    text, folder = _text(source)
    return _parsed(text, source), folder


def _text(source: str | Path) -> tuple[str, Path | None]:
    if isinstance(source, str) and source.lstrip().startswith("<"):
        return source, None
    file = path_of(source)
    try:
        content = read_content(file, _MOST_BYTES)
    except READ_ERRORS as error:
        raise SceneError(read_error_reason(error), file=str(file)) from None
    try:
        return content.decode("utf-8"), file.resolve().parent
    except UnicodeDecodeError:
        raise SceneError("not UTF-8 text", file=str(file)) from None


def _parsed(text: str, source: str | Path) -> ET.Element:
    file = None if text is source else str(source)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise SceneError("document types and entities are not read", file=file)
    try:
        root = ET.fromstring(_with_prefixes(text))
    except ET.ParseError as error:
        raise SceneError(f"not XML: {error}", file=file, line=error.position[0]) from None
    except UnicodeEncodeError as error:
        raise SceneError(f"not valid UTF-8: {error.reason}", file=file) from None
    if root.tag != "robot":
        raise SceneError(f"a URDF has the root <robot>, not <{root.tag}>", file=file)
    if any("xacro" in element.tag for element in root.iter() if isinstance(element.tag, str)):
        raise SceneError("this is a xacro file; run xacro first, and give the URDF that it prints", file=file)
    for element in root.iter():
        for foreign in [name for name in element.attrib if name.startswith("{")]:
            del element.attrib[foreign]
    return root


def _with_prefixes(text: str) -> str:
    """Declare undeclared attribute prefixes of other programs, such as `drake:`; published files often lack them."""
    used = set(_PREFIX.findall(text)) - {"xml", "xmlns"}
    missing = [prefix for prefix in sorted(used)[:_MOST_PREFIXES] if f"xmlns:{prefix}" not in text]
    declared = "".join(f' xmlns:{prefix}="{prefix}"' for prefix in missing)
    return re.sub(r"<robot(?=[\s>])", f"<robot{declared}", text, count=1)
