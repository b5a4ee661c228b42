"""Refinement: all that runs measured in one graph, prior maps, sessions."""
