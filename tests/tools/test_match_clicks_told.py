"""`georef match-clicks` warns of points by their names."""

from __future__ import annotations

from pathlib import Path

from work_zone_cases import posed_site


def test_points_that_were_not_found_are_not_called_photos(tmp_path: Path) -> None:
    from tool_cases import georef

    site = posed_site(tmp_path / "site", photos=2)
    name = site.photos[0].name
    # beside each other amid the picture, and two clicks that are nowhere
    pixels = [f"{name}:{where}" for where in ("99999,5", "99999,6", "600,400")]
    words = [word for pixel in pixels for word in ("--pixel", pixel)]
    done = georef("match-clicks", "--project", site.folder, *words)
    assert done.code == 0, done.text
    done.line("warning: 2 points (1, 2): ", "99999, 5 to 6", "lies outside")
    assert " photos (" not in done.text
