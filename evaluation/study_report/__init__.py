"""A study as one page: a self-contained HTML file with figures, tables and each trial."""
