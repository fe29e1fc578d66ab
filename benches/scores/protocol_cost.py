"""What it costs to score a query by each protocol.

    python -m benches.scores.protocol_cost [-o FILE]

Nothing is rendered or encoded: the answers are made up, 20 queries of a frame of the paper's size.
*objects*, as a field answers, have one relevancy each; *pixels* have all a different one, as a
method that scores each pixel has.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

from benches.common.pages import publish
from benches.common.paired_timing import paired_times
from slgaussian.benchmark.protocols import PROTOCOLS, Answer, Frame
from slgaussian.language.query import Rules

HEIGHT, WIDTH = 416, 576
QUERIES = 20


def frame(objects: bool) -> Frame:
    """Truths are 20 of 48 tiles; answers see them a little shifted."""
    rng = np.random.default_rng(0)
    tiles = np.arange(48, dtype=np.uint8).reshape(6, 8)
    truth = cv2.resize(tiles, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST)
    seen = np.roll(truth, (5, -7), (0, 1))
    table = rng.random((QUERIES, 48), np.float32) * 0.6 + 0.1
    table[range(QUERIES), range(QUERIES)] = 0.8
    answers = []
    for scores in table:
        relevancy = scores[seen]
        if not objects:
            relevancy = relevancy + rng.random(relevancy.shape, np.float32) / 10
        answers.append(Answer(relevancy, relevancy > 0.75, (WIDTH // 2, HEIGHT // 2)))
    masks = [truth == k for k in range(QUERIES)]
    boxes = [np.array([[0.0, 0, 99, 99]])] * QUERIES
    return Frame(answers, masks, boxes, table.argmax(0).astype(np.int32)[seen] + 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, help="Markdown file")
    given = parser.parse_args()

    def score(name: str, asked: Frame) -> None:
        # A new frame, so that what protocols share is worked out for each.
        fresh = Frame(asked.answers, asked.masks, asked.boxes, asked.labels)
        PROTOCOLS[name].score(fresh, PROTOCOLS[name].mask_settings(Rules(), WIDTH))

    def score_all(asked: Frame) -> None:
        fresh = Frame(asked.answers, asked.masks, asked.boxes, asked.labels)
        for protocol in PROTOCOLS.values():
            protocol.score(fresh, protocol.mask_settings(Rules(), WIDTH))

    spent = {}
    for kind in ("objects", "pixels"):
        asked = frame(kind == "objects")
        runs = {name: lambda name=name, asked=asked: score(name, asked) for name in PROTOCOLS}
        runs["all of them"] = lambda asked=asked: score_all(asked)
        spent[kind] = paired_times(runs, time.process_time, min)
    rows = [
        {"protocol": name, **{kind: spent[kind][name] / QUERIES for kind in spent}}
        for name in spent["objects"]
    ]
    size = {"queries": QUERIES, "height": HEIGHT, "width": WIDTH}
    publish("scores/protocol_cost.md.j2", given.out, rows=rows, **size)


if __name__ == "__main__":
    main()
