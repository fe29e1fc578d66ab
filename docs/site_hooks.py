"""What MkDocs calls while it builds the site: pages that lie beside `docs/`, and links to them."""

import json
import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

BESIDE = {
    "README.md": "start.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
"""Files of the repository that are pages of the site, by the names that they have there."""
NOTEBOOKS = {"docs/two_photographs.ipynb": "two_photographs.md"}
"""Notebooks of the repository, and the pages that show them."""

_MOVED = {**BESIDE, **NOTEBOOKS}
_SOURCE = {page: source for source, page in _MOVED.items()}
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages whose text is not in `docs/`, or not Markdown."""
    root = Path(config.docs_dir).parent
    for source, page in BESIDE.items():
        files.append(File.generated(config, page, content=(root / source).read_text("utf-8")))
    for source, page in NOTEBOOKS.items():
        if (root / source).exists():
            text = notebook_text((root / source).read_text("utf-8"))
            files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links between files of the repository into links between pages of the site.

    A file that is no page, such as `prefect.yaml`, is named and not linked.
    """
    here = page.file.src_uri
    source = _SOURCE.get(here, f"docs/{here}")

    def moved(link: re.Match) -> str:
        mark, text, target = link.groups()
        path, hash_, fragment = target.partition("#")
        if not path or "://" in path or path.startswith("data:"):
            return link[0]
        full = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        inside = full.removeprefix("docs/") if full.startswith("docs/") else None
        place = _MOVED.get(full, inside)
        if place is None:
            return text
        there = posixpath.relpath(place, posixpath.dirname(here) or ".")
        return f"{mark}[{text}]({there}{hash_}{fragment})"

    parts = re.split(r"(^ *```.*?^ *```$)", markdown, flags=re.MULTILINE | re.DOTALL)
    return "".join(part if i % 2 else _LINK.sub(moved, part) for i, part in enumerate(parts))


def notebook_text(stored: str) -> str:
    """A notebook as Markdown: its words, its code, and what the code printed and drew."""
    text = []
    for cell in json.loads(stored)["cells"]:
        source = "".join(cell["source"])
        text.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            printed = "".join(output.get("text", data.get("text/plain", "")))
            drawn = [kind for kind in ("image/jpeg", "image/png") if kind in data]
            if drawn:
                pixels = "".join(data[drawn[0]]).replace("\n", "")
                text.append(
                    f'<img alt="what the code draws" src="data:{drawn[0]};base64,{pixels}">'
                )
            elif printed:
                text.append(f"```\n{printed.rstrip()}\n```")
    return "\n\n".join(text) + "\n"
