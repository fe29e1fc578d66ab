"""A flow of tiny stages: called by tests, and run as a program by tests that kill it."""

import io
import sys
from pathlib import Path

from slgaussian.storage.store import ArtifactStore


def tiny(value: int, extra: int, log: Path, sleep: float = 0.0, **effects: str) -> tuple:
    """Arguments of :func:`tiny_stages.tiny_pipeline`; its ``note`` reads the effects."""
    return value, extra, {"log": str(log), "sleep": str(sleep), **effects}


def run_tiny(
    store: ArtifactStore,
    scenes: dict[str, tuple],
    workers: int = 2,
    stream=None,
    runner: str = "threads",
    progress=None,
    refresh: tuple[str, ...] = (),
    max_failures: float = 1e9,
):
    """Run ``{scene: arguments of its pipeline}``; returns the outcome."""
    from tiny_flow import WORK, tiny_flow

    from flows.config import Engine
    from flows.runners.batches import SceneTask, map_scenes
    from flows.runners.environment import call_flow
    from flows.runners.progress import Progress
    from flows.runners.task_runners import open_workers

    progress = progress or Progress(len(scenes), 3, stream=stream or io.StringIO())

    def work():
        from tiny_stages import tiny_pipeline

        scene_tasks = [
            SceneTask(scene, tiny_pipeline, arguments, first="make")
            for scene, arguments in scenes.items()
        ]
        limits = {"refresh": list(refresh), "max_failures": max_failures}
        with open_workers(Engine(runner=runner, workers=workers, **limits), store) as opened:
            return map_scenes(scene_tasks, opened, progress)

    WORK.append(work)
    return call_flow(tiny_flow)


def three_scenes(log: Path, sleep: float = 0.0) -> dict[str, tuple]:
    """Three scenes, the second one slow."""
    return {f"scene_{i}": tiny(10 * i + 4, 1, log, sleep if i == 1 else 0.0) for i in range(3)}


if __name__ == "__main__":
    from flows.runners.environment import interruptible, orchestration

    store, log, sleep, runner = ArtifactStore(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:5]
    with interruptible(), orchestration(store) as ready:
        ready()
        run_tiny(store, three_scenes(log, float(sleep)), 1, sys.stderr, runner)
