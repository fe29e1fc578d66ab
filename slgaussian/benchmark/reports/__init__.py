"""Reports: one model of sections and tables, rendered to HTML, Markdown and the terminal."""
