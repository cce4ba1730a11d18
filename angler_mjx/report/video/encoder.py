"""Video files of pictures: H.264 in MP4, by PyAV."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np

from angler_mjx.errors import UnsupportedError

_QUALITY = {"crf": "22", "preset": "veryfast"}
"""Options of x264: quality that shows no blocks, at about 1 MB for half a minute."""


def require_encoder() -> None:
    """Refuse to write videos without an encoder.

    Raises:
        UnsupportedError: PyAV is not installed.
    """
    try:
        import av  # noqa: F401
    except ImportError as error:
        raise UnsupportedError(
            "no video was written: PyAV is not installed. Install the extra `video` "
            "(pip install 'angler-mjx[video]'); --png FILE writes one picture without it"
        ) from error


def encode_video(
    path: Path, pictures: Iterable[np.ndarray], size_px: tuple[int, int], fps: int
) -> None:
    """Write an MP4 file.

    Args:
        path: the file; its name's ending does not matter.
        pictures: uint8 [height, width, 3] each; larger ones are reduced.
        size_px: width and height of the video, both even.
        fps: pictures in a second.

    Raises:
        UnsupportedError: PyAV is not installed.
    """
    require_encoder()
    import av
    from av.video.reformatter import Interpolation, VideoReformatter

    reformatter = VideoReformatter()
    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=Fraction(fps), options=_QUALITY)
        stream.width, stream.height = size_px
        stream.pix_fmt = "yuv420p"
        for picture in pictures:
            frame = reformatter.reformat(
                av.VideoFrame.from_ndarray(picture, format="rgb24"),
                *size_px,
                format="yuv420p",
                interpolation=Interpolation.BILINEAR,
            )
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
