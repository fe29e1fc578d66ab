"""Made-up rooms, ray-cast: exact depth, ids and phrases, and a reader that makes scenes of them."""
