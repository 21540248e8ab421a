"""Calibration of cameras on boards and target fields, and of their mount while standing."""
