"""A flow of tiny stages: imported by the tests, and run as a program by those that kill it."""

import io
import sys
from functools import partial
from pathlib import Path

from flows.progress import Progress
from slgaussian.store import ArtifactStore


def chain_plan(value: int, more: int, log: Path, sleep: float = 0.0):
    from tasks.shard import Step

    where = {"log": str(log), "sleep": str(sleep)}
    return [
        Step("make", {"value": value}, {}, where, "tiny_stages"),
        Step("halve", {}, {"made": "make"}, where, "tiny_stages"),
        Step("add", {"more": more}, {"half": "halve"}, where, "tiny_stages"),
    ]


def run_tiny(
    store: ArtifactStore, plans: dict, workers: int = 2, stream=None, runner: str = "threads"
):
    """Run ``{scene: its steps}``; returns the outcome."""
    from flows.chains import run_chains, run_flow
    from tasks.shard import Chain, given

    progress = Progress(len(plans), 3, stream=stream or io.StringIO())
    chains = [Chain(scene, partial(given, plan), first="make") for scene, plan in plans.items()]
    outcome = run_flow(
        "tiny", lambda crew: run_chains(chains, crew, progress), store, runner, workers
    )
    progress.summary()
    return outcome


if __name__ == "__main__":
    from flows.environment import interruptible, orchestration

    store, log, sleep, runner = ArtifactStore(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:5]
    with interruptible(), orchestration(store) as ready:
        ready()
        plans = {f"scene_{i}": chain_plan(10 * i + 4, 1, log, float(sleep)) for i in range(3)}
        run_tiny(store, plans, stream=sys.stderr, runner=runner)
