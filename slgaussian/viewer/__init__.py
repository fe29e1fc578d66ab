"""Viewer of a scene in the browser, which answers texts and clicks."""
