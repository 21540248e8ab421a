"""What is refused in one line, what is doubted, and which wrong mark is found."""

from __future__ import annotations

import math
from dataclasses import replace

import measure_scenes as scenes
import numpy as np
import pytest

from georef_gis.errors import GeometryError
from georef_gis.frames import exp_so3
from georef_gis.measure.points import (
    Mark,
    MeasuredPoints,
    intersect_points,
    locate_points,
)
from georef_gis.measure.scene import Scene
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import FlatTerrain, Terrain, dem_terrain
from georef_gis.model.tin import EnuPlane

FLAT = FlatTerrain(origin=scenes.ORIGIN, height_ellipsoidal=277.6, sigma=0.5)


def looking(pitch_deg: float) -> OrientedPhoto:
    """Photo A whose camera is turned up about its right axis; 0 looks down, 90 at the horizon."""
    (one, *_) = scenes.oriented()
    pose = replace(one.pose, R_enu_from_cam=exp_so3([math.radians(pitch_deg), 0, 0]) @ scenes.NADIR)
    return replace(one, pose=pose, camera=replace(one.camera, k1=0, k2=0, p1=0, readout_s=0))


def over(terrain: Terrain, *photos: OrientedPhoto) -> Scene:
    return Scene.of(scenes.FRAME, terrain, photos)


def small_dem() -> Terrain:
    """Ground of 40 m about the origin only."""
    frame = EnuPlane(origin=scenes.ORIGIN, level=277.6)
    return dem_terrain(
        frame,  # type: ignore[arg-type]
        np.full((20, 20), 277.6), left=-20.0, top=20.0, cell=(2.0, 2.0), metres_per_unit=1.0,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("scene", "mark", "line"),
    [
        (over(FLAT, looking(0)), ("A", 4000.0, 10.0),
         r"P: photo A: pixel \(4000, 10\) lies outside 4000 x 3000 px"),
        (over(FLAT, looking(0)), ("A", math.nan, 10.0), "lies outside"),
        (over(FLAT, looking(0)), ("Z", 5.0, 5.0), "P: photo Z has no pose; .* `georef check`"),
        (over(FLAT, looking(90)), ("A", 2000.0, 100.0),
         r"does not look at the ground but \d+\.\d deg above the horizon; click on the ground"),
        (over(small_dem(), looking(40)), ("A", 2000.0, 1400.0),
         "its ray leaves the terrain .* a larger DEM"),
    ],
    ids=["outside", "no number", "no pose", "sky", "beyond the terrain"],
)  # fmt: skip
def test_a_click_that_shows_no_place_is_refused_in_one_line(
    scene: Scene, mark: tuple[str, float, float], line: str
) -> None:
    wrong = Mark(name="P", photo=mark[0], u=mark[1], v=mark[2])
    with pytest.raises(GeometryError, match=line) as caught:
        locate_points(scene, [wrong])
    assert "\n" not in str(caught.value)
    good = Mark(name="G", photo="A", u=2010.0, v=2900.0)
    found = locate_points(scene, [wrong, good], on_fail="skip")
    assert found.names == ("G",)
    assert list(found.refused) == ["P"]


def test_a_camera_below_the_ground_is_told_with_its_depth() -> None:
    deep = replace(FLAT, height_ellipsoidal=350.0)
    with pytest.raises(GeometryError, match=r"photo A: its projection centre lies 1\d.\d m below"):
        locate_points(over(deep, looking(0)), [Mark(name="", photo="A", u=9.0, v=9.0)])


def test_a_grazing_view_is_doubted_and_its_sigma_is_long_along_the_view() -> None:
    found = locate_points(over(FLAT, looking(80)), [Mark(name="P", photo="A", u=2010.0, v=1200.0)])
    ((line,),) = found.doubts
    assert line.startswith("seen under")
    sigma = np.sqrt(np.diag(found.covariance_of(0)))
    # north is along the view; the ground's 0.5 m over 5 deg alone are 6 m
    assert sigma[1] > 4.0 > sigma[0]


