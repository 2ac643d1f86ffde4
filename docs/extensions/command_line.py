"""The directive `command-line`: the help text of every command, as printed by the program."""

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from typer.main import get_command

from hitchid.cli import app as program

COLUMNS = 90


def help_texts() -> dict[str, str]:
    """Return each command and its help text, the program's own under its own name."""
    group = get_command(program)
    commands = {program.info.name: group}
    for name, command in group.commands.items():
        commands[f"{program.info.name} {name}"] = command
        for inner, subcommand in getattr(command, "commands", {}).items():
            commands[f"{program.info.name} {name} {inner}"] = subcommand
    return {
        name: command.get_help(command.make_context(name, [], resilient_parsing=True, terminal_width=COLUMNS))
        for name, command in commands.items()
    }


class CommandLine(SphinxDirective):
    """One section a command."""

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        sections = []
        for name, text in help_texts().items():
            section = nodes.section(ids=[nodes.make_id(name)], names=[nodes.fully_normalize_name(name)])
            section += nodes.title(text=name)
            section += nodes.literal_block(text=text, language="text")
            self.state.document.note_explicit_target(section)
            sections.append(section)
        return sections


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("command-line", CommandLine)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
