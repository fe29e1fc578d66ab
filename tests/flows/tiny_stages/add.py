import time

from tiny_stages import labels, note

STAGE = "add"
VERSION = 1


def run(store, call):
    note(call, STAGE)
    time.sleep(float(call.where.get("sleep", 0)))
    value = int(store.get(call.inputs["half"])["labels"].max())
    return store.put("labels", labels(value + call.settings["more"]))