def test_marks_without_a_name_are_numbered_and_doubts_of_the_photo_come_along() -> None:
    scene = replace(over(FLAT, looking(0)), doubts={"A": ["heading unknown"]})
    found = locate_points(scene, [Mark(name="", photo="A", u=u, v=1400.0) for u in (9.0, 99.0)])
    assert found.names == ("1", "2")
    assert found.doubts == (("photo A: heading unknown",),) * 2
    assert [point.method for point in found] == ["locate", "locate"]
    assert math.isnan(found[0].sigma0)
    assert (found[0].dof, found[0].n_rays) == (0, 1)


def test_the_slope_is_taken_over_what_the_place_is_unsure_of() -> None:
    """A bank of 2 m within a place's own sigma of metres is no cliff."""
    x = np.arange(-100.0, 100.0)
    heights = np.broadcast_to(277.6 + 2.0 * (x > 0.0), (200, 200)).copy()
    bank = dem_terrain(
        EnuPlane(origin=scenes.ORIGIN, level=277.6),  # type: ignore[arg-type]
        heights, left=-100.5, top=100.0, cell=(1.0, 1.0), metres_per_unit=1.0,
    )  # fmt: skip
    loose = looking(0)
    wide = np.diag([4.0, 4.0, 1.0, 0.0, 0.0, 0.0]) ** 2
    loose = replace(loose, pose=replace(loose.pose, covariance=wide))
    u, v = loose.project(np.array([0.4, -5.0, 1.0]))
    found = locate_points(over(bank, loose), [Mark(name="", photo="A", u=u, v=v)])
    # 2 m of height over +-4 m: 0.25, not 2
    assert np.sqrt(found.covariance_of(0)[2, 2]) < 0.5 * 4.0


# -- intersections ----------------------------------------------------------------------------

PLACE = np.array([1.0, 2.0, 3.0])
OTHERS = {"Q": (np.array([-4.0, 5.0, 0.0]), "ABC"), "R": (np.array([6.0, -3.0, 1.0]), "AB")}


def good_marks(keys: str = "ABC") -> list[Mark]:
    return scenes.marks_of(scenes.oriented(), {"P": (PLACE, keys), **OTHERS})


def shifted(marks: list[Mark], name: str, photo: str, du: float, dv: float) -> list[Mark]:
    return [
        replace(m, u=m.u + du, v=m.v + dv) if (m.name, m.photo) == (name, photo) else m
        for m in marks
    ]


def sharp() -> Scene:
    """Scene with poses good to centimetres, in which a wrong mark stands out."""
    scene = scenes.scene()
    return Scene.of(scene.frame, scene.terrain, scene.photos.photos,
                    covariance=scenes.pose_covariance() * 1e-3)  # fmt: skip


def test_exact_marks_give_the_places_and_their_order() -> None:
    found = intersect_points(scenes.scene(), good_marks())
    assert found.names == ("P", "Q", "R")
    # m; where the iteration stops
    np.testing.assert_allclose(found.p_enu, [PLACE, *(p for p, _ in OTHERS.values())], atol=1e-6)
    assert [(p.n_rays, p.dof) for p in found] == [(3, 3), (3, 3), (2, 1)]
    assert found.doubts == ((), (), ())


@pytest.mark.parametrize("photo", ["A", "B", "C"])
def test_a_wrong_mark_is_told_left_out_and_does_no_harm(photo: str) -> None:
    found = intersect_points(sharp(), shifted(good_marks(), "P", photo, 25.0, 40.0))
    point = found[0]
    assert [k for k, used in zip(point.photo_ids, point.used, strict=True) if not used] == [photo]
    # m; two rays are left, exact ones
    np.testing.assert_allclose(point.p_enu, PLACE, atol=1e-6)
    assert f"the mark in photo {photo} does not fit (w = " in point.doubts[0]
    assert "two rays are left" in point.doubts[1]
    # px; the whole slip is in its residual
    off = point.residuals[point.photo_ids.index(photo)]
    np.testing.assert_allclose(off, [25.0, 40.0], atol=1e-3)
    assert found.doubts[1:] == ((), ())
    assert ("pose", photo) not in point.sensitivity


def test_a_mark_in_the_wrong_half_of_a_photo_does_not_sink_the_point() -> None:
    """So far off that the rays meet behind the cameras with it."""
    marks = good_marks()
    far = [replace(m, u=3990.0, v=30.0) if (m.name, m.photo) == ("P", "B") else m for m in marks]
    point = intersect_points(sharp(), far)[0]
    assert point.n_rays == 2
    np.testing.assert_allclose(point.p_enu, PLACE, atol=1e-6)


