"""Speed, error, memory and start-up of the rasteriser: tables, and a page with a picture.

    python -m benches.rasterize.speed_and_error [DATA] [-o docs/measured]

DATA holds pairs of photographs; without it, a made-up room is drawn. -o also writes rasterizer.md
and rasterizer.svg.
"""

import argparse
import sys
from pathlib import Path

import torch

from benches.common.pages import publish
from benches.common.photograph_pairs import DATA_HELP, load_samples, photographs
from benches.rasterize import fresh_process, parameter_sweeps
from benches.rasterize.parameter_sweeps import Subject
from benches.rasterize.rasterizer_chart import picture
from slgaussian.errors import InputError
from slgaussian.io import write_atomic
from slgaussian.kernels import threads
from slgaussian.predict.planesweep import PlaneSweep
from slgaussian.scene import Sample

MEASURES = {
    "stages": lambda subject: [parameter_sweeps.stages_row(subject)],
    "thresholds": parameter_sweeps.threshold_rows,
    "counts": parameter_sweeps.count_rows,
    "resolutions": parameter_sweeps.resolution_rows,
    "channels": parameter_sweeps.channel_rows,
    "hard_cases": lambda _: parameter_sweeps.hard_case_rows(),
    "memory": lambda s: fresh_process.memory_rows(s.gaussians, s.values, s.camera),
    "start": lambda s: fresh_process.start_rows(s.gaussians, s.values, s.camera),
}
"""What is measured of one scene: the rows of each table but those of all scenes."""


def parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", nargs="?", type=photographs, metavar="DATA", help=DATA_HELP)
    parser.add_argument("--scene", help="of all sweeps (default: the first of DATA)")
    parser.add_argument(
        "-o", dest="out", type=Path, metavar="FOLDER", help="write rasterizer.md and .svg there"
    )
    return parser.parse_args(arguments)


def subject_of(name: str, sample: Sample) -> Subject:
    """The Gaussians that two photographs predict, with their colours and three random codes."""
    gaussians = PlaneSweep()(sample)
    codes = parameter_sweeps.random_values(len(gaussians), 3)
    values = torch.cat([gaussians.colors(), codes], 1)
    contexts = [view.camera for view in sample.context]
    return Subject(name, gaussians, values, sample.targets[0].camera, contexts)


def run(options: argparse.Namespace) -> None:
    samples = load_samples(options.data)
    chosen = options.scene or next(iter(samples))
    if chosen not in samples:
        raise InputError(f"--scene: found {chosen!r}, expected one of {', '.join(samples)}")
    rows = {"scenes": []}
    for name, sample in samples.items():
        subject = subject_of(name, sample)
        rows["scenes"].append(parameter_sweeps.scene_row(subject))
        if name == chosen:
            swept = subject
    for key, measure in MEASURES.items():
        rows[key] = measure(swept)
        print(f"{key} done", file=sys.stderr, flush=True)
    words = [
        "python -m benches.rasterize.speed_and_error",
        *["DATA"] * bool(options.data),
        "-o docs/measured",
    ]
    file = options.out and options.out / "rasterizer.md"
    publish("rasterize/rasterizer.md.j2", file, rows=rows, scene=chosen, command=" ".join(words))
    if options.out is not None:
        shown = "thresholds", "counts", "resolutions", "channels"
        drawn = picture(*(rows[key] for key in shown))
        write_atomic(options.out / "rasterizer.svg", drawn)


if __name__ == "__main__":
    threads.limit()
    try:
        run(parse(sys.argv[1:]))
    except (InputError, OSError) as problem:
        sys.exit(f"error: {problem}")
