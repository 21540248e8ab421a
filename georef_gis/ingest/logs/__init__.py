"""Logs of a flight: readers that turn files into `FlightLogs`, and their cleaning."""
