"""The commands `slgaussian query | segment | words`, with lazy imports."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flows.cli import options
from slgaussian.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from slgaussian.field_view import FieldView
    from slgaussian.language.answer import QueryResult

MAX_PRINTED_OBJECTS = 3
"""Number of printed objects of an answer."""

NO_TEXT_FITS = "no text fits"
"""Name of the label of pixels that fit canonical phrases better than any text."""


@options.add_options("preset", "threshold")
def query(
    ctx: typer.Context,
    field: options.Folder,
    texts: options.Texts = None,
    like: Annotated[list[Path] | None, typer.Option(help="Find what a picture shows.")] = None,
    view: options.Views = None,
    between: options.Between = None,
    camera: options.CameraFile = None,
    out: options.Picture = None,
    as_json: options.AsJson = False,
) -> None:
    """Find objects in a field, by a text or a picture.

    Returns the objects that fit the text about as well as the best one, and none if all objects fit
    canonical phrases ("object", "things" ...) better. With --threshold, returns all objects above
    it. Prints the probability that the answer is right. The exit status is 0 if each text is found
    in a view, 3 if one is not (not sure, not here, or cannot tell), 1 if some are refused, 2 if all
    are.

    \b
    slgaussian query field/ "red basket" -o hit.png
    slgaussian query field/ "blue carpet" "wooden table" --view 0 --view 1 --json
    slgaussian query field/ --like crop.png --set share=0.8 -o hit.png
    """
    from flows.cli.open_field import choose_cameras, open_field, render_view, sort_texts
    from flows.cli.pictures import check_picture, write_picture

    texts = texts or []
    if not texts and not like:
        raise InputError("nothing to look for: give a TEXT, or a picture with --like")
    if out is not None:
        check_picture(out)
    rules, opened = open_field(field, ctx)
    crops = {str(file): _read_crop(file) for file in like or ()}
    accepted, refused = sort_texts(opened, texts)
    answers, rows = [], []
    cameras = choose_cameras(field, opened.cameras, view, camera, between)
    for name, shot in cameras.items():
        rendered = render_view(field, opened, shot)
        results = rendered.query_all(accepted, **rules) if accepted else []
        results += [
            replace(rendered.like(*crop, **rules), text=file) for file, crop in crops.items()
        ]
        hits = {hit.text: hit for hit in results}
        for text in [*texts, *crops]:
            answer = _answer(text, hits.get(text), refused.get(text))
            picture = None if out is None else str(out)
            answers.append({"view": name, **answer, "picture": picture})
        if out is not None:
            rows += [_hit_picture(name, rendered, hit) for hit in hits.values()]
    if out is not None:
        write_picture(out, *rows)
    if as_json:
        typer.echo("\n".join(map(json.dumps, answers)))
    else:
        blocks = (_describe(answer, len(answers) > 1) for answer in answers)
        typer.echo("\n\n".join(dict.fromkeys(blocks)))
        if out is not None:
            typer.echo(f"picture  {out}")
    if refused:
        raise typer.Exit(1)
    hit_texts = {answer["text"] for answer in answers if answer["found"]}
    raise typer.Exit(0 if hit_texts == {answer["text"] for answer in answers} else 3)


def _answer(text: str, hit: QueryResult | None, refused: str | None) -> dict[str, Any]:
    """Return the JSON output of a text in a view, without the names of view and picture.

    See :class:`slgaussian.language.answer.QueryResult` and :class:`slgaussian.language.Understood`.
    """
    answer: dict[str, Any] = {"text": text, "found": False, "verdict": None, "refused": refused}
    if hit is None:
        return {**answer, "summary": f"refused: {refused}"}
    return answer | {
        "found": hit.found,
        "verdict": hit.verdict,
        "summary": hit.summary,
        "confidence": None if hit.confidence is None else hit.confidence._asdict(),
        "uncalibrated": hit.uncalibrated or None,
        "score": hit.score,
        "point": list(hit.point) if hit.shown and hit.point is not None else None,
        "objects": [{"id": id_, "relevancy": score} for id_, score in hit.objects],
        "pixels": int(hit.mask.sum()) if hit.shown else 0,
        "read_as": hit.understood.read_as,
        "unknown": list(hit.unknown),
        "unused": dict(hit.understood.unused),
        "kind": hit.kind,
        "examples": hit.understood.examples,
        "instead_of": hit.understood.instead_of or None,
    }


def _describe(answer: Mapping[str, Any], with_title: bool) -> str:
    """Format an answer as text: a sentence, the best objects, and unused words."""
    if answer["refused"]:
        return f"{answer['text']!r} is {answer['summary']}"
    lines = [f"{answer['text']!r} in {answer['view']}"] if with_title else []
    lines.append(answer["summary"])
    if answer["objects"]:
        best = ", ".join(
            f"{o['id']} ({o['relevancy']:.3f})" for o in answer["objects"][:MAX_PRINTED_OBJECTS]
        )
        unlisted = len(answer["objects"]) - MAX_PRINTED_OBJECTS
        if answer["point"]:
            x, y = answer["point"]
            rest = f" and {unlisted} more" if unlisted > 0 else ""
            lines.append(f"objects  {best}{rest}; point x {x}, y {y}")
        elif answer["read_as"]:
            lines.append(f"most like it  {best}")
    return "\n".join([*lines, *_describe_words(answer)])


def _describe_words(answer: Mapping[str, Any]) -> Sequence[str]:
    """Describe the meaning of a text: its source, and unknown and unused words."""
    if answer["kind"] == "picture":
        return ["queried by a picture"]
    if answer["kind"] in ("named", "taught"):
        count = answer["examples"]
        taught = f"a taught word: {count} example{'' if count == 1 else 's'}"
        lines = ["a name that you gave" if answer["kind"] == "named" else taught]
        if answer["instead_of"]:
            lines.append(f"not as the encoder knows it: {answer['instead_of']}")
        return lines
    lines = []
    if answer["unknown"]:
        lines.append(f"not known and left out: {', '.join(answer['unknown'])}")
    for reason in dict.fromkeys(answer["unused"].values()):
        unused = [word for word, cause in answer["unused"].items() if cause == reason]
        lines.append(f"set aside: {', '.join(unused)} ({reason})")
    if lines and answer["read_as"]:
        lines.append(f"so this looked for: {answer['read_as']}")
    return lines


def _read_crop(file: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Read an upright photograph, uint8 [H, W, 3], and its opaque pixels, bool [H, W], or None."""
    from slgaussian.datasets.exif import read_orientation, upright
    from slgaussian.datasets.photographs import MIN_OPAQUE_ALPHA, read_alpha_channel, read_colours
    from slgaussian.formats import images

    try:
        with images.open_image(file) as image:
            image.load()
            turned = upright(image, read_orientation(image))
            pixels, alpha = read_colours(turned, str(file)), read_alpha_channel(turned)
    except (OSError, ValueError) as error:
        raise images.unreadable(file, error) from None
    opaque = None if alpha is None else alpha >= MIN_OPAQUE_ALPHA
    if opaque is not None and not opaque.any():
        raise InputError(f"{file}: is transparent everywhere; give a picture that shows a thing")
    return pixels, None if opaque is None or opaque.all() else opaque


