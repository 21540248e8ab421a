"""One run of OpenCV's Stitcher, for `mosaic_rivals.py`.

    python benchmarks/stitch_opencv.py TARGET CONFIDENCE MEGAPIXELS PHOTOS...

Mode SCANS (affine), all at its defaults except the confidence from which two photos belong together
(its default is 1) and the size at which it finds features (0.6 MP). Prints one line of JSON: its
status and the number of photos it used.
"""

from __future__ import annotations

import json
import sys

import cv2

STATUS = ("ok", "needs more images", "homography estimation failed", "camera adjustment failed")


def main() -> None:
    target, confidence, megapixels, *paths = sys.argv[1:]
    stitcher = cv2.Stitcher.create(cv2.Stitcher_SCANS)
    stitcher.setPanoConfidenceThresh(float(confidence))
    stitcher.setRegistrationResol(float(megapixels))
    status, panorama = stitcher.stitch([cv2.imread(path) for path in paths])
    used = len(stitcher.component()) if status == cv2.Stitcher_OK else 0
    if used:
        cv2.imwrite(target, panorama, [cv2.IMWRITE_JPEG_QUALITY, 85])
    print(json.dumps({"status": STATUS[status], "used": used}))


main()
