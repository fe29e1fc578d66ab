"""Prefect flows and the command line: which stages run on which scenes, and what people see."""
