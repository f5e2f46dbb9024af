"""Ask a running `glsplat serve` for pictures: python drive_server.py [ws://127.0.0.1:8000/ws] [OUT.jpg]"""

import asyncio
import sys
from pathlib import Path

import glsplat
from glsplat.camera import head_matrix
from glsplat.formats import load_motion
from glsplat.net import Client

url = sys.argv[1] if len(sys.argv) > 1 else "ws://127.0.0.1:8000/ws"
out = Path(sys.argv[2] if len(sys.argv) > 2 else "served.jpg")


async def main() -> None:
    """Five pictures, each asked for when the one before has come."""
    eyes = glsplat.stereo_cameras(head_matrix((0, 1.1, 2.1), (-0.05, 0, 0, 1)), size=(384, 384))
    walk = load_motion("walk", glsplat.default_avatar().skeleton)
    async with Client(url) as client:
        for frame in range(5):
            reply = await client.render(eyes, pose=walk.at(frame / 10))
            times = ", ".join(f"{stage} {ms:.0f}" for stage, ms in reply.info["times"].items())
            print(f"frame {reply.frame_id}: {sum(map(len, reply.pictures.values()))} bytes; ms: {times}")
        out.write_bytes(reply.pictures[0])  # the left eye's JPEG as it came; reply.images() decodes both


try:
    asyncio.run(main())
except glsplat.GlsplatError as error:
    sys.exit(str(error))
print(f"{out}: the left eye of the last frame")
