"""A Sphinx extension: the directive `commands` writes out every sub-command of `hsed` from its parser."""

import argparse
from collections.abc import Iterator

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from hsed_jax.command_line import command_line


class Commands(SphinxDirective):
    """A section for each sub-command: its purpose, its usage, its arguments and options."""

    def run(self) -> list[nodes.Node]:
        """The sections."""
        return self.parse_text_to_nodes("\n".join(text_of(command_line())), allow_section_headings=True)


def text_of(parser: argparse.ArgumentParser) -> Iterator[str]:
    """The lines of the sections, in Markdown."""
    for name, command in sub_commands(parser).items():
        yield f"## hsed {name}\n"
        yield f"{command.description}\n"
        # Colours and the width of a terminal have no place here.
        formatter = argparse.HelpFormatter(command.prog, width=80)
        formatter.add_usage(command.usage, command._actions, command._mutually_exclusive_groups, prefix="")
        yield f"```text\n{formatter.format_help().strip()}\n```\n"
        for action in command._actions:
            if not isinstance(action, argparse._HelpAction):
                yield f"{_named(action)}\n: {_explained(action)}\n"


def sub_commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The parsers of the sub-commands, by name."""
    found: dict[str, argparse.ArgumentParser] = {}
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            found |= action.choices
    return found


def _named(action: argparse.Action) -> str:
    name = str(action.metavar or action.dest)
    if not action.option_strings:
        return f"`{name}`"
    return ", ".join(f"`{flag}`" if action.nargs == 0 else f"`{flag} {name}`" for flag in action.option_strings)


def _explained(action: argparse.Action) -> str:
    text = action.help or {"study": "the study"}.get(action.dest, action.dest)
    # `<study>` is a word to fill in, and no HTML.
    return f"{text[0].upper()}{text[1:]}.".replace("<", r"\<")


def setup(app: Sphinx) -> dict[str, bool]:
    """Make the directive known."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
