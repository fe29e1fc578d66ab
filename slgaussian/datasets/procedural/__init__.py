"""Procedural rooms with exact depth, object ids and phrases, rendered by ray casting."""
