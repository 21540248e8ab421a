"""What `mosaic` asks: pixel size, seams, colour, blending, workers."""

from __future__ import annotations

from typing import Literal

from georef_gis.toolbox import parameters as p


class MosaicParameters(p.Parameters):
    """Parameters of `mosaic`."""

    gsd: p.Length | None = p.length(
        None,
        title="Ground sample distance; by default the photos' own",
        unit="m",
        ge=0.0005,
        le=100,
    )
    seams: Literal["auto", "optimised", "nearest", "none"] = p.choice(
        "auto", title="Seams",
        help="optimised: where photos differ least, round vehicles and roofs; nearest: half way "
        "between the nadirs; none: a wide feather, no colour and no seam layer; auto: optimised "
        "once the photos are adjusted, else none",
    )  # fmt: skip
    colour: Literal["full", "gain", "none"] = p.choice(
        "full", title="Colour",
        help="full: exposure, white balance, vignetting and hot spot; gain: exposure and white "
        "balance; none: grey values stay",
    )  # fmt: skip
    blend: Literal["multiband", "feather", "none"] = p.choice(
        "multiband", title="Change at the seams",
        help="multiband: brightness over tens of metres, detail over pixels; feather: all over "
        "64 px; none: grey values stay",
    )  # fmt: skip
    cluster: p.Text = p.text(
        "", title="Cluster",
        help="tcp://HOST:PORT of a running dask scheduler, local or local:N for N processes of "
        "this machine; empty: threads. The project folder must be shared with the workers",
        advanced=True,
    )  # fmt: skip
    photos_root: p.Text = p.text(
        "", title="Photos as workers see them",
        help="folder, or URL such as s3://BUCKET/photos, that stands for the photos' folder on "
        "the workers of a cluster; empty: the same path",
        advanced=True,
    )  # fmt: skip
