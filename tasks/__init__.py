"""Stages: each loads refs, calls the library, stores one artifact and returns its ref.

A stage is a function decorated by :func:`tasks.stage.stage` with a name and a version, which is
increased by hand whenever the same settings and inputs give another result.
"""
