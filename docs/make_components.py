"""Write `reference/components.md`: the components that come with the package, and their fields."""

from pathlib import Path

from slgaussian.components.registry import list_components

PAGE = Path(__file__).parent / "reference" / "components.md"

HEAD = """# Components and their fields

Made by `python docs/make_components.py`. `slgaussian doctor --components` prints the same of an
installation, with the components of other packages.

The field `depth_candidates` of `planesweep` is `--set planesweep.depth_candidates=64` on the
command line, `depth_candidates` in the table `[planesweep]` of a configuration file
(`[sam2_video]` for `sam2-video`), and in Python
`slg.Method(settings={"planesweep": {"depth_candidates": 64}})`. Cache keys and results record a
file, folder or model by its content. How a component is added:
[architecture](../architecture.md#where-to-add-a-component)."""

if __name__ == "__main__":
    PAGE.write_text(f"{HEAD}\n\n{list_components()}", "utf-8")
