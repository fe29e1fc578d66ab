import time

from slgaussian.errors import InputError
from tiny_stages import labels, note

STAGE = "make"
VERSION = 1


def run(store, call):
    note(call, STAGE)
    time.sleep(float(call.where.get("sleep", 0)))
    value = call.settings["value"]
    if value < 0:
        raise InputError(f"value {value}: expected a positive number")
    if value == 666:
        raise ZeroDivisionError("a defect")
    return store.put("labels", labels(value))
