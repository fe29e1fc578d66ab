"""A Prefect flow that calls one function, which is not sent to workers along with it."""

from prefect import flow

from flows.runners.batches import state_after
from flows.runners.session import final

WORK = []
"""Functions to call. Prefect sends the flow to workers by value, and what it calls by name."""


def take_work():
    return WORK.pop()()


@flow(name="tiny", persist_result=False)
def tiny_flow():
    return final(state_after("done", take_work(), (), nothing_left=False))
