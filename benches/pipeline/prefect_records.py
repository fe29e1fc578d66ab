"""What a record of Prefect's own cache may do to who reads it, and what a cached task costs.

    python -m benches.pipeline.prefect_records

A task whose result is a small ref and whose serialiser is pinned to JSON is run twice: the second
time its record is read. Then the record is changed as anybody could who may write to the store, and
read once more. Last, milliseconds of a task that ends in the state `Cached`, as stages do.
"""

import base64
import json
import os
import pickle
import tempfile
import time
from pathlib import Path

from flows.runners.environment import orchestration
from slgaussian.storage.store import ArtifactStore

REF = {"spec": "gaussians", "uri": f"gaussians/aa/{'a' * 64}.npz", "digest": "a" * 64}
ROUNDS = 200


class Payload:
    """What runs a harmless command when it is unpickled."""

    def __reduce__(self):
        return os.system, ("echo '  code of the record has run'",)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, orchestration(ArtifactStore(folder)) as ready:
        from prefect import Task, flow
        from prefect.cache_policies import NO_CACHE
        from prefect.serializers import JSONSerializer
        from prefect.states import Completed

        ready()
        pinned = JSONSerializer(object_encoder=None, object_decoder=None)
        kept = Task(
            lambda: REF,
            name="kept",
            cache_key_fn=lambda context, arguments: "the-key",
            persist_result=True,
            result_serializer=pinned,
        )
        cached = Task(lambda: Completed(name="Cached"), cache_policy=NO_CACHE)

        @flow
        def work() -> None:
            kept()
            kept()
            (record,) = (file for file in Path(folder).rglob("the-key") if file.is_file())
            content = json.loads(record.read_bytes())
            serializer = content["metadata"]["serializer"]["type"]
            print(f"record: {record.stat().st_size} bytes, serialiser {serializer}")
            content["metadata"]["serializer"] = {"type": "pickle"}
            content["result"] = base64.encodebytes(pickle.dumps(Payload())).decode()
            record.write_text(json.dumps(content))
            print("the same task, its record changed:", flush=True)
            kept()
            start = time.perf_counter()
            for _ in range(ROUNDS):
                cached()
            print(f"a cached task: {1000 * (time.perf_counter() - start) / ROUNDS:.1f} ms")

        work()


if __name__ == "__main__":
    main()
