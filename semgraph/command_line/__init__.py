"""What each command does; `semgraph/cli.py` calls it."""
