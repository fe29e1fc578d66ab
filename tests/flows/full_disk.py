"""A program of the tests: runs of tiny stages on a disk that fills and is then emptied.

Its argument is a folder to mount a small disk on, which needs a mount namespace of its own.
"""

import errno
import json
import subprocess
import sys
from pathlib import Path

from tiny_run import run_tiny, three_scenes

from slgaussian.storage.store import ArtifactStore, StoreError

disk = Path(sys.argv[1])
subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", disk], check=True)
store, filler = ArtifactStore(disk), disk / "filler"
told = []
for pages_left in (0, 12, None):
    with filler.open("wb", buffering=0) as file:
        try:
            while pages_left is not None:
                file.write(bytes(4096))
        except OSError as error:
            assert error.errno == errno.ENOSPC
            file.truncate(file.tell() - 4096 * pages_left)
    refs, stopped = {}, ""
    try:
        refs = run_tiny(store, three_scenes(disk.parent / "log"), 1).refs
    except StoreError as error:
        stopped = str(error)
    told.append(
        {
            "refs": {s: {k: r.digest for k, r in output.items()} for s, output in refs.items()},
            "stopped": stopped,
            "unfinished": [str(file) for file in disk.rglob("*.tmp")],
        }
    )
print(json.dumps(told))
