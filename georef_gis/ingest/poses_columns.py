"""Columns of pose files: headings and their meaning, order where there is no header."""

from __future__ import annotations

# Headings of columns, letters and digits only -> meaning. "coordinate1" follows the CRS's axes.
COLUMNS = {
    "label": "name", "name": "name", "imagename": "name", "image": "name", "filename": "name",
    "photo": "name", "file": "name", "photoname": "name",
    "x": "x", "xeast": "x", "xeasting": "x", "easting": "x", "east": "x",
    "y": "y", "ynorth": "y", "ynorthing": "y", "northing": "y", "north": "y",
    "xlongitude": "lon", "longitude": "lon", "lon": "lon", "long": "lon",
    "ylatitude": "lat", "latitude": "lat", "lat": "lat",
    "coordinate1": "first", "coordinate2": "second",
    "z": "z", "zaltitude": "z", "altitude": "z", "alt": "z", "height": "z", "elevation": "z",
    "yaw": "yaw", "heading": "yaw", "pitch": "pitch", "roll": "roll",
    "yawdeg": "yaw", "pitchdeg": "pitch", "rolldeg": "roll",
    "omega": "omega", "phi": "phi", "kappa": "kappa",
    "omegadeg": "omega", "phideg": "phi", "kappadeg": "kappa",
    "accuracyhorz": "acc_h", "acch": "acc_h", "hacc": "acc_h", "accuracyxym": "acc_h",
    "horizontalaccuracy": "acc_h", "accuracyh": "acc_h", "sigmahm": "acc_h",
    "accuracyvert": "acc_v", "accv": "acc_v", "vacc": "acc_v", "accuracyzm": "acc_v",
    "verticalaccuracy": "acc_v", "accuracyv": "acc_v", "sigmavm": "acc_v",
    "accuracyxy": "acc_h", "accuracyz": "acc_v", "xyaccuracym": "acc_h", "zaccuracym": "acc_v",
    "accuracyyaw": "acc_yaw", "accuracypitch": "acc_pitch", "accuracyroll": "acc_roll",
    "accuracyyawdeg": "acc_yaw", "accuracypitchdeg": "acc_pitch", "accuracyrolldeg": "acc_roll",
    "sigmayaw": "acc_yaw", "sigmapitch": "acc_pitch", "sigmaroll": "acc_roll",
    "accuracyomega": "acc_omega", "accuracyphi": "acc_phi", "accuracykappa": "acc_kappa",
    "accuracyomegadeg": "acc_omega", "accuracyphideg": "acc_phi", "accuracykappadeg": "acc_kappa",
}  # fmt: skip
# Columns of files without a header, by format; 'first' and 'second' follow the CRS's axes.
ODM = ("name", "x", "y", "z", "yaw", "pitch", "roll", "acc_h", "acc_v")
METASHAPE = ("name", "x", "y", "z", "yaw", "pitch", "roll")
PIX4D = ("name", "first", "second", "z", "yaw", "pitch", "roll", "acc_h", "acc_v")
PIX4D_ACCURACIES = ("name", "first", "second", "z", "acc_h", "acc_v")
