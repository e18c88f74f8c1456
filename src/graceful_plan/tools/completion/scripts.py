"""Static completion scripts for shells, generated from a parser."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from graceful_plan.tools.parsing import Parser


class Argument(NamedTuple):
    """An argument for a completion script."""

    names: tuple[str, ...]
    """Names of an option; empty for a positional argument."""
    text: str
    takes_value: bool
    words: tuple[str, ...]
    """Completions of the value."""
    files: bool
    """Whether to complete file names, too."""


class Offer(NamedTuple):
    """Completions of the value of an argument."""

    words: tuple[str, ...]
    files: bool = False


Values = Mapping[str, Offer]
"""Completions by name of the argument, such as {"scene": ...}, in addition to the choices in the parser."""


def arguments(parser: Parser, values: Values) -> list[Argument]:
    """List the arguments of a command."""
    return [_argument(action, values) for action in parser.arguments if action.help != argparse.SUPPRESS]


def _argument(action: argparse.Action, values: Values) -> Argument:
    known = values.get(action.dest, Offer(tuple(action.choices or ()), action.type is Path))
    text = (action.help or "").replace("%%", "%").partition(";")[0].partition(" (default")[0]
    return Argument(tuple(action.option_strings), text, action.nargs != 0, known.words, known.files)


def bash(parser: Parser, values: Values) -> str:
    """Return a script for bash."""
    function = f"_{parser.prog.replace('-', '_')}"
    lines = [
        f"{function}() {{",
        '    local current="${COMP_WORDS[COMP_CWORD]}" words="" files="" last="" i',
        "    # The option of the word: the last one before it.",
        "    for ((i = COMP_CWORD - 1; i > 1; i--)); do",
        '        if [[ "${COMP_WORDS[i]}" == -* ]]; then last="${COMP_WORDS[i]}"; break; fi',
        "    done",
        "    if ((COMP_CWORD == 1)); then",
        f"        words={shlex.quote(' '.join([*parser.commands, *_names(arguments(parser, values))]))}",
        '    elif [[ "$current" == -* ]]; then',
        '        case "${COMP_WORDS[1]}" in',
        *(
            f"            {name}) words={shlex.quote(' '.join(_names(arguments(command, values))))} ;;"
            for name, command in parser.commands.items()
        ),
        "        esac",
        "    else",
        '        case "${COMP_WORDS[1]} $last" in',
        *(f"            {line}" for line in _bash_values(parser, values)),
        "        esac",
        "    fi",
        '    COMPREPLY=($(compgen -W "$words" -- "$current"))',
        '    if [[ -n "$files" ]]; then COMPREPLY+=($(compgen -f -- "$current")); fi',
        "}",
        f"complete -o filenames -F {function} {parser.prog}",
    ]
    return "\n".join(lines) + "\n"


def _names(found: Sequence[Argument]) -> list[str]:
    return [name for argument in found for name in argument.names if name.startswith("--")]


def _bash_values(parser: Parser, values: Values) -> Iterator[str]:
    for name, command in parser.commands.items():
        for argument in arguments(command, values):
            if not argument.takes_value or not (argument.words or argument.files):
                continue
            patterns = [f'"{name} {option}"' for option in argument.names] or [f'"{name} "']
            files = "1" if argument.files else '""'
            yield f"{'|'.join(patterns)}) words={shlex.quote(' '.join(argument.words))} files={files} ;;"


def zsh(parser: Parser, values: Values) -> str:
    """Return a script for zsh."""
    function = f"_{parser.prog.replace('-', '_')}"
    commands = [f"{name}:{_plain(command.description or '')}" for name, command in parser.commands.items()]
    lines = [f"#compdef {parser.prog}"]
    for words in dict.fromkeys(offer.words for offer in values.values() if offer.files and offer.words):
        lines.append(f'{_zsh_function(words)}() {{ compadd "$@" -- {" ".join(words)}; _files "$@"; }}')
    lines += [f"{function}() {{", "    local -a commands", "    commands=("]
    lines += [f"        {shlex.quote(line)}" for line in commands]
    lines += ["    )", "    if ((CURRENT == 2)); then", "        _describe command commands", "        return"]
    lines += ["    fi", "    local chosen=$words[2]", "    shift words; ((CURRENT--))", "    case $chosen in"]
    for name, command in parser.commands.items():
        specs = " ".join(shlex.quote(spec) for a in arguments(command, values) for spec in _zsh_specs(a))
        lines.append(f"        {name}) _arguments {specs} ;;")
    # The script may be sourced, or found by compinit and run.
    lines += ["    esac", "}", f'if [[ "${{funcstack[1]}}" == "{function}" ]]; then {function} "$@"; fi']
    lines += [f"if (($+functions[compdef])); then compdef {function} {parser.prog}; fi"]
    return "\n".join(lines) + "\n"


def _zsh_function(words: Sequence[str]) -> str:
    """Return the name of the function that completes words and files; the first word makes it unique."""
    return f"_graceful_plan_{words[0]}_or_file"


def _zsh_specs(argument: Argument) -> Iterator[str]:
    text = _plain(argument.text)
    offers = f"({' '.join(argument.words)})" if argument.words and not argument.files else ""
    if argument.files:
        offers = _zsh_function(argument.words) if argument.words else "_files"
    value = f":value:{offers}" if argument.takes_value else ""
    for name in argument.names:
        yield f"*{name}[{text}]{value}"
    if not argument.names:
        yield f"*:{text}:{offers}"


def fish(parser: Parser, values: Values) -> str:
    """Return a script for fish."""
    lines = [f"complete -c {parser.prog} -f"]
    for name, command in parser.commands.items():
        text = _plain(command.description or "")
        lines.append(f"complete -c {parser.prog} -n __fish_use_subcommand -a {name} -d '{text}'")
        for argument in arguments(command, values):
            lines += [f"complete -c {parser.prog} -n '__fish_seen_subcommand_from {name}' {_fish(argument)}"]
    return "\n".join(lines) + "\n"


def _fish(argument: Argument) -> str:
    flags = [f"-l {name[2:]}" if name.startswith("--") else f"-s {name[1:]}" for name in argument.names]
    offers = [f"-a '{' '.join(argument.words)}'"] if argument.words else []
    value = [("-r -F" if argument.files else "-x") if flags else ("-F" if argument.files else "")]
    parts = [*flags, *(value if argument.takes_value else []), *offers, f"-d '{_plain(argument.text)}'"]
    return " ".join(part for part in parts if part)


def _plain(text: str) -> str:
    """Return a text without characters that are special to shells."""
    return " ".join("".join(c for c in text if c not in "'\"`$\\[]():{}").split())


SHELLS: Mapping[str, Callable[[Parser, Values], str]] = {"bash": bash, "zsh": zsh, "fish": fish}
