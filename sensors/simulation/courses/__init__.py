"""Simulated courses: a world, a way through it, and what devices measure on the way."""
