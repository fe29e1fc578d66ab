"""Write `reference/paper.md`: what the paper says and where it is here, of `paper.toml`."""

import tomllib
from pathlib import Path

HERE = Path(__file__).parent
PAGE = HERE / "reference" / "paper.md"

HEAD = """# The paper and this implementation

Made by `python docs/make_paper.py` from `docs/paper.toml`. The method is that of *SLGaussian: Fast
Language Gaussian Splatting in Sparse Views* (Chen et al., ACM MM 2025, [arXiv
2412.08331](https://arxiv.org/abs/2412.08331)), whose authors released no code.

```sh
slgaussian field a.jpg b.jpg --preset paper -o field
slgaussian query field "red basket" --set preset=paper -o hit.png
slgaussian benchmark --rooms 0-9 --preset paper -o paper
slgaussian train --lessons corpus --preset paper -o trained
```

`--preset paper` sets every **option** below, except those that need weights: for these add `--set
predictor=mvsplat`, `proposer=sam`, `encoder=clip` and `lifting=branch`, each with its files. A
query has settings of its own, so give the preset there too.

**same**: as printed. **option**: the command does as printed, the default does not. **differs**:
neither does. **absent**: not run here."""

TITLES = {
    "claim": "Claims",
    "equation": "Equations",
    "method": "Method",
    "setting": "Settings",
    "result": "Results",
    "figure": "Figures",
}

TAIL = """## A case of the vote

The input is two views of a room with true masks, and a tracker that confuses one object in four in
each copy of a view. Below the photographs are the ids by one copy, and by the vote over five.
Of the pixels of the second view .84 have the id of the first view with one copy, .94 with the vote
(means of six rooms, 2026-11-26, by a test of commit df753a4f).

![Ids by one copy and by the vote](vote.png)
"""


def rows() -> dict[str, list[dict]]:
    """Return the rows of the table by section."""
    return tomllib.loads((HERE / "paper.toml").read_text("utf-8"))


def page() -> str:
    """Return the page."""
    parts = [HEAD]
    for section, title in TITLES.items():
        lines = [
            f"## {title}",
            "",
            "| the paper | here | where | command | why |",
            "|---|---|---|---|---|",
        ]
        for row in rows()[section]:
            code = ", ".join(
                f"`{place.split(':')[1]}` in `{place.split(':')[0]}`" for place in row["code"]
            )
            cells = row["paper"], f"**{row['here']}**", code, f"`{row['command']}`", row["why"]
            lines.append(f"| {' | '.join(cells)} |")
        parts.append("\n".join(lines))
    return "\n\n".join([*parts, TAIL])


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
