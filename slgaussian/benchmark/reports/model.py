"""Data model of a report: sections of blocks, rendered to HTML, Markdown and terminal text.

Prose is one line of Markdown, in which names are escaped by :func:`escape`; cells, captions and
titles are plain text. Pictures and plots occur only in the HTML.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import jinja2
import numpy as np
from markdown_it import MarkdownIt
from markupsafe import Markup
from PIL import Image

from slgaussian.benchmark.pictures import reduce_width
from slgaussian.benchmark.reports.text_table import table_text

NO_VALUE = "–"

TERMINAL_WIDTH = 100
"""Largest width of a table in a terminal, characters."""

WEBP_QUALITY = 75
"""Quality of pictures: a third of the size of a JPEG with equally clear thin outlines."""


@dataclass(frozen=True)
class Column:
    """A column of a table: numbers are aligned right, text left; ``help`` is a tooltip."""

    title: str
    help: str = ""
    is_text: bool = False


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    ``below`` is small print, such as an interval. ``mark`` is ``best`` (bold), or ``better``,
    ``worse``, ``noise`` or ``few`` for a difference. ``link`` is the id of a section.
    """

    value: str
    below: str = ""
    mark: str = ""
    link: str = ""

    @property
    def text(self) -> str:
        """Return the value and the small print in one line."""
        return f"{self.value} ({self.below})" if self.below else self.value

    def as_markdown(self) -> str:
        """Return the cell in Markdown: the best value bold, words for better and worse."""
        value = f"**{escape(self.value)}**" if self.mark == "best" else escape(self.value)
        below = f" ({escape(self.below)})" if self.below else ""
        return f"{value}{below}{f' {self.mark}' if self.mark in ('better', 'worse') else ''}"


@dataclass
class Table:
    """A table.

    Columns are strings, of which the first is text, or :class:`Column`; cells are strings,
    :class:`Cell`, or None. ``notes`` are prose below it, ``style`` is a class of the style sheet.
    With ``has_total`` the last row is a total.
    """

    columns: Sequence[Any]
    rows: Iterable[Iterable[Any]]
    title: str = ""
    notes: Sequence[str] = ()
    style: str = ""
    has_total: bool = False

    def __post_init__(self) -> None:
        self.columns = [
            column if isinstance(column, Column) else Column(column, is_text=place == 0)
            for place, column in enumerate(self.columns)
        ]
        self.rows = [
            [v if isinstance(v, Cell) else Cell(NO_VALUE if v is None else v) for v in row]
            for row in self.rows
        ]

    def as_text(self) -> str:
        """Return the table as text for a terminal, cells two spaces apart.

        A table that is too wide and has few rows is transposed.
        """
        titles = [column.title for column in self.columns]
        rows = [titles, *([cell.text for cell in row] for row in self.rows)]
        sides = "".join("<" if column.is_text else ">" for column in self.columns)
        text = table_text(rows, sides, wrap=False)
        if len(text.partition("\n")[0]) > TERMINAL_WIDTH and len(rows) <= len(titles):
            return table_text(zip(*rows, strict=True), wrap=False)
        return text

    def as_markdown(self) -> str:
        """Return head and rows in Markdown, a line each."""
        sides = ["---" if column.is_text else "---:" for column in self.columns]
        heads = [escape(column.title) for column in self.columns]
        rows = [heads, *([cell.as_markdown() for cell in row] for row in self.rows)]
        head, *lines = ["|" + "".join(f" {cell} |" for cell in row) for row in rows]
        return "\n".join([head, f"|{'|'.join(sides)}|", *lines])


def values_table(tree: Mapping[str, Any], title: str = "") -> Table:
    """Return a table of two columns without headings: the leaves of nested mappings."""
    return Table(["", Column("", is_text=True)], flatten(tree).items(), title)


def number(value: float | None, digits: int, unit: float = 1) -> str | None:
    """Format a number divided by ``unit``; None for None."""
    return None if value is None else f"{value / unit:,.{digits}f}"


def count_text(count: int, unit: str, plural: str = "") -> str:
    """Return a number with its unit; ``plural`` is the unit with ``s`` by default."""
    return f"{count} {unit if count == 1 else plural or f'{unit}s'}"


@dataclass(frozen=True)
class Prose:
    """A paragraph; ``style`` is a class of the style sheet."""

    text: str
    style: str = "soft"


def terms(definitions: Mapping[str, str]) -> Prose:
    """Return a paragraph that defines terms."""
    parts = (f"**{escape(term)}**: {escape(text)}" for term, text in definitions.items())
    return Prose("; ".join(parts))


