"""What happens to clips on their way: pictures [T, H, W, 3] RGB in, pictures out."""

from __future__ import annotations

import io

import av
import cv2
import numpy as np
from numpy.typing import NDArray

Clip = NDArray[np.uint8]
Head = tuple[slice, slice]  # rows and columns of head and shoulders


def jpeg(clip: Clip, head: Head, quality: int = 60) -> Clip:
    flags = [cv2.IMWRITE_JPEG_QUALITY, quality]
    packed = [cv2.imencode(".jpg", picture[..., ::-1], flags)[1] for picture in clip]
    return np.stack([cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1] for data in packed])


def scaled(clip: Clip, head: Head, scale: float = 0.75) -> Clip:
    small = [cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) for picture in clip]
    return jpeg(np.stack(small), head, 80)


def cropped(clip: Clip, head: Head) -> Clip:
    return clip[:, head[0], head[1]]


def x264(clip: Clip, head: Head) -> Clip:
    """4 Mbit/s for a pair of 512x512: as many bits a pixel."""
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as out:
        stream = out.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = clip.shape[2], clip.shape[1], "yuv420p"
        stream.bit_rate = round(4e6 * clip.shape[1] * clip.shape[2] / (2 * 512**2))
        stream.codec_context.thread_count = 1
        for picture in clip:
            out.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")))
        out.mux(stream.encode())
    with av.open(io.BytesIO(file.getvalue())) as back:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in back.decode(video=0)])


ATTACKS = {"JPEG 60": jpeg, "0.75x": scaled, "crop": cropped, "x264": x264}
