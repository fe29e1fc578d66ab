"""Execution of flows: workers, server and progress."""

import logging

# Prefect adds its handler to the logger ``slgaussian`` (PREFECT_LOGGING_EXTRA_LOGGERS), so that its
# page shows what a run logs; the handler of the root logger would print the same on the terminal.
_package = logging.getLogger("slgaussian")
_package.addHandler(logging.NullHandler())
_package.propagate = False
_package.setLevel(logging.INFO)

logger = logging.getLogger("slgaussian.run")
"""Logger of runs."""
