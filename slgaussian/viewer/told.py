"""What a session found, in Markdown for the panel of the page."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np

from slgaussian.benchmark.pictures import label_colors
from slgaussian.language.query import QueryResult
from slgaussian.viewer import paint
from slgaussian.viewer.session import EVEN, Session

MOST = 6
"""Objects and words that are named."""

_SIGNS = str.maketrans({sign: f"&#{ord(sign)};" for sign in "\\`*_{}[]()#+-.!|~<>&\"'/:=$@^"})

_KINDS = {
    "known": "known",
    "unknown": "in part unknown",
    "named": "named by you",
    "taught": "taught",
    "picture": "a picture",
}


def plain(text: str) -> str:
    """Words of a user as text that Markdown and HTML leave alone, on one line."""
    return html.unescape(" ".join(text.split())).translate(_SIGNS)


def answer(session: Session) -> str:
    """The last answer: score, confidence, objects and kind of each text; several as a legend."""
    found = session.answer
    lines: list[str] = []
    shares = np.zeros(0)
    if found.hits:
        shares = np.bincount(found.winner(), minlength=len(found.hits) + 1) / len(session.labels)
    for number, hit in enumerate(found.hits, 1):
        sign = "" if len(found.hits) == 1 else f"{swatch(label_colors(np.array(number)))} "
        said = f"{sign}**{plain(hit.text)}** ({_kind(hit)}): "
        said += plain(hit.summary)
        if hit.objects:
            like = "; most like it: " if hit.verdict == "not here" else "; "
            said += f"; score {hit.score:.3f}{like}{_objects(session, hit.objects)}"
        if len(found.hits) > 1:
            said += f"; {100 * shares[number]:.0f} % of the Gaussians"
        lines.append(said)
        lines += _of_words(hit)
    lines += [f"**{plain(text)}** is refused: {plain(why)}" for text, why in found.refused.items()]
    return "\n\n".join(lines)


def thing(session: Session) -> str:
    """The object that is selected: its words, how much there is of it, where it is seen."""
    if session.field is None:
        return "A .ply knows no objects: its Gaussians have colours alone."
    about = session.thing()
    if about is None:
        return "Click a thing in the scene."
    named = f" **{plain(about.name)}**" if about.name else ""
    words = ", ".join(f"{plain(word)} {score:.2f}" for word, score in about.words if score > EVEN)
    lines = [f"Object {about.id}{named}", f"words: {words or 'none that fits'}"]
    views = ", ".join(map(plain, about.views[:MOST]))
    more = f" and {len(about.views) - MOST} more" if len(about.views) > MOST else ""
    lines.append(f"seen in {views}{more}")
    lines.append(f"{about.gaussians:,} Gaussians, confidence {about.confidence:.2f}")
    if about.box is not None:
        size = " x ".join(f"{2 * half:.2g}" for half in about.box.half_sizes)
        unit = "scene units, which are no metres" if about.metres is False else "scene units"
        lines.append(f"{size} {unit}")
    return "\n\n".join(lines)


def alike(session: Session) -> str:
    """What is like the object that is selected."""
    own = session.field
    if own is None or not session.look.selected:
        return thing(session)
    found = own.like_object(session.look.selected)
    like = [(id_, score) for id_, score in found if score > EVEN]
    if not like:
        return f"{thing(session)}\n\nNothing else is like it."
    return f"{thing(session)}\n\nlike it: {_objects(session, like)}"


def marks(session: Session) -> str:
    """What the colours of the marks mean that are shown."""
    lines = []
    if session.look.guesses:
        if session.gaussians.guessed is None:
            lines.append("Which depths are guesses is not known of this scene.")
        else:
            share = 100 * float(session.gaussians.guessed.float().mean())
            lines.append(f"{swatch(paint.GUESSED)} a guess: no second view confirms it "
                         f"({share:.0f} % of the Gaussians)")  # fmt: skip
    if session.look.unsure:
        lines.append(f"{swatch(paint.UNSURE)} unsure which object it is")
    return "\n\n".join(lines)


def swatch(colour: Sequence[int] | np.ndarray) -> str:
    """A square of a colour."""
    r, g, b = map(int, colour)
    return f'<span style="color: rgb({r},{g},{b})">&#9632;</span>'


def _kind(hit: QueryResult) -> str:
    return _KINDS[hit.kind]


def _objects(session: Session, objects: Sequence[tuple[int, float]]) -> str:
    names = {} if session.field is None else session.field.names
    told = [
        f"{plain(names[id_])} ({id_}) {score:.2f}" if id_ in names else f"{id_} ({score:.2f})"
        for id_, score in objects[:MOST]
    ]
    more = f" and {len(objects) - MOST} more" if len(objects) > MOST else ""
    return f"objects {', '.join(told)}{more}" if len(objects) > 1 else f"object {told[0]}"


def _of_words(hit: QueryResult) -> list[str]:
    unknown = plain(", ".join(hit.unknown))
    return [f"not known and left out: {unknown}"] if unknown else []
