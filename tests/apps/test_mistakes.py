"""Mistakes on the command line: one line each, which says what was wrong and, for bad usage, where help is."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from apps import cli
from glsplat.extras.authoring.reconstruct import registry
from glsplat.formats import save
from tests.apps.cli import mistake, serve_words
from tests.extras.authoring.reconstruct.stubs import replace_check
from tests.extras.study.designs import SMALL, write
from tests.formats.scenes import splats_with_levels
from tests.scene.people import boxes, save_person
from tests.scenes import camera, cloud, limb
from tests.skinning.faces import expressive

SPOKEN = Path(__file__).parents[1] / "extras" / "speech" / "data" / "balloon.wav"
LACKS = "no joint for head, left_hip, right_hip, left_knee, right_knee, left_shoulder, right_shoulder, left_elbow, "

# a command line in an empty folder beside "in", and what its one line says
MISTAKES = {
    "usage": """
        nosuch                              : glsplat: nosuch: no such command; render, preview, serve,
        rendr -o x.png                      : glsplat: rendr: no such command; is it render?
        render                              : glsplat render: missing: -o/--output; see glsplat render --help
        avatar                              : glsplat avatar: missing: ACTION
        avatar export                       : glsplat avatar export: missing: -o/--out; see glsplat avatar export
        demo --seconds 0                    : --seconds needs 0.1 to 600
        bench --motion nosuch               : --motion nosuch: no such file and no such motion
        bench ../in/cloud.ply --motion walk : cloud.ply is none
        avatar guide -o a.jpg               : expected a picture (.png)
        report --size 8                     : --size: needs a whole number from 16 to 1024, not 8
        report --frames 2                   : --frames: needs a whole number from 3 to 10000, not 2
        report no.ply -o out                : no such file
        report ../in/cloud.ply --cameras nowhere -o out : --cameras takes a folder
    """,
    "render": """
        render none.ply -o x.png            : none.ply: no such file
        render ../in/text.jpg -o x.png      : text.jpg: expected 3DGS PLY
        render ../in/cloud.ply -o x.jpg     : expected .png or .npy
        render ../in/cloud.ply -o x.mp4     : expected .png or .npy (for a clip
        render ../in/cloud.ply -o no/x.png  : there is no folder
        render ../in/cloud.ply -o ../in     : this is a folder; give a file in it, .png or .npy
        render --turntable 3 -o out         : or out/ for PNG files: a folder ends in /
        render --turntable 0 -o x.mp4       : at least 1 view
        render --motion walk -o out.gif     : a clip .mp4 or .webm for --motion walk, or out.gif/ for PNG files
        render --motion walk -o out.png     : for one picture of it add --frame N
        render --motion walk --frame 99999 -o a.png : --frame needs 0 to
        render --frame 3 -o a.png           : --frame needs --motion
        render ../in/limb.glb --pose a --motion b -o x.png : not both
        render ../in/limb.glb --pose no.json -o x.png : cannot read the pose
        render ../in/cloud.ply --pose p.json -o x.png : no skeleton
        render ../in/cloud.ply --device nothing -o x.png : give an index or a part of a name: 0 =
        render ../in/cloud.ply --eye 1,1,1 --target 1,1,1 -o x.png : the same point
        render ../in/cloud.ply --eye -1,2 -o a.png : a point is x,y,z, for example 0,1,3, not '-1,2'
        render ../in/cloud.ply --cameras c.json --stereo -o x.png : --cameras or --stereo
        render ../in/cloud.ply --cameras no.json -o x.png : cannot read the camera file
        render ../in/cloud.ply --size 100000x4 -o x.png : size needs 1 to
        render ../in/cloud.ply --size 1 --turntable 2 -o x.mp4 : at least 2x2
        render -o x.png --size 0            : --size: a size is at least 1x1
        render -o x.png --fov nan           : --fov
        render -o x.png --ipd nan           : --ipd: needs a number of at least 0
        render -o x.png --background 255,0,0 : --background: a colour is R,G,B from 0 to 1
        render -o x.png --level 17          : --level: a level is 0 to 16 or auto, not '17'
        render -o x.png --lod-bias 1        : --lod-bias goes with --level auto
        render -o x.png --level auto --lod-bias 9 : --lod-bias: needs a number from -8 to 8, not 9
        render ../in/cloud.ply --alpha -o a.npy : an .npy holds alpha anyway
        render ../in/cloud.ply --alpha -o a.mp4 --turntable 3 : a clip has no alpha
        render ../in/cloud.ply --alpha --background 1,1,1 -o a.png : --alpha or --background
        render ../in/cloud.ply --depth d.exr -o a.png : --depth d.exr: expected .npy
        render ../in/cloud.ply --depth a.png -o a.png : the same file
        render ../in/limb.glb --light noon -o a.png : studio, day, evening
        render ../in/limb.glb --expression jawOpen=1 -o a.png : this one has none
        render ../in/face.glb --expression jawOpen=nan -o a.png : NAME=WEIGHT
        render ../in/face.glb --expression cheekPuff=1 -o a.png : no shape 'cheekPuff'; it has jawOpen, eyeBlinkLeft
        render ../in/face.glb --speech SPOKEN -o a.png : a clip .mp4 or .webm for --speech
        render ../in/face.glb --speech SPOKEN --frame 3 -o a.png : give --speech or --frame, not both
        render ../in/face.glb --speech ../in/text.jpg -o a.mp4 : text.jpg
        render ../in/limb.glb --speech SPOKEN -o a.mp4 : --speech needs an avatar with shapes
    """,
    "avatar": """
        avatar make absent.npz -o a.glb     : absent.npz: cannot be read
        avatar make ../in/me.npz -o a.ply   : written as .glb
        avatar make ../in/me.npz -o a.glb --steps -1 : --steps: needs a whole number of at least 0, not -1
        avatar make ../in/me.npz -o a.glb --splats 3 : at least 100
        avatar make ../in/me.npz -o a.glb --levels 40000 : --levels needs falling numbers of splats below 40000
        avatar make ../in/me.npz -o a.glb --extra-scale 0 : --extra-scale needs a number above 0
        avatar cones ../in/limb.glb -o a.ply : written as .glb
        avatar cones ../in/limb.glb -o a.glb --psnr 0 : --psnr
        avatar import ../in/me.npz -o a.glb : an LHM dump needs query_points
        avatar import absent.zip -o a.glb   : absent.zip: cannot read
        avatar import ../in/me.npz --follow head -o a.glb : --follow is for LAM zips
        avatar score ../in/me.npz --mesh ../in/me.npz : me.npz
        avatar score --mesh ../in/me.npz --views 0 : --views
        avatar score --mesh ../in/me.npz --poses 9 : --poses: needs a whole number from 1 to 8
        avatar score --mesh ../in/me.npz --sheet a.gif : written as .png or .jpg
        avatar export --pose nonsense -o a.ply : --pose nonsense: no such file
        avatar export ../in/limb.glb --pose ../in/degrees.json -o a.ply : joint1 turns by 90 rad; angles are radians
        avatar reduce ../in/limb.glb --splats 99 -o a.glb : has 600 splats; --splats needs 100 or more and fewer than
        avatar reduce ../in/cloud.ply --splats 150 -o a.glb : has no skeleton; reduce is for avatars
        avatar reduce ../in/limb.glb --splats few -o a.glb : needs a whole number of at least 0, not "few"
        avatar levels ../in/levels.glb -o c.glb : has 3 coarser levels already; --force replaces them
        avatar levels ../in/cloud.ply -o c.glb --counts 900 : --counts needs fewer, not 900
        avatar levels ../in/cloud.ply -o c.glb --counts 10 20 : --counts needs falling numbers above 0, not 10 20
        avatar levels ../in/cloud.ply -o c.glb --psnr 0 : --psnr needs decibels
        avatar consent                      : give an avatar to sign, or --new-key KEY
        avatar consent ../in/limb.glb --subject A --until 2999-01-01 --drivers * : a consent needs --sign
        avatar consent ../in/limb.glb --subject A --until soon : a date is like 2026-12-31
        avatar consent ../in/cloud.ply --subject A --until 2999-01-01 --drivers * --sign ../in/key : .glb files alone
        avatar consent ../in/limb.glb --subject A --until 2999-01-01 --drivers a,,b --sign ../in/key : drivers needs
        avatar consent ../in/limb.glb --subject A --until 2999-01-01 --drivers * --sign ../in/key.pub : Ed25519 private
        avatar consent --new-key ../in/key  : never written over
        watermark detect ../in/text.jpg --key ../in/mark : expected a clip, or a picture
        watermark detect ../in/front.jpg --key nowhere : cannot read the watermark's key (No such file or directory)
        watermark detect ../in/front.jpg --key ../in/mark --window 0 : --window: needs a whole number of at least 1
    """,
    "photo": """
        avatar photo absent.jpg -o a.glb    : absent.jpg: cannot be read (No such file or directory)
        avatar photo ../in/front.jpg        : missing: -o/--out
        avatar photo ../in/front.jpg -o away/a.glb : there is no folder away
        avatar photo ../in/front.jpg -o a.ply --mine : .glb
        avatar photo ../in/front.jpg -o a.glb --height 174 : metres, 0.5 to 2.5, not 174; is it 1.74?
        avatar photo ../in/front.jpg -o a.glb --splats 7 : 100 to 2000000 splats, not 7
        avatar photo ../in/front.jpg -o a.glb --with lmh : no reconstructor is called "lmh"; there are builtin, lhm
        avatar photo ../in/front.jpg -o a.glb --with lhm : set GLSPLAT_LHM to the folder
        avatar photo ../in/front.jpg -o a.glb --mask ../in/small.png : the mask has 30 x 30 pixels, its picture 60 x 90
        avatar photo ../in/front.jpg -o a.glb --mask ../in/front.jpg : 0.0% of the mask are white
        avatar photo ../in/front.jpg -o a.glb --back-mask ../in/front.jpg : give the back picture, too
        avatar photo ../in/front.jpg -o a.glb --debug ../in/front.jpg/x : cannot make the folder
        avatar photo ../in/text.jpg -o a.glb : text.jpg: expected a photograph (JPEG, PNG or WebP)
        avatar photo . -o a.glb             : expected pictures (NAME.jpg, NAME.png), found none
        avatar photo ../in                  : missing: -o/--out, a folder
        avatar photo ../in -o out --back b.jpg : --back is about one person
        avatar photo ../in/front.jpg -o a.glb --ray : --ray is for a folder of pictures
        avatar photo ../in --mine --check   : --mine signs an avatar, --check makes none
        avatar photo ../in/front.jpg -o a.glb --as mesh --cones : --cones has no meaning with --as mesh
        avatar photo ../in/front.jpg -o a.glb --texture 512 : --texture has no meaning with --as splats
        avatar photo ../in/front.jpg -o a.glb --as mesh --texture 255 : 256 to 8192 texels a side, not 255
        avatar photo ../in/front.jpg -o a.glb --as mesh --with other : --with other makes splats, no mesh
        avatar video turn.mp4 -o a.glb --as mesh --splats 5 : --splats has no meaning with --as mesh: leave it out
        avatar video turn.mp4 -o a.glb --frames 5 : --frames: needs a whole number from 8 to 120, not 5
        avatar video turn.mp4 -o a.txt      : written as .glb
        avatar video ../in/text.jpg -o a.glb : text.jpg
    """,
    "tracking": """
        tracking from-motion no-such-motion -o x.jsonl : MOTION no-such-motion: no such file and no such motion
        tracking from-motion idle -o x.jsonl --rate 0 : a rate needs 1 to 1000 Hz
        tracking from-motion idle -o x.jsonl --trackers tail : waist, feet, body
        tracking solve -o x.jsonl --height 9 : a height needs 0.5 to 2.8 metres
        tracking solve -o x.jsonl --height 1.7 --calibration me.json : --calibration
        tracking solve -o x.jsonl --predict-ms 900 : prediction needs 0 to 0.1 seconds
        tracking calibrate -o x.json        : --height
        tracking calibrate ../in/r.jsonl -o ../in/r.jsonl : different names
        tracking show -o out.avi            : expected a clip .mp4 or .webm, a contact sheet .png, or out.avi/
        tracking show -o x.webm --size 9000 : --size needs at most 4096
        tracking show --motion walk --from 99 -o x.png : nothing is left to draw
        tracking bench idle --rates fast    : --rates
        tracking bench idle --model none.npz : none.npz
    """,
    "replay": """
        replay --frames 2 --url ws://127.0.0.1:9/ws : no server at ws://127.0.0.1:9/ws: start one with `glsplat serve`
        replay --url http://127.0.0.1:8000  : http://127.0.0.1:8000: expected ws://HOST:PORT/ws
        replay --url ws://host:port         : expected ws://HOST:PORT/ws
        replay nothing                      : embedded are idle, walk, wave-and-turn; see glsplat replay --help
        replay --avatar ../in/cloud.ply     : splats without a skeleton
        replay --save clip.avi              : expected a clip .mp4 or .webm, a contact sheet .png, or clip.avi/
        replay --token-file nowhere         : nowhere: cannot read the token
        replay --tls-ca nowhere.pem --url wss://127.0.0.1:9 : nowhere.pem: expected a certificate
        replay --fps 0                      : --fps: needs a number from 1 to 240
        replay --frames 0                   : --frames: needs a whole number of at least 1
        replay --window 9                   : --window: needs a whole number from 1 to 8
        replay --compare --save sheet.png   : --save goes with a single run
        replay --link 20,50 --url wss://127.0.0.1:9/ws : --link goes with ws://
        replay --seconds nan                : --seconds
        replay --frames 4 --loop            : --frames
        replay --loop --save x.png          : --seconds
        replay --people 2                   : go with --room
        replay --room lab --people 0        : --people: needs a whole number from 1 to 64
        preview --frames 0                  : --frames: needs a whole number of at least 1
        preview --screenshot x.jpg          : end in .png
        preview --quality 3                 : --quality goes with --connect
        preview --recording                 : --recording goes with --connect
        preview --connect ws://127.0.0.1:1  : no server at ws://127.0.0.1:1/ws: start one with `glsplat serve`
        preview --connect ws://127.0.0.1:1 --level 2 : --level, --lod-bias, --cull-hidden and
        preview --connect ws://127.0.0.1:1 --quality 0 : --quality: needs a whole number from 1 to 100
        preview --window                    : --window goes with --xr
        preview --xr --motion walk          : --motion does not go with --xr
        preview --xr --connect ws://x       : there: --url
        preview --xr --scale 0              : 0.05 to 4, not 0
        preview --xr --record x.json        : end in .jsonl
        preview --xr --record /nowhere/at/all.jsonl : no such folder
        preview --xr --level auto --url ws://x : a server decides
        preview --xr --height 1.8 --url ws://x : height=METRES
        preview --xr --passthrough --background 1,1,1 : --background does not go
    """,
    "serve": """
        serve nowhere.glb                   : glsplat serve: nowhere.glb: no such file
        serve exact=true level=1            : --exact and --level contradict each other
        serve fps=0                         : server.toml: fps: needs a number from 1 to 240 pictures a second, not 0
        serve --host 0.0.0.0                : tls-cert, tls-key and token-file
        serve --size 4096                   : raise max-size
        serve fov=180                       : fov: needs a number from 1 to 170 degrees
        serve tls-cert=a.pem                : TLS needs both tls-cert and tls-key
        serve tls-cert=a.pem tls-key=b.pem  : a.pem: expected a PEM file for TLS
        serve --self-signed tls-cert=a.pem tls-key=b.pem : --self-signed makes a certificate
        serve token-file=nowhere            : nowhere: cannot read the token
        serve bitrate=8 fixed=true          : leave one out
        serve bitrate=0                     : 0.1 to 100000 Mbit/s
        serve webtransport=true fixed=true  : fixed sends the same to all: leave one out
        serve --room lab --room lab:3       : two rooms
        serve --room lab:20                 : 20 people need max-clients = 20
        serve --avatar ../in/cloud.ply      : found splats without a skeleton
        serve --avatar ../in/limb.glb --avatar ../in/limb.glb : there is a "limb" already
        serve ../in/limb.glb                : "limb": no consent on file; sign one
        serve --workers ray:65              : --workers needs
        serve ray-address=gpu1:6379         : ray-address is for workers: give workers, too
        serve --allow-upload . cull-hidden=true : cull-hidden needs avatars with cones
        serve participant=1                 : participant is for study: give study, too
        serve --fps 45                      : --fps: no such flag, fps goes into the file of --config
        serve study=../in/study.toml        : its participant's number
        serve study=../in/study.toml participant=7 : 1 to 6
        serve study=../in/study.toml participant=1 x.glb : leave out SCENE
        serve study=none.toml participant=1 : none.toml
        serve study=../in/study.toml participant=1 study-data=nowhere : no plan yet
        serve study=../in/study.toml participant=1 video=true : the study out
        study run ../in/study.toml 2        : no such avatar
    """,
    "another rig": """
        render ../in/limb.glb --motion walk -o out/ : LACKS
        bench ../in/limb.glb --motion walk --sizes 16 --frames 3 : LACKS
        preview ../in/limb.glb --motion walk --screenshot out.png : LACKS
        preview ../in/limb.glb --connect ws://127.0.0.1:9/ws --recording : LACKS
        replay walk --avatar ../in/limb.glb : LACKS
        replay walk --tracking --avatar ../in/limb.glb : LACKS
        demo --avatar ../in/limb.glb -o out : LACKS
        avatar score ../in/limb.glb --mesh ../in/limb.glb --sheet out.png : LACKS
        avatar export ../in/limb.glb --pose walk -o out.ply : LACKS
        avatar import ../in/limb.glb -o out.glb : LACKS
        tracking from-motion walk --avatar ../in/limb.glb -o out.jsonl : LACKS
        tracking solve --avatar ../in/limb.glb -o out.jsonl : LACKS
        tracking show --avatar ../in/limb.glb -o out.png : LACKS
    """,
}


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that the command lines name."""
    folder = tmp_path_factory.mktemp("mistakes") / "in"
    folder.mkdir()
    save(cloud(300), folder / "cloud.ply")
    save(limb(), folder / "limb.glb")
    save(expressive(50), folder / "face.glb")
    save(splats_with_levels(), folder / "levels.glb")
    save_person(boxes(), folder / "me.npz")
    cv2.imwrite(str(folder / "front.jpg"), np.full((90, 60, 3), 77, np.uint8))
    cv2.imwrite(str(folder / "small.png"), np.zeros((30, 30), np.uint8))
    (folder / "text.jpg").write_text("neither a picture nor splats")
    (folder / "degrees.json").write_text('{"joints": {"joint1": [0, 0, 90]}}')
    (folder / "mark").write_text("1a2b " + b"sixteen bytes 01".hex())
    (folder / "mark").chmod(0o600)
    (folder / "r.jsonl").write_text(json.dumps({"t": 0.0, "head": [0, 1.6, 0, 0, 0, 0, 1]}) + "\n")
    assert cli.main(["avatar", "consent", "--new-key", str(folder / "key")]) == 0
    path = write(folder, SMALL.replace("latency = 150", 'avatar = "{participant}.glb"'))
    assert cli.main(["study", "plan", str(path)]) == 0
    return folder


@pytest.fixture
def here(given: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that commands run in; a reconstructor that needs no work stands in."""
    folder = given.parent / "here"
    folder.mkdir(exist_ok=True)
    monkeypatch.chdir(folder)
    monkeypatch.delenv("GLSPLAT_LHM", raising=False)
    monkeypatch.setitem(registry.OWN, "builtin", "tests.extras.authoring.reconstruct.stubs:Detailed")
    monkeypatch.setitem(registry.OWN, "other", "tests.extras.authoring.reconstruct.stubs:Plain")
    replace_check(monkeypatch)
    return folder


@pytest.mark.gl
@pytest.mark.parametrize("group", MISTAKES)
def test_mistakes_are_one_line_and_leave_nothing(
    here: Path, given: Path, capsys: pytest.CaptureFixture[str], group: str, tmp_path: Path
) -> None:
    before = sorted(path.name for path in given.iterdir())
    for row in MISTAKES[group].strip().splitlines():
        line, _, message = row.partition(" : ")
        words = [str(SPOKEN) if word == "SPOKEN" else word for word in line.split()]
        found = mistake(capsys, *(serve_words(tmp_path, words) if words[0] == "serve" else words))
        assert message.strip().replace("LACKS", LACKS) in found, row
        assert not list(here.iterdir()), row
    assert sorted(path.name for path in given.iterdir()) == before


@pytest.mark.parametrize("command", list(cli.COMMANDS))
def test_an_option_that_is_not_there(capsys: pytest.CaptureFixture[str], command: str) -> None:
    words = {"avatar": "export -o x.ply", "tracking": "solve -o x", "convert": "a b", "study": "new folder"}
    words |= {"models": "list", "users": "list", "watermark": "detect clip.mp4", "render": "-o x.png"}
    line = mistake(capsys, command, *words.get(command, "").split(), "--nosuch")
    assert line == f"glsplat {command}: unrecognized arguments: --nosuch; see glsplat {command} --help\n"


@pytest.mark.gl
def test_camera_files_that_are_none(here: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, bad = camera(8).to_json(), tmp_path / "bad.json"
    skew = [[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    for content, expected in (
        ("{", "is JSON"),
        ("[]", "at least one camera"),
        ("{}", "missing width, height"),
        (good | {"width": True}, "width needs a whole number"),
        (good | {"w2c": np.eye(3).tolist()}, "4x4 matrix"),
        (good | {"w2c": skew}, "rotation"),
        (good | {"fx": "100"}, "fx needs a number, not str '100'"),
        (good | {"bg": [1e200, 0, 0]}, "a background needs 0 to 1, found 1e+200"),
        (good | {"sh_degree": 1.7}, "sh_degree needs a whole number"),
        (good | {"fx": 1e300}, "below 1e+12"),
        (good | {"near": 0}, "near"),
        ([good, camera(9).to_json()], "same width and height"),
    ):
        bad.write_text(content if isinstance(content, str) else json.dumps(content))
        assert expected in mistake(capsys, "render", "../in/cloud.ply", "--cameras", bad, "-o", "x.png")
    assert not list(here.iterdir())
