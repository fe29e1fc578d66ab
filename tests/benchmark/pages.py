"""Parsers of HTML and Markdown reports."""

import re
from html.parser import HTMLParser


class Page(HTMLParser):
    """Collect tags, attributes and text; assert that tags nest."""

    VOID = ("meta", "img", "br", "input")

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags, self.images, self.words, self.open = [], [], [], []
        self.script = ""
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag == "img":
            self.images.append(dict(attrs))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "script" in self.open:
            self.script += data
        else:
            self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))


def check_alone(html: str) -> None:
    """Check that a page is self-contained: no network, embedded pictures, at most one script."""
    page = Page(html)
    assert not {"link", "iframe"} & set(page.tags)
    assert html.count("<script>") == page.tags.count("script") <= 1
    assert not re.search(r"fetch|XMLHttp|import|innerHTML|eval|document\.write", page.script)
    assert "http" not in re.sub(r'src="data:[^"]*"', "", html)
    assert set(re.findall(r"url\((.)", html)) <= {"#"}
    for image in page.images:
        assert re.match(r"data:image/(webp|svg\+xml);base64,", image["src"])
        assert image["alt"]


def read_tables(markdown: str) -> list[list[list[str]]]:
    """Return the tables of a Markdown text; check that rows have as many cells as the heading."""
    tables, rows = [], []
    for line in [*markdown.splitlines(), ""]:
        if line.startswith("|"):
            cells = re.split(r"(?<!\\)\|", line.strip())[1:-1]
            rows.append([cell.strip().replace("\\", "") for cell in cells])
        elif rows:
            assert all(set(cell) <= set("-:") and cell for cell in rows[1])
            assert len({len(row) for row in rows}) == 1
            tables.append([rows[0], *rows[2:]])
            rows = []
    return tables
