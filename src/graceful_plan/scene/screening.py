"""Screen untrusted MJCF before MuJoCo compiles it; errors name file and line.

MuJoCo itself loads absolute and `..` includes, expands a billion replicas, and accepts NaN positions and negative
timesteps. The screen reads the XML with a streaming parser, so nothing is expanded meanwhile.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from graceful_plan.exceptions import READ_ERRORS, SceneError, read_error_reason
from graceful_plan.regular_file import read_content
from graceful_plan.scene.loading.weighing import MOST_OF_A_MESH, PIXELS, DecompressionError, asset_budget, check_png

MAX_BYTES = 10_000_000
MAX_ASSET_BYTES = 100_000_000
MAX_DEPTH = 200
MAX_ELEMENTS = 50_000
"""Largest number of elements after replication, over all included files."""
MAX_FILES = 64
MAX_COUNT = 4096
"""Largest value of an attribute that is a count."""
MAX_CONTACTS = 1_000_000
"""Largest value of `nconmax` and `njmax`, which are then left to MuJoCo: 5000, as in robosuite, would take 1.3 GB."""
MAX_EXTENT = 1e4
"""Largest coordinate or size [m]: the kernels' single precision resolves half a millimetre there."""
BUDGETS = {
    PIXELS: 4 * 4096**2,
    "cells of height fields": 4096**2,
    "numbers in <numeric> and <tuple>": 1_000_000,
    "user-defined numbers": 10_000_000,
    "vertices and faces of meshes": 2_000_000,
    "bytes of assets": MAX_ASSET_BYTES,
}
"""Limits per model, over all elements and files."""

_REFUSED = {
    "plugin": "plugins are not supported",
    "extension": "plugins are not supported",
    "flex": "flexible bodies are not supported",
    "flexcomp": "flexible bodies are not supported",
    "composite": "composite bodies are not supported",
    "skin": "skins are not supported",
}  # fmt: skip
_COUNTS = frozenset(
    "count dim nsample width height nrow ncol offwidth offheight shadowsize offsamples numslices numstacks numquads"
    " nstack nconmax njmax nkey actdim nuser_body nuser_jnt nuser_geom nuser_site nuser_cam nuser_tendon"
    " nuser_actuator nuser_sensor".split()
)
_WORDS = {"name", "class", "childclass", "model", "data"}
"""Attributes whose text may look like a number but is not one ("data" only where it is text)."""
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_BAD_NUMBER = re.compile(r"(?i)^[+-]?(nan|inf|infinity)(\(.*\))?$")


