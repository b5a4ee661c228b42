"""Figures measured beside the ones asked for: `semgraph bench`."""
