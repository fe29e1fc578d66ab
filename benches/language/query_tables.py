"""The words of ``docs/measured/queries.md``: what its tables hold, and how to read them."""

from benches.common.markdown_tables import Table, count, error, ms
from benches.language.hard_texts import TEMPERATURES

_EXACT = {f"exact_{t:g}": (f"T = {t:g}", error) for t in TEMPERATURES}
_HALF = {f"half_{t:g}": (f"half, T = {t:g}", error) for t in TEMPERATURES}

TABLES = {
    "speed": Table(
        "Speed",
        "A field of 60 objects with features of 512 numbers, seen at 416 x 576; texts are encoded "
        "already. Times in ms, the least of up to 11 rounds, as others used the machine too. A "
        "query gives mask, relevancy image, point and objects. *LangSplat's way* decodes the "
        "rendered code of every pixel to 512 numbers with its network "
        "(3-16-32-64-128-256-256-512, random weights, PyTorch) and scores each pixel against the "
        "text and four canonical phrases, which makes the relevancy image alone; further queries "
        "reuse the decoded image, half a gigabyte. *Processor* is time on all cores together, of "
        "which *times less* tells the ratio.",
        {
            "what": ("what", str),
            "asked": ("asked, ms", str),
            "ours": ("ours", ms),
            "ours_cpu": ("processor", ms),
            "theirs": ("LangSplat's way", ms),
            "theirs_cpu": ("processor", ms),
            "ratio": ("times less", count),
        },
    ),
    "errors": Table(
        "Errors",
        "Greatest absolute error of a relevancy at temperature T, against the printed formula in "
        "decimal arithmetic of 60 digits; each case is a test too. First of float64 features, "
        "then of features rounded to half precision, as a bank stores them, against the same "
        "features not rounded.",
        {"case": ("case", str), "about": ("what is hard", str), **_EXACT, **_HALF},
    ),
    "texts": Table(
        "Texts",
        "What the lexicon makes of texts that break encoders.",
        {"text": ("text", str), "answer": ("answer", str)},
    ),
}


def page(rows: dict[str, list[dict]], command: str, machine: str) -> str:
    """Markdown of all ``rows``, by the keys of ``TABLES``."""
    tables = "\n".join(TABLES[key].markdown(found) for key, found in rows.items())
    return f"""# Queries, measured

Made by `{command}` on {machine}.

How a text is answered is said in [questions](../guides/questions.md).

{tables}"""
