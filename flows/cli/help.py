"""Help of command groups on one screen."""

from __future__ import annotations

from typing import Any

from typer.core import TyperGroup


class Group(TyperGroup):
    """A group that lists its commands under their headings."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the complete first sentence of each command."""
        width = max(map(len, self.commands))
        formatter.write_paragraph()
        rows: dict[str, list[tuple[str, str]]] = {}
        all_commands: Any = self.commands.values()  # only Typer's commands have a heading
        for command in all_commands:
            row = command.name.ljust(width), command.get_short_help_str(1000)
            rows.setdefault(command.rich_help_panel or "Commands", []).append(row)
        for heading, lines in rows.items():
            formatter.write_heading(heading)
            with formatter.indentation():
                formatter.write_dl(lines)
