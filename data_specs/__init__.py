"""What the data look like: one TOML file a spec. :mod:`slgaussian.storage.specs` reads them."""
