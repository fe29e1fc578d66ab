"""Prefect tasks, one module a stage: load refs, call the library, store, return a ref.

A stage module has ``STAGE``, its name; ``VERSION``, raised by hand whenever the same settings and
inputs would give another result; and ``run(store, call) -> ArtifactRef``.
"""
