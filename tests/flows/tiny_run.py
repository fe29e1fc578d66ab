"""A flow of tiny stages: imported by the tests, and run as a program by those that kill it."""

import io
import sys
from functools import partial
from pathlib import Path

from flows.runners.progress import Progress
from slgaussian.storage.store import ArtifactStore


def chain_plan(value: int, more: int, log: Path, sleep: float = 0.0, **where: str):
    """The steps of a scene; ``where`` is as :func:`tiny_stages.note` reads it."""
    from tasks.shard import Step

    where = {"log": str(log), "sleep": str(sleep), **where}
    return [
        Step("make", {"value": value}, {}, where, "tiny_stages"),
        Step("halve", {}, {"made": "make"}, where, "tiny_stages"),
        Step("add", {"more": more}, {"half": "halve"}, where, "tiny_stages"),
    ]


def run_tiny(
    store: ArtifactStore,
    plans: dict,
    workers: int = 2,
    stream=None,
    runner: str = "threads",
    progress: Progress | None = None,
):
    """Run ``{scene: its steps}``; returns the outcome."""
    from flows.runners.worker_pool import run_chains, run_flow
    from tasks.shard import Chain, given

    progress = progress or Progress(len(plans), 3, stream=stream or io.StringIO())
    chains = [Chain(scene, partial(given, plan), first="make") for scene, plan in plans.items()]
    outcome = run_flow(
        "tiny", lambda crew: run_chains(chains, crew, progress), store, runner, workers
    )
    progress.summary()
    return outcome


def three_plans(log: Path, sleep: float = 0.0) -> dict:
    """Three scenes, the second one slow."""
    slow = {"scene_1": sleep}
    names = ("scene_0", "scene_1", "scene_2")
    return {
        name: chain_plan(10 * i + 4, 1, log, slow.get(name, 0.0)) for i, name in enumerate(names)
    }


if __name__ == "__main__":
    from flows.runners.environment import interruptible, orchestration

    store, log, sleep, runner = ArtifactStore(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:5]
    with interruptible(), orchestration(store) as ready:
        ready()
        run_tiny(store, three_plans(log, float(sleep)), 1, sys.stderr, runner)
