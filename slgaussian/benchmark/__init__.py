"""Evaluation: ground truth, protocols, metrics, statistics, baselines, and the report."""
