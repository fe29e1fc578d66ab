"""The stages of a chunk one by one: the road that :func:`flows.corpus.supervise_chunk` takes."""

from collections.abc import Iterator, Mapping
from typing import Any

from slgaussian.datasets.pairs import Bounds
from slgaussian.parts.identity import KnownFile
from slgaussian.parts.method import Method
from slgaussian.storage.store import ArtifactRef
from tasks.chunks import Framing, known_chunk
from tasks.keys import canonical
from tasks.lessons import lessons
from tasks.pairs import pairs
from tasks.predictions import predictions
from tasks.stage import Stage, current
from tasks.views import views


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


def take_road(file: str, bounds: Bounds, framing: Framing, method: Method, last: str) -> None:
    """Take a chunk down its road as far as stage ``last``."""
    refs: dict[str, ArtifactRef] = {}
    chunk = known_chunk(current().store, file)
    for stage, arguments in chunk_stages(chunk, bounds, framing, method, refs):
        refs[stage.name] = stage(**arguments)
        if stage.name == last:
            return
