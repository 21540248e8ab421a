"""A site of which all maps of these tests are made."""

import numpy as np
import pytest
from change_cases import Image, ground


@pytest.fixture(scope="session")
def site() -> Image:
    return ground(np.random.default_rng(5), 30.0)