def _hit_picture(name: str, view: FieldView, hit: QueryResult) -> np.ndarray:
    """Draw the view, the relevancy of a text, and the mask and point of its answer."""
    from slgaussian.benchmark import pictures

    answer = view.rgb
    if hit.verdict == "found":
        outlined = pictures.draw_outline(answer, hit.mask, pictures.PREDICTED_COLOUR)
        answer = pictures.draw_point(outlined, hit.point)
    elif hit.verdict == "not sure":
        answer = pictures.draw_dashed_outline(answer, hit.mask, pictures.PREDICTED_COLOUR)
    relevancy = pictures.paint_relevancy(hit.relevancy, view.rgb)
    first = f"rendering, {name}", view.rgb
    panels = [first, (f"relevancy of {hit.text!r}", relevancy), (hit.summary, answer)]
    return pictures.side_by_side(panels)


@options.add_options("threshold")
def segment(
    ctx: typer.Context,
    field: options.Folder,
    texts: Annotated[list[str], typer.Argument(metavar="TEXT", help="Texts to look for.")],
    view: options.View = None,
    between: options.Between = None,
    camera: options.CameraFile = None,
    out: options.Picture = None,
    as_json: options.AsJson = False,
) -> None:
    """Label each object in a view with the text that fits it best.

    Objects that fit canonical phrases ("object", "things" ...) better than any text get none;
    --threshold moves that bound from 0.5. Prints one row per text: label, fraction of the pixels,
    mean relevancy, verdict of a query for it alone, and objects. The exit status is 1 if some texts
    are refused, 2 if all are. With -o labels.png, also writes labels.ids.png: a 16-bit PNG, 1 for
    the first text, 0 for none.

    \b
    slgaussian segment field/ wall floor "red sofa" -o labels.png
    slgaussian segment field/ wall floor "red sofa" --between 0 1 0.5 --json
    """
    import numpy as np

    from flows.cli import open_field as opening
    from flows.cli.pictures import check_picture, write_picture
    from slgaussian.benchmark.reports.text_table import table_text
    from slgaussian.io import write_file
    from slgaussian.masks.precomputed import encode_ids

    if out is not None:
        check_picture(out)
    rules, opened = opening.open_field(field, ctx)
    accepted, refused = opening.sort_texts(opened, texts)
    chosen = opening.choose_cameras(field, opened.cameras, view and [view], camera, between)
    ((name, shot),) = chosen.items()
    rendered = opening.render_view(field, opened, shot)
    hits = rendered.query_all(accepted, **rules)
    # The label of a text is its position among all texts, from 1.
    numbers = [texts.index(text) + 1 for text in accepted]
    labels = np.array([0, *numbers], np.int32)[rendered.segment(accepted, **rules)]
    best = np.stack([hit.relevancy for hit in hits]).max(0)
    pixels = np.bincount(labels.ravel(), minlength=len(texts) + 1)
    total = np.bincount(labels.ravel(), best.ravel(), minlength=len(texts) + 1)
    rows: list[dict[str, Any]] = [
        {
            "text": texts[label - 1] if label else None,
            "label": label,
            "share": pixels[label] / labels.size,
            "relevancy": total[label] / pixels[label] if pixels[label] else None,
            "verdict": verdict,
            "objects": [int(id_) for id_ in np.unique(rendered.ids[labels == label]) if id_],
        }
        for label, verdict in zip(
            [*numbers, 0], [*(hit.verdict for hit in hits), None], strict=True
        )
    ]
    if out is not None:
        write_picture(out, _labels_picture(name, rendered, labels, rows))
        write_file(out.with_suffix(".ids.png"), encode_ids(labels)[1])
    lines = [("label", "text", "pixels", "relevancy", "verdict", "objects"), *map(_cells, rows)]
    rows += [{"text": text, "refused": reason} for text, reason in refused.items()]
    if as_json:
        typer.echo("\n".join(map(json.dumps, rows)))
    else:
        typer.echo("\n".join([table_text(lines, "><>><<"), *opening.refusals(rows)]))
        if out is not None:
            typer.echo(f"picture  {out}\nlabels   {out.with_suffix('.ids.png')}")
    raise typer.Exit(1 if refused else 0)