@dataclass
class Screen:
    """The screening of a model and its included files; `root` is the folder that must contain them."""

    root: Path | None
    up: bool = False
    """Whether absolute paths and ".." may lead from one folder below the root to another."""
    visuals: bool = True
    """Whether textures are kept; otherwise their files and sizes do not matter."""
    elements: int = 0
    users: int = 0
    """Number of user-defined values that each element may have."""
    files: int = 0
    reading: list[Path] = field(default_factory=list)
    places: set[Path] = field(default_factory=set)
    """Folders of the files read so far, where MuJoCo may look for others."""
    folders: set[str] = field(default_factory=lambda: {""})
    """Asset folders that the model declares, relative to one of `places`."""
    assets: list[_Asset] = field(default_factory=list)
    spent: dict[str, float] = field(default_factory=lambda: dict.fromkeys(BUDGETS, 0.0))
    asset_budget: set[Path] = field(default_factory=set)
    """Asset files that are already counted in `spent`."""

    @property
    def allowed(self) -> str:
        """Where files may be, for messages."""
        return f"below {str(self.root)!r}" if self.up else "in the folder of the scene"

    @property
    def relative(self) -> str:
        """How files may be named, for messages."""
        return "" if self.up else ", by relative path"

    @property
    def hint(self) -> str:
        """How to allow other files, for messages."""
        return "" if self.up or self.root is None else "; Scene.from_mjcf(..., folder=DIR) allows those below DIR"

    def spend(self, what: str, amount: int | float) -> str | None:
        """Count an amount against a budget; return a message if the budget is exceeded."""
        self.spent[what] += amount
        if self.spent[what] <= BUDGETS[what]:
            return None
        hint = "; Scene.from_mjcf(..., visuals=False) ignores textures" if what == PIXELS else ""
        return f"more than {BUDGETS[what]} {what} in all{hint}"

    def model(self, file: Path) -> None:
        """Screen a file, its includes and its assets."""
        self.file(file, 1)
        self.whole(str(file))

    def text(self, text: str) -> None:
        """Screen a model given as text, which therefore has no folder for other files."""
        try:
            content = text.encode()
        except UnicodeEncodeError as error:
            raise SceneError(f"not valid UTF-8: {error.reason}", file="<text>") from None
        _XmlReader(self, "<text>", 1).read(content)
        self.whole("<text>")

    def whole(self, name: str) -> None:
        """Screen totals and assets, once all elements are known."""
        if said := self.spend("user-defined numbers", self.users * self.elements):
            raise SceneError(f"with {self.users} for each of {self.elements} elements there are {said}", file=name)
        for asset in self.assets:
            self.asset(asset)

    def file(self, file: Path, replicas: int) -> None:
        """Screen a file that is included `replicas` times."""
        try:
            content = read_content(file, MAX_BYTES)
        except READ_ERRORS as error:
            raise SceneError(read_error_reason(error), file=str(file)) from None
        resolved = file.resolve()
        if resolved in self.reading:
            raise SceneError("includes itself", file=str(file))
        self.files += 1
        if self.files > MAX_FILES:
            raise SceneError(f"more than {MAX_FILES} files are included", file=str(file))
        self.places.add(resolved.parent)
        self.reading.append(resolved)
        _XmlReader(self, str(file), replicas).read(content)
        self.reading.pop()

    def found(self, given: str, folders: Iterable[str] = ("",)) -> list[Path] | None:
        """Return the files that a name may refer to; None if a candidate is outside the root folder."""
        if self.root is None or "\\" in given:
            return None
        found = []
        for place in sorted(self.places):
            for folder in folders:
                path = Path(folder) / given
                if (path.is_absolute() or ".." in path.parts) and not self.up:
                    return None
                resolved = (place / path).resolve()  # symbolic links may lead outside
                by_name = Path(os.path.normpath(place / path))  # the path without following links
                if not (resolved.is_relative_to(self.root) and by_name.is_relative_to(self.root)):
                    return None
                if resolved.exists() and not resolved.is_dir():  # includes pipes, refused when opened
                    found.append(resolved)
        return found

    def asset(self, asset: _Asset) -> None:
        """Screen the file of an asset. A missing file is left to MuJoCo, whose error lists where it looked."""
        found = self.found(asset.given, sorted(self.folders))
        if found is None:
            message = f"file {asset.given!r} of <{asset.tag}>: only files {self.allowed}{self.relative}{self.hint}"
            raise SceneError(message, file=asset.file, line=asset.line)
        for file in set(found) - self.asset_budget:
            self.asset_budget.add(file)
            try:
                content = read_content(file, MAX_ASSET_BYTES)
            except READ_ERRORS as error:
                raise SceneError(read_error_reason(error), file=str(file)) from None
            self.spend_on(asset, "bytes of assets", len(content))
            if amount := asset_budget(asset.tag, content, file.suffix):
                if asset.tag == "mesh" and amount[1] > MOST_OF_A_MESH:
                    said = f"{asset.given!r} has {amount[1]} vertices and faces; at most {MOST_OF_A_MESH} are read"
                    raise SceneError(said, file=asset.file, line=asset.line)
                self.spend_on(asset, *amount)
            try:
                check_png(file, content)
            except DecompressionError as error:
                raise SceneError(f"{error}", file=asset.file, line=asset.line) from None

    def spend_on(self, asset: _Asset, what: str, amount: int | float) -> None:
        """Count the size of an asset's file against a budget."""
        if said := self.spend(what, amount):
            raise SceneError(f"with {asset.given!r} there are {said}", file=asset.file, line=asset.line)


@dataclass(frozen=True)
class _Asset:
    """A file named by an asset, with the place in the MJCF."""

    tag: str
    given: str
    file: str
    line: int


