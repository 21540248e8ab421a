"""What is measured in: photos with their poses, the ground, and how far to trust all of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame
from georef_gis.model.ground_errors import GroundErrors
from georef_gis.model.joint_errors import JointErrors
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.photo_stack import Ints, PhotoStack
from georef_gis.model.terrain import Terrain


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """Photos over a ground, and the errors that measurements in them share.

    Parameters
    ----------
    frame
        Of the map.
    terrain
        The ground.
    errors
        Of the photos' poses and cameras, and of the level.
    ground
        Law of the errors of the ground's height.
    ground_photos : shape (g,)
        Photos from whose points the ground was made: it errs as they do, and `ground` says only
        what it leaves out between the points. Empty where it was measured otherwise.
    doubts
        Photo id -> what is doubtful about it, in words.
    """

    frame: MapFrame
    terrain: Terrain
    errors: JointErrors
    ground: GroundErrors
    ground_photos: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    doubts: Mapping[str, Sequence[str]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        frame: MapFrame,
        terrain: Terrain,
        photos: Iterable[OrientedPhoto],
        *,
        covariance: Array | None = None,
    ) -> Scene:
        """Scene of photos by what they say of themselves, over a ground measured otherwise.

        Parameters
        ----------
        covariance : shape (6 K, 6 K)
            Of all poses together; without it they are taken as independent.
        """
        stack = PhotoStack.of(photos)
        errors = JointErrors(stack)
        if covariance is not None:
            errors = JointErrors.of_matrix(stack, np.asarray(covariance, float))
        return cls(frame=frame, terrain=terrain, errors=errors, ground=GroundErrors.of(terrain))

    @property
    def tied(self) -> bool:
        """Whether the ground was made of points of some of the photos."""
        return len(self.ground_photos) > 0

    @property
    def photos(self) -> PhotoStack:
        """The photos as arrays."""
        return self.errors.stack

    def number(self, photo_id: str) -> int:
        """Index of a photo.

        Raises
        ------
        GeometryError
            If it has no pose.
        """
        found = self.photos.number.get(photo_id)
        if found is None:
            raise GeometryError(
                f"photo {photo_id} has no pose; nothing can be measured in it: run `georef check` "
                "to see why, or take another photo"
            )
        return found

    def photo(self, photo_id: str) -> OrientedPhoto:
        """Photo by its id.

        Raises
        ------
        GeometryError
            If it has no pose.
        """
        return self.photos.photos[self.number(photo_id)]
