"""Components of the method: found by name, configured, loaded, known by what they depend on."""
