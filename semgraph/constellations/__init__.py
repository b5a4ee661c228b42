"""Where a group of landmarks stands in a map, without any prior."""
