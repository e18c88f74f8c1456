"""Compare two versions of a source file without comments, docstrings and formatting."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import PurePath

PYTHON, CPP = (".py", ".pyi"), (".cpp", ".hpp")
_CPP = re.compile(
    r'(?P<kept>"(?:\\.|[^"\\\n])*"|(?<!\w)\'(?:\\.|[^\'\\\n])+\')|//[^\n]*|/\*.*?\*/',  # strings keep their slashes
    flags=re.DOTALL,
)
_DIRECTIVE = re.compile(r"^[ \t]*#(?:.*\\\n)*.*$", flags=re.MULTILINE)  # a line whose end has a meaning


def same_code(name: str, old: str, new: str) -> bool:
    """Whether two versions of a file differ at most in comments, docstrings and formatting; see `is_compared`."""
    try:
        return code_of(PurePath(name).suffix, old) == code_of(PurePath(name).suffix, new)
    except SyntaxError:
        return False


def is_compared(name: str) -> bool:
    """Whether a file is in a language that `same_code` knows; changes of other files always count."""
    return PurePath(name).suffix in PYTHON + CPP


@cache
def code_of(suffix: str, text: str) -> str:
    """Return the code of a file without comments, docstrings and formatting."""
    if suffix in CPP:
        bare = _CPP.sub(lambda found: found["kept"] or " ", text)
        return " ".join(_DIRECTIVE.sub(r"\g<0> <end of line>", bare).split())
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            node.body = [line for line in body if not _is_text(line)]  # type: ignore[attr-defined]
    return ast.dump(tree)


def _is_text(line: ast.AST) -> bool:
    """Whether a statement is a string on its own: a docstring, or the documentation of a field."""
    return isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant) and isinstance(line.value.value, str)
