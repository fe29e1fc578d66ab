"""One page to send: a scene in a single HTML file that opens from disk, without a network."""
