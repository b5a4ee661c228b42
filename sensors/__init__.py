"""Sensor control and pre-processing: what a device or a log says, as measurements."""
