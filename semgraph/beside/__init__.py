"""The graph in this process or in one of its own, with a queue that is its log."""
