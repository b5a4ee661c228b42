"""Judges what came out. The only place where truth is looked at."""
