"""Protocols and scores: labelled truth, metrics, evaluation of a field, pictures and the report."""
