"""Components of the method: registry, configs, loading, identity by settings and file contents."""
