"""Pairs of photographs for benches: a procedural room, or the pairs of a folder."""

import json
from collections.abc import Callable
from pathlib import Path

from slgaussian import datasets
from slgaussian.errors import InputError
from slgaussian.scene import Sample

SIZE = (416, 576)

DATA_HELP = (
    "nerfstudio folder with transforms.json and pairs.json, which holds "
    '{"scene": {"context": [two images], "target": [image]}, ...}'
)


def data_folder(*holds: str) -> Callable[[str], Path]:
    """Return a parser type for DATA: a folder that must contain these files."""

    def read(argument: str) -> Path:
        folder = Path(argument)
        lacks = [name for name in holds if not (folder / name).exists()]
        if not lacks:
            return folder
        near = [folder.parent, *(sorted(folder.iterdir()) if folder.is_dir() else [])]
        good = [sibling for sibling in near if all((sibling / name).exists() for name in holds)]
        advice = f"did you mean {good[0]}?" if good else f"give a folder with {', '.join(holds)}"
        problem = f"holds no {' and no '.join(lacks)}" if folder.is_dir() else "is no folder"
        raise SystemExit(f"error: DATA: {argument} {problem}; {advice}")

    return read


photographs = data_folder("transforms.json", "pairs.json")
labelled = data_folder("transforms.json", "pairs.json", "labels")


def load_samples(
    folder: Path | None, size: tuple[int, int] = SIZE, seed: int = 0
) -> dict[str, Sample]:
    """Load two context views and a target of every scene of ``folder``, or of a procedural one."""
    if folder is None:
        scene = datasets.load("procedural", seed=seed, height=size[0], width=size[1])
        names = list(scene.cameras)
        return {"procedural": scene.sample([names[0], names[-1]], names[1:2])}
    scene = datasets.load("nerfstudio", folder)
    return {
        name: scene.sample(context, target[:1], size=size)
        for name, (context, target) in read_pairs(folder / "pairs.json").items()
    }


def read_pairs(file: Path) -> dict[str, tuple[list[str], list[str]]]:
    try:
        pairs = json.loads(file.read_text())
        return {name: (pair["context"], pair["target"]) for name, pair in pairs.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as problem:
        raise InputError(
            f"{file}: {problem!r}; expected a JSON object of scenes, each with the names of its "
            'images as "context" and "target"'
        ) from None
