"""Corners of chessboards and ChArUco boards in photos."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import AdjustmentError, InputError
from georef_gis.frames import Array
from georef_gis.orient.calibration.bundle import Targets, View
from georef_gis.orient.calibration.field import CalibrationSettings, calibrate_field
from georef_gis.orient.calibration.judgement import Calibration

# px; photos are looked through at this longer side, corners refined at full size
SEARCH_SIZE = 1600
# of the distance between corners: side of the window in which one is refined
_WINDOW = 0.3
_DICTIONARY = "DICT_4X4_50"

Grey = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """A flat board of squares.

    Parameters
    ----------
    kind
        "chessboard", seen whole in every photo, or "charuco", which may be cut off.
    across, down
        Number of squares (one more than of inner corners).
    square_m
        Side of a square, m.
    marker_m
        Side of a marker of a ChArUco board, m.
    dictionary
        Name of its markers' dictionary in OpenCV.
    legacy
        Whether a ChArUco board is of the pattern of OpenCV before 4.6 (even number of rows).
    sigma_m
        One sigma of a corner's place on the board, m; 0 = exact.
    """

    kind: Literal["chessboard", "charuco"] = "chessboard"
    across: int
    down: int
    square_m: float
    marker_m: float = 0.0
    dictionary: str = _DICTIONARY
    legacy: bool = False
    sigma_m: float = 0.0

    def __post_init__(self) -> None:
        """Check the numbers."""
        if min(self.across, self.down) < 4 or max(self.across, self.down) > 200:
            raise InputError(
                f"a board of {self.across} x {self.down} squares has too few or too many; give "
                "squares, not inner corners, 4 to 200",
                field="board",
            )
        if not (self.square_m > 0 and self.sigma_m >= 0):
            raise InputError(f"a square of {self.square_m} m must be > 0", field="square")
        if self.kind == "charuco" and not 0 < self.marker_m < self.square_m:
            raise InputError(
                f"a marker of {self.marker_m} m must be smaller than the square of "
                f"{self.square_m} m and > 0",
                field="marker",
            )

    def targets(self) -> Targets:
        """Inner corners, row by row; z = 0."""
        n = (self.across - 1) * (self.down - 1)
        rows, cols = np.divmod(np.arange(n), self.across - 1)
        xyz = np.column_stack([cols, rows, np.zeros(n)]) * self.square_m
        return Targets(
            xyz=xyz,
            sigma=np.full((n, 3), self.sigma_m),
            names=tuple(f"corner {c + 1},{r + 1}" for r, c in zip(rows, cols, strict=True)),
        )


def find_corners(image: Grey, board: Board) -> tuple[NDArray[np.intp], Array] | None:
    """Corners of a board in a grey picture.

    Returns
    -------
    index : shape (m,)
        Of the targets of the board.
    uv : shape (m, 2), px
        (0, 0) = centre of the first pixel, as OpenCV counts.

    None if the board was not found.
    """
    scale = max(1.0, max(image.shape) / SEARCH_SIZE)
    size = (round(image.shape[1] / scale), round(image.shape[0] / scale))
    small = (
        image
        if scale == 1.0
        else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    )
    found = _chessboard(small, board) if board.kind == "chessboard" else _charuco(small, board)
    if found is None:
        return None
    index, uv = found
    ratio = np.array([image.shape[1] / size[0], image.shape[0] / size[1]])
    uv = (uv + 0.5) * ratio - 0.5
    return index, _refined(image, board, index, uv)


def _chessboard(image: Grey, board: Board) -> tuple[NDArray[np.intp], Array] | None:
    shape = (board.across - 1, board.down - 1)
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
    done, corners = cv2.findChessboardCornersSB(image, shape, flags=flags)
    if not done or corners is None or len(corners) != shape[0] * shape[1]:
        return None
    return np.arange(len(corners)), np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def _charuco(image: Grey, board: Board) -> tuple[NDArray[np.intp], Array] | None:
    number = getattr(cv2.aruco, board.dictionary, None)
    if not board.dictionary.startswith("DICT_") or number is None:
        raise InputError(
            f"'{board.dictionary}' is not a dictionary of OpenCV; give e.g. {_DICTIONARY}",
            field="dictionary",
        )
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    pattern = cv2.aruco.CharucoBoard(
        (board.across, board.down), board.square_m, board.marker_m, dictionary
    )
    pattern.setLegacyPattern(board.legacy)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(image)
    if corners is None or ids is None or len(ids) == 0:
        return None
    index = np.asarray(ids, dtype=np.intp).ravel()
    return index, np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def _refined(image: Grey, board: Board, index: NDArray[np.intp], uv: Array) -> Array:
    """Corners to a fraction of a pixel at full size; those that run away stay as they were."""
    spacing = _spacing(board, index, uv)
    reach = _WINDOW if board.kind == "chessboard" else min(
        _WINDOW, 0.45 * (1.0 - board.marker_m / board.square_m)
    )  # fmt: skip
    half = int(np.clip(reach * spacing, 2, 25))
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-3)
    points = uv.astype(np.float32).reshape(-1, 1, 2)
    fine = cv2.cornerSubPix(image, points, (half, half), (-1, -1), criteria).reshape(-1, 2)
    moved = np.hypot(*(fine - uv).T) < half
    return np.where(moved[:, None], fine, uv).astype(np.float64)


def _spacing(board: Board, index: NDArray[np.intp], uv: Array) -> float:
    """Distance of neighbouring corners, px: the shorter ones in the picture."""
    rows, cols = np.divmod(index, board.across - 1)
    place = {(int(r), int(c)): i for i, (r, c) in enumerate(zip(rows, cols, strict=True))}
    sides = [
        float(np.hypot(*(uv[i] - uv[j])))
        for (r, c), i in place.items()
        for j in (place.get((r + 1, c)), place.get((r, c + 1)))
        if j is not None
    ]
    return float(np.percentile(sides, 10)) if sides else 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardPhoto:
    """A photo of a board: its name, and how to read it as grey."""

    id: str
    read: Callable[[], Grey]


def calibrate_board(
    camera_id: str,
    photos: Iterable[BoardPhoto],
    board: Board,
    settings: CalibrationSettings | None = None,
    *,
    told: Callable[[str, bool], None] | None = None,
) -> Calibration:
    """Camera from photos of a board.

    Parameters
    ----------
    camera_id
        Name of the camera.
    photos
        Read one at a time.
    board
        What they show.
    settings
        Lens and sigmas.
    told
        Called with every photo and whether the board was found in it.

    Raises
    ------
    InputError
        If the photos are of different sizes.
    AdjustmentError
        If the board is found in too few.
    """
    settings = settings or CalibrationSettings()
    views: list[View] = []
    size: tuple[int, int] | None = None
    missed: dict[str, str] = {}
    for photo in photos:
        image = photo.read()
        own = (image.shape[1], image.shape[0])
        size = size or own
        if own != size:
            raise InputError(
                f"is {own[0]} x {own[1]} px, the others {size[0]} x {size[1]}; calibrate photos of "
                "one size together",
                source=f"photo {photo.id}",
            )
        found = find_corners(image, board)
        if told is not None:
            told(photo.id, found is not None)
        if found is None:
            missed[photo.id] = "the board was not found"
            continue
        sigma = np.full(len(found[0]), settings.sigma_px or 1.0)
        views.append(View(id=photo.id, index=found[0], uv=found[1], sigma=sigma))
    if size is None or not views:
        raise AdjustmentError(_nothing_found(board, list(missed)))
    out = calibrate_field(camera_id, size, board.targets(), views, settings)
    doubts = tuple(f"photo {photo} is left out: {reason}" for photo, reason in missed.items())
    return replace(out, left_out={**missed, **out.left_out}, doubts=(*doubts, *out.doubts))


def _nothing_found(board: Board, missed: Sequence[str]) -> str:
    if not missed:
        return "there are no photos; name some"
    return (
        f"a {board.kind} of {board.across} x {board.down} squares was found in none of "
        f"{len(missed)} photos; count squares, not inner corners, and show the board whole, sharp"
    )
