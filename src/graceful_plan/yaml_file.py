"""Read YAML from strangers: no anchors, no tags, bounded size and depth, every value knows its line.

Values keep their text until somebody asks for a type, so that every complaint can name file and line.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, TypeVar, final

import yaml

from graceful_plan.exceptions import NOT_READ, SceneError, why_not_read
from graceful_plan.regular_file import path_of, read_content

MAX_BYTES = 1_000_000
MAX_DEPTH = 16
MAX_VALUES = 100_000

# libyaml reads ten times as fast where PyYAML was built with it.
_Loader: type = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_STRING = "tag:yaml.org,2002:str"
_PLAIN_TAGS = {f"tag:yaml.org,2002:{kind}" for kind in "str int float bool null map seq timestamp".split()}


@final
@dataclass(frozen=True)
class Block:
    """A value in a YAML file: a mapping, a list or a scalar's text, and where it stands."""

    file: str
    line: int
    name: str
    """What it is called in messages, e.g. "entities.mug"."""
    value: dict[str, Block] | list[Block] | str
    tag: str

    def error(self, message: str) -> SceneError:
        """Return the error that complains about this value."""
        return SceneError(message, file=self.file, line=self.line)

    # --- mappings -----------------------------------------------------------------------------------------------------

    def only(self, *keys: str) -> None:
        """Refuse keys other than these."""
        for key, child in self.items():
            if key not in keys:
                raise child.error(f"unknown key {key!r} in {self.name}; valid: {', '.join(keys)}")

    def items(self) -> Iterator[tuple[str, Block]]:
        """Iterate over a mapping."""
        if not isinstance(self.value, dict):
            raise self.error(f"{self.name} has to be a mapping")
        return iter(self.value.items())

    def get(self, key: str) -> Block | None:
        """Return a value of a mapping; None if it is absent or null."""
        child = dict(self.items()).get(key)
        return None if child is None or child.is_null else child

    def __getitem__(self, key: str) -> Block:
        child = self.get(key)
        if child is None:
            raise self.error(f"{self.name} needs the key {key!r}")
        return child

    def check_version(self, kind: str) -> None:
        """Refuse versions of a kind of file that are not known."""
        if self["version"].number() != 1:
            raise self["version"].error(f"only version 1 of {kind} is known")

    def numbers_by_name(self, *names: str) -> dict[str, float]:
        """Return a mapping of just these names to finite numbers."""
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
        """Whether nothing was given."""
        return self.tag.endswith(":null")

    @property
    def is_string(self) -> bool:
        """Whether this is text that YAML does not read as something else."""
        return isinstance(self.value, str) and self.tag == _STRING and not self._looks_like_a_number

    @property
    def _looks_like_a_number(self) -> bool:
        # YAML 1.1 takes 1e-3 for text.
        return isinstance(self.value, str) and _number(self.value) is not None

    def entries(self) -> list[Block]:
        """Return the values of a list."""
        if not isinstance(self.value, list):
            raise self.error(f"{self.name} has to be a list")
        return self.value

    def string(self) -> str:
        """Return text."""
        if not isinstance(self.value, str) or self.tag != _STRING:
            raise self.error(f"{self.name} has to be text")
        return self.value

    def strings(self) -> tuple[str, ...]:
        """Return a list of texts."""
        return tuple(child.string() for child in self.entries())

    def flag(self) -> bool:
        """Return whether it is true."""
        if self.value not in ("true", "false"):
            raise self.error(f"{self.name} has to be true or false")
        return self.value == "true"

    def number(self) -> float:
        """Return a finite number."""
        number = _number(self.value) if isinstance(self.value, str) else None
        if number is None:
            raise self.error(f"{self.name} has to be a number")
        if not math.isfinite(number):
            raise self.error(f"{self.name} is not finite")
        return number

    def numbers(self, count: int | None = None) -> tuple[float, ...]:
        """Return a list of finite numbers, `count` of them if that is given."""
        children = self.entries()
        if count is not None and len(children) != count:
            raise self.error(f"{self.name} has {len(children)} numbers, expected {count}")
        return tuple(child.number() for child in children)


T = TypeVar("T", bound="YamlTable")


class YamlTable(ABC):
    """Base of tables and constants that come with the library in a YAML file, and may be read from one like it."""

    shipped_file: ClassVar[Path]
    kind: ClassVar[str]
    """What such files are called in messages."""
    keys: ClassVar[tuple[str, ...]]
    """What they hold besides "version"."""

    @classmethod
    def shipped(cls: type[T]) -> T:
        """Return what comes with the library."""
        found = _shipped.get(cls)
        if not isinstance(found, cls):
            found = _shipped[cls] = cls.load(cls.shipped_file)
        return found

    @classmethod
    def load(cls: type[T], file: str | Path) -> T:
        """Read a YAML file laid out like the shipped one.

        Raises:
            SceneError: If the file is broken, with the line.
            SettingError: If a value is out of its range.
        """
        root = read_yaml(path_of(file))
        root.only("version", *cls.keys)
        root.check_version(cls.kind)
        return cls.parsed(root)

    @classmethod
    @abstractmethod
    def parsed(cls: type[T], root: Block) -> T:
        """Make it of the values in a file."""


_shipped: dict[type, object] = {}


def read_yaml(file: Path) -> Block:
    """Read a YAML file whose top is a mapping.

    Raises:
        SceneError: If it cannot be read, is too large or too deep, or uses anchors, aliases or tags.
    """
    try:
        content = read_content(file, MAX_BYTES)
    except NOT_READ as error:
        raise SceneError(why_not_read(error), file=str(file)) from None
    try:
        return parse_yaml(content.decode("utf-8"), str(file))
    except UnicodeDecodeError as error:
        raise SceneError(f"is not UTF-8: {error.reason}", file=str(file)) from None


def parse_yaml(text: str, file: str) -> Block:
    """Parse YAML text; `file` is its name in messages."""
    try:
        _screen(text, file)
        root = yaml.compose(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else None
        raise SceneError(f"broken YAML: {error.problem or error.context}", file=file, line=line) from None
    except yaml.YAMLError as error:
        raise SceneError(f"broken YAML: {' '.join(str(error).split())}", file=file) from None
    if not isinstance(root, yaml.MappingNode):
        raise SceneError("has to be a mapping at its top", file=file, line=1)
    return _block(root, file, Path(file).name, root.start_mark.line + 1)


def _screen(text: str, file: str) -> None:
    """Refuse what could explode, on the flat stream of events, before a tree is built."""
    depth = count = 0
    for event in yaml.parse(text, Loader=_Loader):
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
                raise SceneError(f"the key {key.value!r} of {name} stands twice", file=file, line=key_line)
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
