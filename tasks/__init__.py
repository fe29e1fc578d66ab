"""Stages: each loads refs, calls the library, stores one artifact and returns its ref.

A stage is a function under :func:`tasks.stage.stage` with a name and a version, which is raised by
hand whenever the same settings and inputs would give another result.
"""
