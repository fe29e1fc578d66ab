"""Which sources decide whether kernels are compiled again."""

import re
from pathlib import Path

import slgaussian

PACKAGE = Path(slgaussian.__file__).parent


def test_every_module_with_a_kernel_imports_what_makes_it_one_at_its_top():
    """By that the digest of :func:`slgaussian.kernels.threads.sources` knows it."""
    kernels = re.compile(rb"^@(kernel|(numba\.)?njit|intrinsic)\b", re.MULTILINE)
    for file in PACKAGE.rglob("*.py"):
        source = file.read_bytes()
        if kernels.search(source):
            made_by = rb"^(import|from) (numba|slgaussian\.kernels\.jit)\b"
            assert re.search(made_by, source, re.MULTILINE), file
