"""Help with what people need first, and the rest under headings."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable
from itertools import groupby
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException
from typer.main import get_command_from_info
from typer.models import CommandInfo

from flows.cli.options import LATER
from slgaussian.errors import did_you_mean

SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
"""Settings of the context of every command."""


class App(typer.Typer):
    """A Typer whose commands and groups are those of this module."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(
            cls=Group,
            context_settings=SETTINGS,
            no_args_is_help=True,
            pretty_exceptions_enable=False,
            rich_markup_mode=None,
            **settings,
        )

    def command(  # type: ignore[override]  # it takes what Typer's takes
        self, *args: Any, **settings: Any
    ) -> Callable[[Callable], Callable]:
        """As of Typer; ``rich_help_panel`` is the heading under which a group lists it.

        Its arguments and options are worked out when it is first looked at: a group's help names
        commands, and needs none of them.
        """
        add = super().command(*args, cls=Command, **settings)

        def register(command: Callable) -> Callable:
            def later() -> None: ...

            later.__name__, later.__doc__ = command.__name__, command.__doc__
            later.whole = command  # type: ignore[attr-defined]  # for Command
            add(later)
            return command

        return register


class Command(TyperCommand):
    """A command whose examples have a heading, and whose options come under theirs.

    A heading is in Typer's terms a ``rich_help_panel``.
    """

    @property
    def params(self) -> list:
        """Arguments and options, worked out when they are first asked for."""
        command = getattr(self.callback, "whole", None)
        if command is not None:
            command = getattr(command, LATER, lambda: command)()
            info = CommandInfo(name=self.name, callback=command, cls=TyperCommand)
            made = get_command_from_info(info, pretty_exceptions_short=False, rich_markup_mode=None)
            self._params, self.callback = made.params, made.callback
        return self._params

    @params.setter
    def params(self, params: list) -> None:
        self._params = params

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """`[OPTIONS]`, and the arguments by their names."""
        return ["[OPTIONS]", *map(_usage, self._arguments(ctx))]

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """What the command does, then its examples: the lines that begin with the program."""
        paragraphs = inspect.cleandoc(self.help or "").split("\n\n")
        examples = [p for p in paragraphs if _is_example(p)]
        formatter.write_paragraph()
        with formatter.indentation():
            formatter.write_text("\n\n".join(p for p in paragraphs if not _is_example(p)))
        if examples:
            with formatter.section("Examples"):
                formatter.write_text("\n\n".join(examples))

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and common options, then the others under their headings."""
        arguments = self._arguments(ctx)
        if arguments:
            with formatter.section("Arguments"):
                formatter.write_dl([(_usage(p), p.help) for p in arguments])
        options = [p for p in self.get_params(ctx) if p not in arguments]
        common = [p for p in options if not _heading(p)]
        _write(ctx, formatter, "Options", common)
        special = [p for p in options if _heading(p)]
        for heading, under in groupby(sorted(special, key=_order(special)), _heading):
            _write(ctx, formatter, heading, under)

    def _arguments(self, ctx: Any) -> list:
        return [p for p in self.get_params(ctx) if p.param_type_name == "argument"]


class Group(TyperGroup):
    """A group that lists its commands under their headings, and knows the nearest name."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Show the help where no command is given."""
        if not args and self.no_args_is_help and not ctx.resilient_parsing:
            typer.echo(ctx.get_help(), err=True)
            ctx.exit(2)
        return super().parse_args(ctx, args)

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple:
        """The command of that name; a usage error that says which is nearest if there is none."""
        if self.get_command(ctx, args[0]) is None and not args[0].startswith("-"):
            ctx.fail(f"no such command {args[0]!r}{did_you_mean(args[0], self.commands)}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """The first sentence of each command, whole."""
        shown = [command for command in self.commands.values() if not command.hidden]
        wide = max(len(command.name or "") for command in shown)
        for heading, under in groupby(sorted(shown, key=_order(shown)), _heading):
            with formatter.section(heading or "Commands"):
                rows = [((c.name or "").ljust(wide), c.get_short_help_str(1000)) for c in under]
                formatter.write_dl(rows)


def told(error: TyperException) -> str:
    """A usage error as one sentence, with the command whose help says more."""
    said = error.format_message().removesuffix(".")
    context: Any = getattr(error, "ctx", None)
    if hasattr(error, "possibilities"):
        names = [n for p in context.command.get_params(context) for n in (*p.opts,)]
        name = error.option_name  # type: ignore[attr-defined]  # what has possibilities has it
        said = f"no such option {name}{did_you_mean(name, names)}"
    said = re.sub(r"^\w|: [A-Z]", lambda begin: begin[0].lower(), said)
    return said if context is None else f"{said} (see `{context.command_path} --help`)"


def _usage(argument: Any) -> str:
    name = argument.display_name_raw + ("..." if argument.nargs < 0 else "")
    return name if argument.required else f"[{name}]"


def _is_example(paragraph: str) -> bool:
    return paragraph.startswith("\b\nslgaussian ")


def _heading(shown: Any) -> str | None:
    return shown.rich_help_panel or None


def _order(shown: Iterable[Any]) -> Callable[[Any], int]:
    """Sorts by heading, in the order in which headings first appear."""
    headings = list(dict.fromkeys(map(_heading, shown)))
    return lambda one: headings.index(_heading(one))


def _write(ctx: Any, formatter: Any, heading: str | None, params: Iterable[Any]) -> None:
    rows = []
    for param in params:
        names, said = param.get_help_record(ctx) or ("", "")
        for other in [name for name in param.opts if name.startswith("--")][1:]:
            names = names.replace(f", {other}", "")  # taken, but not taught
        rows += [(names, said)] if names else []
    if rows:
        with formatter.section(heading):
            formatter.write_dl(rows)
