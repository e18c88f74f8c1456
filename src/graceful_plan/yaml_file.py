"""Read untrusted YAML: no anchors, no tags, bounded size and depth.

Values keep their text and line until they are converted to a type, so that every error names file and line.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, TypeVar, final

import yaml

from graceful_plan.exceptions import READ_ERRORS, SceneError, names_file, read_error_reason
from graceful_plan.regular_file import path_of, read_content

MAX_BYTES = 1_000_000
MAX_DEPTH = 16
MAX_VALUES = 100_000

LOADER: type = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""Uses libyaml if PyYAML was built with it, and then reads ten times as fast."""
_DIRECTIVE = re.compile(r"^%(?!YAML )[^\n]{0,40}", re.MULTILINE)
_STRING = "tag:yaml.org,2002:str"
_PLAIN_TAGS = {f"tag:yaml.org,2002:{kind}" for kind in "str int float bool null map seq timestamp".split()}


@final
@dataclass(frozen=True)
class Block:
    """A value in a YAML file: a mapping, a list or the text of a scalar, with its file and line."""

    file: str
    line: int
    name: str
    """Name of the value in messages, e.g. "entities.mug"."""
    value: dict[str, Block] | list[Block] | str
    tag: str

    def error(self, message: str) -> SceneError:
        """Return an error with the file and line of this value."""
        return SceneError(message, file=self.file, line=self.line)

    # --- mappings -----------------------------------------------------------------------------------------------------

    def only(self, *keys: str) -> None:
        """Raise SceneError if a mapping has other keys than these."""
        for key, child in self.items():
            if key not in keys:
                raise child.error(f"unknown key {key!r} in {self.name}; valid: {', '.join(keys)}")

    def items(self) -> Iterator[tuple[str, Block]]:
        """Iterate over a mapping."""
        if not isinstance(self.value, dict):
            raise self.error(f"{self.name} has to be a mapping")
        return iter(self.value.items())

    def get(self, key: str) -> Block | None:
        """Return the value of a key in a mapping; None if it is absent or null."""
        child = dict(self.items()).get(key)
        return None if child is None or child.is_null else child

    def __getitem__(self, key: str) -> Block:
        child = self.get(key)
        if child is None:
            raise self.error(f"{self.name} needs the key {key!r}")
        return child

    def check_version(self, kind: str) -> None:
        """Refuse unknown versions; `kind` is the kind of file in messages."""
        if self["version"].number() != 1:
            raise self["version"].error(f"only version 1 of {kind} is known")

    def numbers_by_name(self, *names: str) -> dict[str, float]:
        """Return a mapping that has exactly these names as keys and finite numbers as values."""
        self.only(*names)
        return {name: self[name].number() for name in names}

    # --- lists and scalars --------------------------------------------------------------------------------------------

    @property
    def is_mapping(self) -> bool:
        """Whether this is a mapping."""
        return isinstance(self.value, dict)

    @property
    def is_list(self) -> bool:
        """Whether this is a list."""
        return isinstance(self.value, list)

    @property
    def is_null(self) -> bool:
        """Whether the value is null or empty."""
        return self.tag.endswith(":null")

    @property
    def is_string(self) -> bool:
        """Whether this is text and not a number, also not one such as 1e-3, which YAML 1.1 reads as text."""
        return isinstance(self.value, str) and self.tag == _STRING and not self._looks_like_a_number

    @property
    def _looks_like_a_number(self) -> bool:
        return isinstance(self.value, str) and _number(self.value) is not None

    def entries(self) -> list[Block]:
        """Return the values of a list."""
        if not isinstance(self.value, list):
            raise self.error(f"{self.name} has to be a list")
        return self.value

    def string(self) -> str:
        """Return the value as text."""
        if not isinstance(self.value, str) or self.tag != _STRING:
            raise self.error(f"{self.name} has to be text")
        return self.value

    def strings(self) -> tuple[str, ...]:
        """Return the values of a list of texts."""
        return tuple(child.string() for child in self.entries())

    def flag(self) -> bool:
        """Return the value of a boolean."""
        if self.value not in ("true", "false"):
            raise self.error(f"{self.name} has to be true or false")
        return self.value == "true"

    def number(self) -> float:
        """Return the value as a finite number."""
        number = _number(self.value) if isinstance(self.value, str) else None
        if number is None:
            raise self.error(f"{self.name} has to be a number")
        if not math.isfinite(number):
            raise self.error(f"{self.name} is not finite")
        return number

    def numbers(self, count: int | None = None) -> tuple[float, ...]:
        """Return the values of a list of finite numbers; refuse a length other than `count`, if that is given."""
        children = self.entries()
        if count is not None and len(children) != count:
            raise self.error(f"{self.name} has {len(children)} numbers, expected {count}")
        return tuple(child.number() for child in children)


