"""Values made ahead by threads: the same as without."""

from __future__ import annotations

import time

import pytest

from georef_gis.mosaic.ahead import made_ahead


@pytest.mark.parametrize("workers", [1, 2, 7])
def test_values_come_in_the_order_of_the_items(workers: int) -> None:
    def late(k: int) -> int:
        # the first take longest
        time.sleep(0.002 * (k < 5))
        return k * k

    assert list(made_ahead(late, range(40), workers)) == [k * k for k in range(40)]


@pytest.mark.parametrize(("workers", "most"), [(1, 1), (2, 5), (3, 7)])
def test_few_are_made_before_they_are_taken(workers: int, most: int) -> None:
    made = []
    values = made_ahead(lambda k: made.append(k) or k, iter(range(100)), workers)
    for taken in range(20):
        next(values)
        assert len(made) <= taken + most
    values.close()


@pytest.mark.parametrize("workers", [1, 3])
def test_a_failure_is_told_and_ends_the_work(workers: int) -> None:
    made = []

    def fails(k: int) -> int:
        made.append(k)
        if k == 5:
            raise ValueError("broken")
        return k

    with pytest.raises(ValueError, match="broken"):
        list(made_ahead(fails, range(1000), workers))
    assert len(made) < 20
