"""Which sources decide whether kernels are compiled again."""

import re
from pathlib import Path

import slgaussian

PACKAGE = Path(slgaussian.__file__).parent


def test_every_module_with_a_kernel_imports_numba_at_its_top():
    """By that the digest of :func:`slgaussian.kernels.threads.sources` knows it."""
    kernels = re.compile(rb"^@((numba\.)?njit|intrinsic)", re.MULTILINE)
    for file in PACKAGE.rglob("*.py"):
        source = file.read_bytes()
        if kernels.search(source):
            assert re.search(rb"^(import|from) numba\b", source, re.MULTILINE), file
