"""Draw overview.jpg, the picture at the top of the README: `python docs/make_overview.py`."""

from pathlib import Path

import cv2
import numpy as np

import slgaussian as slg
from slgaussian.benchmark import pictures
from slgaussian.cameras.paths import between


def row(sample: slg.Sample, queries: tuple[str, str]) -> np.ndarray:
    """Two photographs in; a new viewpoint, its objects and two answers out."""
    field = slg.build_field(sample)
    first, second = (view.camera for view in sample.context)
    seen = field.render(between(first, second, 0.5))
    panels = [(f"photograph {i + 1}", view.image) for i, view in enumerate(sample.context)]
    panels += [
        ("a viewpoint between them", seen.rgb),
        ("its objects", pictures.paint_labels(seen.ids, seen.rgb)),
    ]
    for text in queries:
        hit = seen.query(text)
        found = pictures.draw_outline(
            pictures.spotlight(seen.rgb, hit.mask), hit.mask, pictures.PREDICTED_COLOUR
        )
        panels.append((f"“{text}”", pictures.draw_point(found, hit.point)))
    return pictures.side_by_side(panels)


def main() -> None:
    """Draw the motorcycle pair and a procedural room."""
    motorcycle = slg.datasets.load("stereo").sample(["left", "right"])
    room = slg.datasets.load("procedural", seed=1).sample(["view_00", "view_03"])
    rows = [
        row(motorcycle, ("red", "grey floor")),
        row(room, ("orange striped ball", "blue wall")),
    ]
    width = max(part.shape[1] for part in rows)
    rows = [cv2.resize(r, (width, round(r.shape[0] * width / r.shape[1]))) for r in rows]
    jpeg = pictures.encode_jpeg(np.concatenate(rows), width=2000)
    (Path(__file__).parent / "overview.jpg").write_bytes(jpeg)


if __name__ == "__main__":
    main()
