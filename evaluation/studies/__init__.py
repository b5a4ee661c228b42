"""Estimators on the same data, many times: trials, their execution, and what they say together."""
