"""Execution of flows: workers, server, progress and log."""