def _cells(row: Mapping[str, Any]) -> Sequence[str]:
    text = NO_TEXT_FITS if row["text"] is None else row["text"]
    mean = "" if row["relevancy"] is None else f"{row['relevancy']:.3f}"
    share, ids = f"{100 * row['share']:.1f} %", ", ".join(map(str, row["objects"]))
    return str(row["label"]), text, share, mean, row["verdict"] or "", ids


def _labels_picture(
    name: str, view: FieldView, labels: np.ndarray, rows: Sequence[Mapping[str, Any]]
) -> np.ndarray:
    """Draw the view and its labels int32 [H, W], with a legend of their texts."""
    import numpy as np

    from slgaussian.benchmark import pictures

    painted = pictures.spotlight(pictures.paint_labels(labels, view.rgb), labels > 0)
    panels = [(f"rendering, {name}", view.rgb), ("the text that fits", painted)]
    legend = [
        (pictures.label_colours(np.array(row["label"])), f"{text}  {share}")
        for row in rows
        for _, text, share, *_ in [_cells(row)]
    ]
    return pictures.with_legend(pictures.side_by_side(panels), legend)


def words(
    texts: Annotated[list[str] | None, typer.Argument(metavar="[WORD]...")] = None,
) -> None:
    """List the words that the encoder lexicon knows, or explain some words.

    Synonyms are in brackets. A word is known by measurements, by the classifier, by both or not at
    all. The exit status is 0 if all words are known, 3 if one is not.

    \b
    slgaussian words
    slgaussian words radiator "red basket" skull
    """
    from slgaussian.language.vocabulary import load_vocabulary

    vocabulary = load_vocabulary()
    if not texts:
        for family, spellings in vocabulary.families().items():
            listed = (f"{name} ({', '.join(o)})" if o else name for name, o in spellings.items())
            typer.echo(f"{family}: {', '.join(listed)}")
        return
    explained = [(text, *vocabulary.explain(text)) for text in texts]
    for text, _, how in explained:
        typer.echo(f"{text}: {how}")
    raise typer.Exit(0 if all(is_known for _, is_known, _ in explained) else 3)
