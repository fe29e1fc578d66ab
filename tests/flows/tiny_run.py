"""A flow of tiny stages: imported by the tests, and run as a program by those that kill it."""

import io
import sys
from pathlib import Path

from flows.progress import Progress
from slgaussian.store import ArtifactStore


def chain_plan(value: int, more: int, log: Path, sleep: float = 0.0):
    from flows.chains import Step

    where = {"log": str(log), "sleep": str(sleep)}
    return [
        Step("make", {"value": value}, {}, where, "tiny_stages"),
        Step("halve", {}, {"made": "make"}, where, "tiny_stages"),
        Step("add", {"more": more}, {"half": "halve"}, where, "tiny_stages"),
    ]


def run_tiny(store: ArtifactStore, plans: dict, workers: int = 2, stream=None):
    """Run ``{scene: callable giving steps}``; returns the outcome."""
    from prefect import flow
    from prefect.task_runners import ThreadPoolTaskRunner

    from flows.chains import Chain, run_chains
    from tasks.stage import stage_task, using

    progress = Progress(len(plans), 3, stream=stream or io.StringIO())

    @flow(task_runner=ThreadPoolTaskRunner(max_workers=workers), persist_result=False)
    def tiny():
        with using(store):
            chains = [Chain(scene, plan, first="make") for scene, plan in plans.items()]
            return run_chains(stage_task(), chains, workers, progress)

    outcome = tiny()
    progress.summary()
    return outcome


if __name__ == "__main__":
    from flows.environment import orchestration

    store, log, sleep = ArtifactStore(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3])
    with orchestration(store) as ready:
        ready()
        plans = {f"scene_{i}": lambda i=i: chain_plan(10 * i + 4, 1, log, sleep) for i in range(3)}
        run_tiny(store, plans, stream=sys.stderr)
