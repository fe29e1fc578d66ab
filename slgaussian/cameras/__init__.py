"""Poses and focal lengths, and what the photographs themselves say of them."""
