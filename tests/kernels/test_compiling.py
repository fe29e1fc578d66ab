"""Who waits for kernels to be compiled is told so, and nobody else."""

import logging
import os
import subprocess
import sys
import time

import numba
import pytest

from slgaussian.kernels import compiling
from tests.flows.command import two_walls

FIRST_USE = """
from slgaussian.kernels import compiling
compiling.SILENT = 0.0
from flows.cli.app import main
main()
"""


@pytest.fixture
def at_once(monkeypatch):
    monkeypatch.setattr(compiling, "SILENT", 0.0)
    monkeypatch.setattr(compiling, "AGAIN", 0.0)
    monkeypatch.setattr(compiling._Watch, "warned", False)
    compiling.watch()


def new_kernel():
    @numba.njit
    def twice(x):
        return 2 * x

    return twice


def test_a_kernel_is_told_while_it_is_compiled_and_never_again(at_once):
    kernel, report = new_kernel(), []
    with compiling.report_to(report.append):
        kernel(1)
        assert report[0].startswith("compiling kernels for this processor, once")
        # Whole on a terminal of 80 columns, though there may be hundreds.
        assert " s" in report[0] and len(report[0]) < 76
        assert report[-1] == ""
        del report[:]
        kernel(2)
        assert report == []
    new_kernel()(1)
    assert report == []


def test_a_program_without_a_listener_is_warned_once(at_once, caplog, monkeypatch):
    # What flows.runners, once imported, sends elsewhere.
    monkeypatch.setattr(logging.getLogger("slgaussian"), "propagate", True)
    for _ in range(2):
        new_kernel()(1)
    # A record may be caught by handlers of several loggers.
    (message,) = {id(r): r for r in caplog.records if r.name == compiling.__name__}.values()
    assert message.levelno == logging.WARNING and "takes up to a minute" in message.message


@pytest.mark.whole
def test_the_first_command_says_so_and_the_second_does_not(tmp_path):
    """A command with few kernels."""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    words = ["objects", "list", str(two_walls(tmp_path / "field")), "--json"]
    message = []
    for _ in range(2):
        output = subprocess.run(
            [sys.executable, "-c", FIRST_USE, *words],
            env=env, capture_output=True, text=True,
        )  # fmt: skip
        assert output.returncode == 0, output.stderr
        message.append(output.stderr)
    assert "compiling kernels for this processor, once" in message[0]
    assert "compiling" not in message[1]


def test_the_clock_stands_still_while_a_kernel_is_compiled():
    compiling.watch()
    kernel, spent, start, ticks = (
        new_kernel(),
        compiling.spent(),
        time.perf_counter(),
        compiling.clock(),
    )
    kernel(1)
    took, counted = time.perf_counter() - start, compiling.clock() - ticks
    compiled = compiling.spent() - spent
    assert 0 < compiled < took and counted == pytest.approx(took - compiled, abs=1e-3)