class _XmlReader:
    """Screens one XML text."""

    def __init__(self, screen: Screen, name: str, replicas: int) -> None:
        self.screen, self.name = screen, name
        self.replicas = [replicas]
        self.parser = expat.ParserCreate("utf-8")  # as MuJoCo reads it, whatever the file declares
        self.parser.XmlDeclHandler = self.declaration
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.StartDoctypeDeclHandler = lambda *_: self.refuse("a document type declaration is not allowed")
        self.parser.ProcessingInstructionHandler = lambda *_: self.refuse("processing instructions are not allowed")

    def read(self, content: bytes) -> None:
        try:
            self.parser.Parse(content, True)
        except expat.ExpatError as error:
            reason = f"broken XML: {expat.ErrorString(error.code)}"
            raise SceneError(reason, file=self.name, line=error.lineno) from None

    def declaration(self, version: str, encoding: str | None, standalone: int) -> None:
        if encoding is not None and encoding.lower() not in ("utf-8", "utf8", "us-ascii"):
            self.refuse(f"the encoding {encoding[:40]!r} is not read, only UTF-8")

    def refuse(self, message: str) -> NoReturn:
        raise SceneError(message, file=self.name, line=self.parser.CurrentLineNumber)

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        depth = len(self.replicas)
        if depth == 1 and tag not in ("mujoco", "mujocoinclude"):
            self.refuse(f"the top element is <{tag}>, expected <mujoco>")
        if depth > MAX_DEPTH:
            self.refuse(f"nested deeper than {MAX_DEPTH} elements")
        if tag in _REFUSED:
            self.refuse(_REFUSED[tag])
        replicas = self.replicas[-1]
        if tag == "replicate":
            replicas *= max(1, self.count("count", attributes.get("count", "1")))
        self.replicas.append(replicas)
        self.screen.elements += replicas
        if self.screen.elements > MAX_ELEMENTS or replicas > MAX_ELEMENTS:
            self.refuse(f"more than {MAX_ELEMENTS} elements after replication")
        for key, value in attributes.items():
            self.attribute(tag, key, value)
        for what, amount in self.spends(tag, attributes):
            if said := self.screen.spend(what, amount):
                self.refuse(f"with this <{tag}> there are {said}")
        if tag == "include":
            given = attributes.get("file", "")
            self.embedded(f"include of {given!r}", given)

    def spends(self, tag: str, attributes: dict[str, str]) -> list[tuple[str, int | float]]:
        """Return the budgets that an element counts against, with amounts."""

        def number(key: str) -> int:
            return self.count(key, attributes.get(key, "0"))

        if tag == "texture" and not self.screen.visuals:
            return []
        if tag == "texture" and "builtin" in attributes:
            sides = 1 if attributes.get("type") == "2d" else 6
            return [(PIXELS, sides * number("width") * max(number("height"), number("width")))]
        if tag == "hfield":
            return [("cells of height fields", number("nrow") * number("ncol"))]
        if tag in ("numeric", "tuple"):
            return [("numbers in <numeric> and <tuple>", max(number("size"), len(attributes.get("data", "").split())))]
        if tag == "mesh":
            given = sum(len(attributes.get(key, "").split()) for key in ("vertex", "face"))
            return [("vertices and faces of meshes", given / 3)]
        if tag == "size":
            self.screen.users += sum(number(key) for key in attributes if key.startswith("nuser_"))
        return []

    def end(self, _tag: str) -> None:
        self.replicas.pop()

    def attribute(self, tag: str, key: str, value: str) -> None:
        if key in _COUNTS or (tag == "numeric" and key == "size"):
            self.count(key, value)
        elif key.startswith("file") and tag != "include":
            if tag != "texture" or self.screen.visuals:
                self.asset(tag, value)
        elif key in _FOLDERS:
            if self.screen.found(".", [value]) is None:
                self.refuse(f"{key}={value!r} is outside of the folder of the scene{self.screen.hint}")
            self.screen.folders.add(value)
        elif tag == "size" and key == "memory":
            self.refuse("the memory size cannot be set")
        elif tag == "mesh" and key == "builtin":
            self.refuse("built-in meshes are not supported; give a geom or vertices")
        elif tag == "option" and key == "timestep":
            self.timestep(value)
        if (key not in _WORDS or tag == "numeric") and any(_BAD_NUMBER.match(word) for word in value.split()):
            self.refuse(f"{key}={value!r} of <{tag}> is not finite")

    def asset(self, tag: str, given: str) -> None:
        if "://" in given:
            self.refuse(f"file {given!r} of <{tag}>: only files in the folder of the scene, no addresses")
        line = self.parser.CurrentLineNumber
        if tag == "model":
            self.embedded(f"file {given!r} of <model>", given)
        else:
            # Asset folders are known only at the end.
            self.screen.assets.append(_Asset(tag, given, self.name, line))

    def timestep(self, value: str) -> None:
        try:
            timestep = float(value)
        except ValueError:
            return  # MuJoCo's own error is better
        if not timestep > 0.0:
            self.refuse(f"the timestep is {value}, it has to be above 0")

    def count(self, key: str, value: str) -> int:
        largest = 0
        for word in value.split():
            try:
                number = float(word)
            except ValueError:
                continue  # MuJoCo's own error is better
            most = MAX_CONTACTS if key in ("nconmax", "njmax") else MAX_COUNT
            if math.isfinite(number) and number <= most:
                largest = max(largest, int(number))
            else:
                self.refuse(f"{key}={value!r} is more than {most}")
        return largest

    def embedded(self, what: str, given: str) -> None:
        if "://" in given:
            self.refuse(f"{what}: only files in the folder of the scene, no addresses")
        found = self.screen.found(given)
        if found is None:
            self.refuse(f"{what}: only files {self.screen.allowed}{self.screen.relative}{self.screen.hint}")
        if not found:
            self.refuse(f"{what}: there is no such file")
        for file in found:
            self.screen.file(file, self.replicas[-1])
