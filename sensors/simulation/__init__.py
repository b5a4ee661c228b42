"""Seeded courses that produce the measurements a real robot would have had."""
