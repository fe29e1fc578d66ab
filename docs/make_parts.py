"""Write `reference/parts.md`: the parts that come with the package, and their settings."""

from pathlib import Path

from flows.cli.components import markdown

PAGE = Path(__file__).parent / "reference" / "parts.md"

if __name__ == "__main__":
    PAGE.write_text(markdown(), "utf-8")
