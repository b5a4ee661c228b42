"""Estimators side by side, each by name, for studies."""
