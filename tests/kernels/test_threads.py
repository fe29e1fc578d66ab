"""Outputs of networks do not depend on threads, nor on the alignment of weights."""

import re
import threading
from pathlib import Path

import pytest
import torch
from torch.nn import functional as F

from slgaussian.kernels import threads


def place_at_offset(values: torch.Tensor, offset: int) -> torch.Tensor:
    """The same values, ``offset`` floats past a boundary of 64 bytes."""
    room = torch.empty(values.numel() + 32)
    start = -(room.data_ptr() // 4) % 16 + offset
    place = room[start : start + values.numel()].view(values.shape)
    return place.copy_(values)


@pytest.mark.parametrize("rows", [1, 3, 9, 50])
@pytest.mark.parametrize("side", [24, 64, 512])
def test_linear_is_equal_for_any_alignment_of_weights(rows, side):
    state = torch.Generator().manual_seed(rows)
    x = torch.randn(rows, side, generator=state)
    weights, bias = torch.randn(side, side, generator=state), torch.randn(side, generator=state)
    with threads.limit_threads(1):
        result = [
            F.linear(x, place_at_offset(weights, i), place_at_offset(bias, i))
            for i in (0, 1, 2, 4, 7)
        ]
        result += [F.linear(place_at_offset(x, i), weights, bias) for i in (1, 2, 4, 7)]
    assert all(torch.equal(result[0], second) for second in result)


class Small(torch.nn.Module):
    """Layers whose sums PyTorch and its libraries split by the number of threads."""

    def __init__(self, waste: int = 0) -> None:
        super().__init__()
        with torch.random.fork_rng():
            torch.manual_seed(0)
            self.point, self.wide = torch.nn.Conv2d(10, 32, 1), torch.nn.Conv2d(32, 5, 3)
            self.last = torch.nn.Linear(5 * 62 * 62, 7)
        self.waste = torch.nn.Parameter(torch.zeros(waste), requires_grad=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.last(self.wide(self.point(x)).flatten(1)) + x.sum()


@pytest.fixture
def sizes():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.mark.usefixtures("sizes")
@pytest.mark.parametrize("waste", [0, threads.LARGE_NETWORK])
def test_network_is_equal_for_any_number_of_threads(waste):
    network, result = Small(waste), []
    x = torch.randn(2, 10, 64, 64, generator=torch.Generator().manual_seed(1))
    for count in (1, 2, 3, 8):
        torch.set_num_threads(count)
        with torch.inference_mode(), threads.inside(network):
            assert torch.get_num_threads() == (threads.LARGE_NETWORK_THREADS if waste else 1)
            result.append(network(x))
        assert torch.get_num_threads() == count
    assert all(torch.equal(result[0], second) for second in result)


@pytest.mark.usefixtures("sizes")
def test_fixed_threads_are_of_the_calling_thread_alone():
    view, (ready, inside, done) = {}, (threading.Event() for _ in range(3))

    def second():
        view["before"] = torch.get_num_threads()
        ready.set()
        inside.wait()
        view["while"] = torch.get_num_threads()
        done.set()

    torch.set_num_threads(2)
    worker = threading.Thread(target=second)
    worker.start()
    ready.wait()
    with threads.limit_threads(3):
        inside.set()
        done.wait()
        assert torch.get_num_threads() == 3
    worker.join()
    assert view == {"before": 2, "while": 2}


def test_modules_with_kernels_import_their_compiler_at_the_top():
    """The digest of :func:`slgaussian.kernels.threads.sources` relies on it."""
    kernels = re.compile(rb"^@(kernel|(numba\.)?njit|intrinsic)\b", re.MULTILINE)
    for file in Path(threads.__file__).parents[1].rglob("*.py"):
        source = file.read_bytes()
        if kernels.search(source):
            made_by = rb"^(import|from) (numba|slgaussian\.kernels\.jit)\b"
            assert re.search(made_by, source, re.MULTILINE), file
