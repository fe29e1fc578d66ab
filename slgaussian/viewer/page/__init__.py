"""A scene as a single HTML file, which opens from disk without a network."""