T = TypeVar("T", bound="YamlTable")


class YamlTable(ABC):
    """Base class of tables and constants that the library ships as YAML files; users may load their own versions."""

    shipped_file: ClassVar[Path]
    kind: ClassVar[str]
    """Kind of file in messages."""
    keys: ClassVar[tuple[str, ...]]
    """Keys of such a file, without "version"."""

    @classmethod
    def shipped(cls: type[T]) -> T:
        """Return the table that the library ships."""
        found = _shipped.get(cls)
        if not isinstance(found, cls):
            found = _shipped[cls] = cls.load(cls.shipped_file)
        return found

    @classmethod
    @names_file
    def load(cls: type[T], file: str | Path) -> T:
        """Read a YAML file with the same layout as the shipped one.

        Raises:
            SceneError: If the file is malformed; it names the line.
            SettingError: If a value is out of its range.
        """
        root = read_yaml(path_of(file))
        root.only("version", *cls.keys)
        root.check_version(cls.kind)
        return cls.parsed(root)

    @classmethod
    @abstractmethod
    def parsed(cls: type[T], root: Block) -> T:
        """Build the table from the parsed file."""


_shipped: dict[type, object] = {}


def read_yaml(file: Path) -> Block:
    """Read a YAML file whose top level is a mapping.

    Raises:
        SceneError: If the file cannot be read, is too large or too deep, or uses anchors, aliases or tags.
    """
    try:
        content = read_content(file, MAX_BYTES)
    except READ_ERRORS as error:
        raise SceneError(read_error_reason(error), file=str(file)) from None
    try:
        return parse_yaml(content.decode("utf-8"), str(file))
    except UnicodeDecodeError as error:
        raise SceneError(f"is not UTF-8: {error.reason}", file=str(file)) from None


def parse_yaml(text: str, file: str) -> Block:
    """Parse YAML text; `file` is its name in messages."""
    try:
        _screen(text, file)
        root = yaml.compose(text, Loader=LOADER)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else None
        raise SceneError(f"broken YAML: {error.problem or error.context}", file=file, line=line) from None
    except yaml.YAMLError as error:
        raise SceneError(f"broken YAML: {' '.join(str(error).split())}", file=file) from None
    if not isinstance(root, yaml.MappingNode):
        raise SceneError("has to be a mapping at its top level", file=file, line=1)
    return _block(root, file, Path(file).name, root.start_mark.line + 1)


def check_directives(text: str) -> str | None:
    """Return why a text is refused before it is parsed; None if it is not.

    Names of tags take libyaml quadratic time: a megabyte of them 10 s.
    """
    found = _DIRECTIVE.search(text)
    return None if found is None else f"the directive {found[0]!r} is not read"


def _screen(text: str, file: str) -> None:
    """Refuse anchors, deep nesting and too many values on the event stream, before a tree is built in memory."""
    if (problem := check_directives(text)) is not None:
        raise SceneError(problem, file=file)
    depth = count = 0
    for event in yaml.parse(text, Loader=LOADER):
        line = event.start_mark.line + 1
        if getattr(event, "anchor", None) is not None:
            raise SceneError("anchors and aliases are not allowed", file=file, line=line)
        count += 1
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise SceneError(f"nested deeper than {MAX_DEPTH} levels", file=file, line=line)
        if count > MAX_VALUES:
            raise SceneError(f"more than {MAX_VALUES} values", file=file, line=line)


def _block(node: yaml.Node, file: str, name: str, line: int) -> Block:
    if node.tag not in _PLAIN_TAGS:
        raise SceneError(f"the tag {node.tag} is not allowed", file=file, line=line)
    value: dict[str, Block] | list[Block] | str
    if isinstance(node, yaml.MappingNode):
        value = {}
        for key, child in node.value:
            key_line = key.start_mark.line + 1
            if key.tag != _STRING:
                raise SceneError(f"a key of {name} is not text; put it in quotes", file=file, line=key_line)
            if key.value in value:
                raise SceneError(f"the key {key.value!r} of {name} appears twice", file=file, line=key_line)
            value[key.value] = _block(child, file, f"{name}.{key.value}", key_line)
    elif isinstance(node, yaml.SequenceNode):
        value = [_block(child, file, f"{name}[{i}]", child.start_mark.line + 1) for i, child in enumerate(node.value)]
    else:
        value = node.value
    return Block(file, line, name, value, node.tag)


def _number(text: str) -> float | None:
    try:
        return float(text.replace(".inf", "inf").replace(".nan", "nan").replace(".Inf", "inf").replace(".NaN", "nan"))
    except ValueError:
        return None
