"""The graph beside the fast estimator: from sightings to a smoothed trajectory and map."""
