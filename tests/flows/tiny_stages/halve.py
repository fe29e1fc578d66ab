import time

from tiny_stages import labels, note

STAGE = "halve"
VERSION = 1


def run(store, call):
    """Half, rounded down: 4 and 5 give the same."""
    note(call, STAGE)
    time.sleep(float(call.where.get("sleep", 0)))
    value = int(store.get(call.inputs["made"])["labels"].max())
    return store.put("labels", labels(value // 2))
