"""One lexicon for all tests: it has no state beyond its tables."""

import pytest

from slgaussian.language import load_encoder
from slgaussian.language.lexicon import Lexicon


@pytest.fixture(scope="session")
def lexicon() -> Lexicon:
    return load_encoder("lexicon")
