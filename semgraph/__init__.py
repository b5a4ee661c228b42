"""Landmark SLAM: world model, localization and graph."""
