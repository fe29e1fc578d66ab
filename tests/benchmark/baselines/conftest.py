"""Inputs of methods: the room of the benchmark's tests."""

from dataclasses import replace

import pytest

from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.masks import load_proposer


@pytest.fixture(scope="session")
def room_inputs(room) -> Inputs:
    """Inputs shared by tests that do not check what is computed once and cached."""
    data = room.sample, room.field, room.gaussians, room.label_maps
    return Inputs(*data, load_proposer("regions"))


@pytest.fixture
def fresh(room_inputs) -> Inputs:
    """Return the same inputs without cached results."""
    return replace(room_inputs)
