"""What holds for all tests."""

from __future__ import annotations

from hypothesis import settings

# a time limit for each example would fail on a busy machine; nothing here is a timed test
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")
