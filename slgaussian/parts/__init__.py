"""Parts of the method: found by name, their settings, their files and what those are known by."""
