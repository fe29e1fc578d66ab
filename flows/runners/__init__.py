"""Who does the work of a flow and what is told of it: workers, server, progress, schedule."""
