"""The stages of a chunk one by one, as :func:`flows.corpus.supervise_chunk` calls them."""

from collections.abc import Iterator, Mapping
from typing import Any

from prefect import flow
from prefect.states import Completed, State

from flows.config import CorpusSettings
from flows.runners.batches import Outcome, SceneTask, map_scenes
from flows.runners.progress import Progress
from flows.runners.task_runners import open_workers
from slgaussian.components.method import Method
from slgaussian.datasets import re10k
from slgaussian.datasets.pair_selection import Bounds
from slgaussian.io import KnownFile
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.chunks import Framing, known_chunk, pairs, views
from tasks.context import current_run
from tasks.predictions import predictions
from tasks.samples import lessons
from tasks.stage import Stage, canonical


def chunk_stages(
    chunk: KnownFile,
    bounds: Bounds,
    framing: Framing,
    method: Method,
    refs: Mapping[str, ArtifactRef],
) -> Iterator[tuple[Stage, dict[str, Any]]]:
    """Each stage with its arguments; ``refs`` must hold what those before it made by then."""
    seen = {"chunk": chunk, "framing": framing}
    masked = {"proposer": method.proposer, "tracker": method.tracker, "replicas": method.replicas}
    yield views, {"chunk": chunk}
    yield pairs, {"views": refs["views"], "bounds": bounds}
    predicted = {"predictor": method.predictor, "seed": method.seed}
    yield predictions, {"pairs": refs["pairs"], **seen, **predicted}
    yield lessons, {"pairs": refs["pairs"], "predictions": refs["predictions"], **seen, **masked}


def settings_of(stage: Stage, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """What an artifact says of the arguments that made it."""
    return {
        name: canonical(value, name)
        for name, value in arguments.items()
        if name not in stage.unkeyed and not isinstance(value, ArtifactRef)
    }


def take_stages(file: str, bounds: Bounds, framing: Framing, method: Method, last: str) -> None:
    """Take a chunk through its pipeline as far as stage ``last``."""
    refs: dict[str, ArtifactRef] = {}
    chunk = known_chunk(current_run().store, file)
    for stage, arguments in chunk_stages(chunk, bounds, framing, method, refs):
        refs[stage.name] = stage(**arguments)
        if stage.name == last:
            return


@flow(name="chunks", persist_result=False)
def take_chunks(config: CorpusSettings, last: str) -> State[Outcome]:
    """Take all chunks of a corpus through their pipeline as far as stage ``last``."""
    store, bounds = ArtifactStore(config.store), Bounds(**config.bounds())
    more = Framing(config.size, config.near, config.far), config.built_by, last
    tasks = [
        SceneTask(chunk, take_stages, (f"{config.chunks}/{chunk}", bounds, *more), views.name)
        for chunk in re10k.chunk_names(config.chunks)
    ]
    with (
        open_workers(config.runner, config.workers, store) as workers,
        Progress(len(tasks), 1, unit="chunks") as progress,
    ):
        outcome = map_scenes(tasks, workers, progress)
    return Completed(data=outcome)
