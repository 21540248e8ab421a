"""Before the flight: lines, overlap, and the accuracy that may be promised."""
