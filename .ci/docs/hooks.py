"""Hooks of mkdocs: pages from files outside docs/, their links, and formulas as MathML."""

from __future__ import annotations

import html
import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
PAGES = {
    "README.md": "readme.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "benchmarks/README.md": "benchmarks.md",
    "benchmarks/results/README.md": "results/index.md",
    **{
        f"benchmarks/results/{file.name}": f"results/{file.name}"
        for file in sorted((ROOT / "benchmarks" / "results").glob("[!R]*.md"))
    },
}
"""Pages of the site that are made from other files of the repository."""
EXAMPLES = "examples.md"
_LINK = re.compile(r"(?<=\]\()([^)#\s]+)(#[^)\s]*)?(?=\))")
_LIST = re.compile(r"^(\w.*)\n(?=- )", flags=re.MULTILINE)
_CODE = re.compile(r"^( *)(```|~~~).*?^\1\2 *$|`[^`\n]+`", flags=re.MULTILINE | re.DOTALL)
_BLOCKS = r'<div class="arithmatex">\\\[(.*?)\\\]</div>', r"<p>\.\. math:: (.*?)</p>"
_INLINE = r'<span class="arithmatex">\\\((.*?)\\\)</span>', r":math:<code>(.*?)</code>"
"""Formulas in guides and in docstrings."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    texts = {file: spaced((ROOT / file).read_text(encoding="utf-8")) for file in PAGES}
    made = {page: linked(texts[file], Path(file).parent) for file, page in PAGES.items()}
    made[EXAMPLES] = examples()
    for page, text in made.items():
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links that leave docs/ into links to generated pages."""
    if page.file.generated_by is not None:
        return markdown
    return linked(markdown, Path("docs") / Path(page.file.src_uri).parent)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn formulas into MathML, which browsers render without a script."""
    for display, patterns in (("block", _BLOCKS), ("inline", _INLINE)):
        for pattern in patterns:
            html = re.sub(pattern, lambda found, kind=display: formula(found[1], kind), html, flags=re.DOTALL)
    return html


def formula(text: str, display: str) -> str:
    """Convert a formula, escaped as HTML, to MathML."""
    return convert(html.unescape(text).strip(), display=display)


def linked(text: str, folder: Path) -> str:
    """Replace links to files of the repository by links to pages, except in code."""
    pieces, last = [], 0
    for code in _CODE.finditer(text):
        pieces += [_LINK.sub(lambda link: target(link, folder), text[last : code.start()]), code[0]]
        last = code.end()
    return "".join([*pieces, _LINK.sub(lambda link: target(link, folder), text[last:])])


def spaced(text: str) -> str:
    """Insert a blank line before each list that follows a paragraph; mkdocs needs it, code hosts do not."""
    return _LIST.sub(r"\1\n\n", text)


def target(link: re.Match[str], folder: Path) -> str:
    """Return the target on the site of a link on a page in a folder of the repository."""
    name, anchor = link[1], link[2] or ""
    if ":" in name:
        return link[0]
    file = (ROOT / folder / name).resolve()
    if not file.is_relative_to(ROOT):
        return link[0]
    place = file.relative_to(ROOT).as_posix()
    if place in PAGES:
        return upwards(folder) + PAGES[place] + anchor
    if place.startswith("examples/"):
        return f"{upwards(folder)}{EXAMPLES}#{place.removeprefix('examples/').replace('/', '').replace('.', '')}"
    return upwards(folder) + place.removeprefix("docs/") + anchor if place.startswith("docs/") else link[0]


def upwards(folder: Path) -> str:
    """Return the relative path from a page to the root of the site."""
    if folder == Path("benchmarks/results"):
        return "../"
    return "../" * (len(folder.parts) - 1) if folder.parts[:1] == ("docs",) else ""


def examples() -> str:
    """Return the page with all examples."""
    parts = ["# Examples", "Complete programs, run by the tests."]
    for file in sorted((ROOT / "examples").rglob("*.py")):
        name = file.relative_to(ROOT / "examples").as_posix()
        parts += [f"## {name}", f"```python\n{file.read_text(encoding='utf-8')}```"]
    return "\n\n".join(parts) + "\n"