@dataclass(frozen=True)
class Picture:
    """A picture: its data URI, caption and alternative text."""

    source: str
    caption: str
    alt: str

    @staticmethod
    def encode(image: np.ndarray, width: int, caption: str, alt: str = "") -> Picture:
        """Encode an image uint8 [H, W, 3], reduced to ``width`` pixels if it is wider, as WebP."""
        out = io.BytesIO()
        Image.fromarray(reduce_width(image, width)).save(out, "WEBP", quality=WEBP_QUALITY)
        return Picture(data_uri(out.getvalue(), "webp"), caption, alt or caption)


def data_uri(data: bytes, kind: str) -> str:
    """Return the data URI of the bytes of a file of type ``image/<kind>``."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


@dataclass(frozen=True)
class Gallery:
    """Pictures side by side; ``layout`` is a class of the style sheet, ``walk`` is the slider."""

    pictures: Sequence[Picture]
    layout: str


@dataclass(frozen=True)
class Card:
    """An answer: the query, chips (text, class of the style sheet), pictures, and a note."""

    title: str
    chips: Sequence[tuple[str, str]]
    pictures: Sequence[Picture]
    note: str = ""


@dataclass(frozen=True)
class Cards:
    """Answers side by side."""

    cards: Sequence[Card]


@dataclass(frozen=True)
class Fold:
    """Blocks that are collapsed below a line of text; ``id`` is an anchor for links."""

    summary: str
    blocks: Sequence[Block]
    id: str = ""


Block = Table | Prose | Gallery | Cards | Fold


@dataclass(frozen=True)
class Section:
    """A section of a report, with a link at the top if it has an ``id``.

    ``note`` is printed beside the title, ``style`` is a class of the style sheet.
    """

    title: str
    blocks: Sequence[Block]
    id: str = ""
    note: str = ""
    style: str = ""


@dataclass(frozen=True)
class Report:
    """A report: its summary and its sections; the same model gives the same bytes."""

    title: str
    summary: Sequence[Block]
    sections: Sequence[Section]

    def as_html(self) -> str:
        """Return a self-contained HTML page."""
        return _template("page.html.j2").render(report=self)

    def as_markdown(self) -> str:
        """Return the report as Markdown, without pictures."""
        return _compact(_template("page.md.j2").render(report=self))

    def as_text(self) -> str:
        """Return paragraphs and tables of the report as text for a terminal."""
        parts = [plain(block.text) for block in self.summary if isinstance(block, Prose)]
        for section in self.sections:
            tables = [block for block in section.blocks if isinstance(block, Table)]
            texts = ["\n".join(filter(None, (table.title, table.as_text()))) for table in tables]
            if texts:
                parts.append(f"{section.title}\n" + "\n\n".join(texts))
        return "\n\n".join(parts)


def append_section(page: str, form: str, section: Section) -> str:
    """Append a section to a rendered report, ``html`` or ``md``."""
    template: Any = _template(f"page.{form}.j2").make_module({"report": None})
    text = str(template.section(section))
    if form == "html":
        link = f'<a href="#{section.id}">{section.title}</a></nav>'
        return page.replace("</main>", f"{text}</main>").replace("</nav>", link)
    return _compact(f"{page}\n{text}")


def _compact(markdown: str) -> str:
    """Reduce several empty lines of a template to one."""
    return re.sub(r"\n{3,}", "\n\n", markdown).rstrip() + "\n"


def escape(text: Any) -> str:
    """Escape a text as one line of Markdown without markup."""
    return re.sub(r"([\\`*_<>|\[\]&])", r"\\\1", " ".join(str(text).split()))


def plain(text: str) -> str:
    """Undo :func:`escape` in prose."""
    return re.sub(r"\\(.)", r"\1", text)


def flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Return the leaves of nested mappings as text, keys joined by dots."""
    flat: dict[str, str] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        flat |= flatten(value, f"{name}.") if isinstance(value, Mapping) else {name: str(value)}
    return flat


@cache
def _template(name: str) -> jinja2.Template:
    """Load a template; templates for HTML escape all values."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("slgaussian.benchmark.reports", "."),
        autoescape=lambda file: file is not None and file.endswith(".html.j2"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    inline = MarkdownIt("commonmark", {"html": False})
    environment.filters["cell"] = escape
    environment.filters["prose"] = lambda text: Markup(inline.renderInline(text))
    return environment.get_template(name)