def test_two_rays_that_miss_each_other_are_doubted() -> None:
    found = intersect_points(sharp(), shifted(good_marks("AB"), "P", "A", 0.0, 60.0))
    (line,) = found.doubts[0]
    assert line.startswith("the marks in photos A, B do not fit together (w = ")
    assert "a third photo" in line
    assert found[0].n_rays == 2


def test_points_that_cannot_be_told_are_refused_by_name() -> None:
    marks = good_marks()
    lonely = Mark(name="L", photo="A", u=100.0, v=100.0)
    outside = Mark(name="O", photo="B", u=-50.0, v=100.0)
    twice = replace(next(m for m in marks if m.name == "Q"), u=77.0)
    scene = scenes.scene()
    for wrong, line in (
        (lonely, "L: 1 ray gives no point; mark it in two photos or more"),
        (outside, r"O: photo B: pixel \(-50, 100\) lies outside 4000 x 3000 px"),
        (next(m for m in marks if m.name == "Q"), r"Q: marked in photo A twice"),
        (twice, r"Q: marked in photo A twice, .* and \(77, .* remove the wrong one"),
    ):
        with pytest.raises(GeometryError, match=line):
            intersect_points(scene, [*marks, wrong])
    found = intersect_points(scene, [*marks, lonely, outside, twice], on_fail="skip")
    assert found.names == ("P", "Q", "R")
    assert set(found.refused) == {"L", "O"}
    assert found.doubts[1][0].startswith("left out: Q: marked in photo A twice")


def test_nearly_parallel_rays_are_refused() -> None:
    (one, *_) = scenes.oriented()
    beside = replace(
        one, photo=replace(one.photo, id="A2"),
        pose=replace(one.pose, origin_enu=one.pose.origin_enu + np.array([0, 0, 1e-3])),
    )  # fmt: skip
    scene = over(FLAT, one, beside)
    marks = scenes.marks_of([one, beside], {})
    for photo in (one, beside):
        u, v = photo.project(PLACE)
        marks.append(Mark(name="P", photo=photo.id, u=float(u), v=float(v)))
    with pytest.raises(GeometryError, match=r"P: the rays run parallel: .* from other places"):
        intersect_points(scene, marks)


def test_the_level_that_photos_share_is_in_every_height_and_in_no_difference() -> None:
    scene = scenes.scene()
    lifted = [
        replace(p, pose=replace(p.pose, sigma_height_shared=7.0)) for p in scene.photos.photos
    ]
    marks = [*good_marks(), Mark(name="in A", photo="A", u=1000.0, v=900.0)]

    def together(photos: list[OrientedPhoto]) -> MeasuredPoints:
        s = Scene.of(scenes.FRAME, scenes.Slope(), photos, covariance=scenes.pose_covariance())
        return MeasuredPoints.joined(intersect_points(s, marks[:-1]), locate_points(s, marks[-1:]))

    with_level, without = together(lifted), together(list(scene.photos.photos))
    more = (with_level.covariance() - without.covariance()).reshape(4, 3, 4, 3)
    np.testing.assert_allclose(more[:, 2, :, 2], 49.0, rtol=1e-9)
    assert np.abs(np.delete(more, 2, axis=1)).max() < 1e-9
    assert np.abs(with_level.each - without.each - np.diag([0, 0, 49.0])).max() < 1e-9


def test_points_of_two_scenes_are_not_joined() -> None:
    a, b = (intersect_points(scenes.scene(), good_marks()) for _ in range(2))
    with pytest.raises(ValueError, match="different scenes"):
        MeasuredPoints.joined(a, b)


def test_each_place_has_its_block_of_the_joint_covariance_in_any_order_of_photos() -> None:
    marks = [
        Mark(name="", photo="CABAC"[i % 5], u=900.0 + 15.0 * i, v=1400.0 - 4.0 * i)
        for i in range(70)
    ]
    points = locate_points(scenes.scene(), marks)
    joint = points.covariance().reshape(70, 3, 70, 3)
    every = np.arange(70)
    np.testing.assert_allclose(points.each, joint[every, :, every, :], rtol=1e-9, atol=1e-12)
