"""Prefect flows and the command line: which stages run on which scenes, and their output."""
