"""Stages that are sent to workers: threads, processes or other machines."""

import pickle
import pkgutil
from importlib import import_module

import cloudpickle
import pytest

import tasks
from tasks.stage import Stage

MODULES = [import_module(f"tasks.{module.name}") for module in pkgutil.iter_modules(tasks.__path__)]
STAGES = {stage.name: stage for m in MODULES for stage in vars(m).values() if type(stage) is Stage}


@pytest.mark.parametrize("pickler", [pickle, cloudpickle])
def test_a_stage_goes_by_its_name_whatever_its_module_holds(pickler):
    assert {"ingest", "field", "report", "train"} <= STAGES.keys()
    for stage in STAGES.values():
        sent = pickler.dumps(stage)
        assert pickle.loads(sent) is stage and len(sent) < 100
