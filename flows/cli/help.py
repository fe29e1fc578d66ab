"""Help of command groups on one screen, and usage errors in one sentence."""

from __future__ import annotations

import re
from typing import Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from slgaussian.errors import did_you_mean


class Group(TyperGroup):
    """A group that lists its commands under their headings."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Show the help if no command is given."""
        if not args and not ctx.resilient_parsing:
            typer.echo(ctx.get_help(), err=True)
            ctx.exit(2)
        return super().parse_args(ctx, args)

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


def usage_sentence(error: TyperException) -> str:
    """Return a usage error as one sentence that refers to the help of the command."""
    sentence = error.format_message().removesuffix(".")
    context: Any = getattr(error, "ctx", None)
    if hasattr(error, "possibilities"):
        names = [name for param in context.command.get_params(context) for name in param.opts]
        option = error.option_name  # type: ignore[attr-defined]  # errors with possibilities do
        sentence = f"no such option {option}{did_you_mean(option, names)}"
        field = option.removeprefix("--").replace("-", "_")
        model = getattr(context.command.callback, "settings_model", None)
        if model and field in model.model_fields:
            sentence = f"no such option {option}; give the setting as --set {field}=VALUE"
        elif model and option.startswith("--") and "did you mean" not in sentence:
            sentence += "; rare settings are given with --set KEY=VALUE"
    sentence = sentence.replace(". Did you mean", "; did you mean")
    sentence = re.sub(r"^\w|: [A-Z]", lambda begin: begin[0].lower(), sentence)
    return sentence if context is None else f"{sentence} (see `{context.command_path} --help`)"
