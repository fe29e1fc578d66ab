"""Pages of ``docs/measured/``: what a bench measured, put into a template beside the bench.

A template is Markdown with Jinja's marks. In it are the formats of ``markdown_tables``,
``table(rows, columns)``, the filters ``show`` (a value by a format), ``where`` (the first row with
these values) and ``paragraph`` (lines joined into one, as the page has them), and whatever the
bench gives.
"""

from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import jinja2

from benches.common import markdown_tables
from benches.common.machine import measured
from slgaussian.io import write_atomic

FORMATS = (
    "ms", "percent", "tenths_of_percent", "per_cent", "interval", "error", "error_under",
    "fraction", "limit",
)  # fmt: skip


def page(template: str, **results: object) -> str:
    """Markdown of ``results`` by a template, whose path is below ``benches/``.

    Below its first heading, or first of all, stands what
    :func:`benches.common.machine.measured` says.
    """
    text = environment().get_template(template).render(**results).lstrip("\n")
    heading, rest = text.split("\n", 1) if text.startswith("#") else ("", f"\n{text}")
    return f"{heading}\n\n{measured()}\n{rest}".lstrip("\n")


def publish(template: str, file: Path | None, **results: object) -> None:
    """Print the page, and write it to ``file`` if there is one."""
    text = page(template, **results)
    print(text)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(file, text.encode())


@cache
def environment() -> jinja2.Environment:
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parents[1]),
        undefined=jinja2.StrictUndefined,
        autoescape=False,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.globals |= {name: getattr(markdown_tables, name) for name in ("table", *FORMATS)}
    made.globals["text"] = str
    made.filters |= {"show": markdown_tables.show, "where": _where, "paragraph": _paragraph}
    return made


def _where(rows: Iterable[Mapping], **wanted: object) -> Mapping:
    return next(row for row in rows if wanted.items() <= row.items())


def _paragraph(lines: str) -> str:
    return " ".join(lines.split()) + "\n"
