"""Environment perception: measurements in, perceptions of trees, rocks and markers out."""
