"""Write `reference/components.md`: the components that come with the package, and their fields."""

from pathlib import Path

from slgaussian.components.catalogue import as_markdown

PAGE = Path(__file__).parent / "reference" / "components.md"

if __name__ == "__main__":
    PAGE.write_text(as_markdown(), "utf-8")
