"""What words find with more context views: IoU of labels at the same targets.

    python -m benches.views.labelled_targets DATA [--views 2,4]

DATA holds ``office`` (labelled pairs of a walk), ``office_walk`` (the walk's other frames, in the
same world) and ``places``. Further context views are chosen by ``slgaussian benchmark --sweep``:
those of an office pair from the frames of both folders, those of a place from its photographs,
where it has enough. Everything is at its default.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import pyarrow.parquet as pq

from benches.common.markdown_tables import table
from benches.common.photograph_pairs import data_folder
from benches.common.process_cost import CLI, costing
from benches.views.built_fields import Row, whole_numbers
from benches.views.spread import places
from slgaussian.benchmark.scores import scene_means

NUMBERS = (2, 4)
SETS = ("office", "places")
SCORES = ("iou", "miou", "hit_mask")


def office(data: Path, numbers: Sequence[int]) -> Iterator[Row]:
    """The rows of the labelled pairs of the office, with frames of the walk beside them."""
    with tempfile.TemporaryDirectory() as made:
        whole = Path(made) / "office"
        whole.mkdir()
        frames: dict[str, dict] = {}
        for name in ("office", "office_walk"):
            (whole / name).symlink_to((data / name).resolve())
            content = json.loads((data / name / "transforms.json").read_text())
            for frame in content.pop("frames"):
                path = f"{name}/{frame['file_path']}"
                # A frame is there as it is stored with the pairs.
                frames.setdefault(Path(path).stem, {**content, **frame, "file_path": path})
        for frame in frames.values():
            frame.pop("depth_file_path", None)
        (whole / "transforms.json").write_text(json.dumps({"frames": list(frames.values())}))
        pairs = json.loads((data / "office/pairs.json").read_text())
        for pair in pairs.values():
            for kind in ("context", "target"):
                pair[kind] = [f"office/{name}" for name in pair[kind]]
        (whole / "pairs.json").write_text(json.dumps(pairs))
        yield from scored(whole, whole / "office/labels", numbers, "office")


def place(folder: Path, numbers: Sequence[int]) -> Iterator[Row]:
    """The rows of the labelled pairs of a place."""
    yield from scored(folder, folder / "labels", numbers, "places")


def scored(folder: Path, labels: Path, numbers: Sequence[int], of: str) -> Iterator[Row]:
    """The rows that the benchmark leaves of a labelled folder, marked with what they are of."""
    with tempfile.TemporaryDirectory() as out:
        words = ["benchmark", "--data", folder, "--pairs", folder / "pairs.json"]
        words += ["--labels", labels, "--sweep", f"views={','.join(map(str, numbers))}"]
        costing([*CLI, *words, "-o", f"{out}/out", "--store", f"{out}/store"], status=(0, 1))
        samples: dict[tuple[str, str], list[Row]] = {}
        for row in pq.read_table(f"{out}/out/samples.parquet").to_pylist():
            if row["protocol"].startswith("slgaussian@") and "=" in row["method"]:
                samples.setdefault((row["scene"], row["method"]), []).append(row)
        for (scene, method), own in samples.items():
            means = scene_means(own)
            found = {name: means[name] for name in SCORES}
            yield {"set": of, "scene": scene, "views": int(method.rpartition("=")[2])} | found


def summary_table(rows: Sequence[Row], numbers: Sequence[int]) -> str:
    """Means over the scenes that have every number, and gains of IoU over two views, in pairs."""
    known = {(row["set"], row["scene"], row["views"]): row for row in rows}
    lines = []
    for name in SETS:
        scenes = dict.fromkeys(scene for of, scene, _ in known if of == name)
        own = [s for s in scenes if all((name, s, number) in known for number in numbers)]
        for number in numbers if own else ():
            found = [known[name, scene, number] for scene in own]
            gains = [row["iou"] - known[name, row["scene"], 2]["iou"] for row in found]
            line: Row = {"set": name, "views": number, "scenes": len(own)}
            line |= {score: sum(row[score] for row in found) / len(own) for score in SCORES}
            if number > 2:
                line |= {"gain": sum(gains) / len(gains), "worst": min(gains)}
            lines.append(line)
    columns = {
        "set": ("set", str),
        "views": ("views", "d"),
        "scenes": ("scenes", "d"),
        "iou": ("IoU", ".3f"),
        "gain": ("over two", "+.3f"),
        "worst": ("worst", "+.3f"),
        "miou": ("mIoU", ".3f"),
        "hit_mask": ("point in mask", ".2f"),
    }
    return table(lines, columns)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "data", type=data_folder("office/labels", "office_walk/transforms.json", "places")
    )
    parser.add_argument("--views", type=whole_numbers, default=NUMBERS)
    given = parser.parse_args()
    rows = list(office(given.data, given.views))
    for name in places(given.data / "places"):
        rows += place(given.data / "places" / name, given.views)
    print(summary_table(rows, given.views))


if __name__ == "__main__":
    main()
