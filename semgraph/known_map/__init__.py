"""How well poses explain a scan in a known map: the parts of particle filter and localizer."""
